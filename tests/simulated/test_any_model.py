"""Bodies that the project does not know, and mixtures of senses, go through all phases."""

from typing import Any

import pytest

from services.runtime.settings import parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation
from tests.simulated.test_whole_run import Simulate, models_of, scores_of
from tests.unit.test_mjcf import ANT, SHADOW_HAND


def went_through(simulate: Simulate, world: str, parameters: dict[str, Any]) -> Simulation:
    """A tiny run of the world to its end: models were published and scored."""
    settings = parse({**TINY, "world": {"id": world, "parameters": parameters}}, origin="the test")
    simulation = simulate(settings)
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    scores = scores_of(simulation.run_dir)
    assert [score["iteration"] for score in scores if score["policy"] == "mean"] == [0, 1]
    assert all(0 <= score["z_min"] <= 1 for score in scores)
    assert models_of(simulation.run_dir)
    return simulation


def test_a_quadruped_and_a_robot_hand_babble_encode_and_practise(simulate: Simulate) -> None:
    went_through(simulate, "Mjcf", {"file": str(ANT), "senses": ["position", "velocity"]})
    fingers = {"joints": ["robot0:?FJ?", "!*J3"], "actuators": ["robot0:A_?FJ?", "!*J3"]}
    went_through(simulate, "Mjcf", {"file": str(SHADOW_HAND), **fingers})


@pytest.mark.parametrize(
    "parameters",
    [
        {"senses": ["position", "velocity", "torque", "vestibular", "touch"], "touch": {"resolution": 0.2}},
        {"senses": ["position", "vision"], "vision": {"resolution": 16}},
        {"senses": ["vision"], "vision": {"resolution": 16}, "degradation": {"vision": {"delay_steps": 2}}},
    ],
    ids=["felt", "seen and felt", "seen late"],
)
def test_an_encoder_learns_from_any_mixture_of_senses(simulate: Simulate, parameters: dict[str, Any]) -> None:
    went_through(simulate, "MimoRollover", {**parameters, "settle_steps": 0, "episode_steps": 20})
