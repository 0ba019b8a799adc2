"""Bodies that the project does not know, and mixtures of senses, go through all phases."""

from pathlib import Path
from typing import Any

import pytest

from babble.policy.act import EncoderModel, PolicyModel
from protocol.messages import Phase
from services.runtime.settings import parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation
from tests.simulated.test_whole_run import Simulate, scores_of
from tests.unit.test_mjcf import ANT, SHADOW_HAND

SHORT = {"babble_steps": 64, "ground_steps": 64, "walk_steps": 64, "practise_steps": 64, "iterations": 1}
FITS = {"batch": 16, "encode": {"updates": 5}, "refine": {"updates": 5, "window_steps": 4}}


def went_through(simulate: Simulate, world: str, parameters: dict[str, Any]) -> Simulation:
    """A tiny run of the world to its end."""
    table = {**TINY, "phases": SHORT, "encoder": FITS, "world": {"id": world, "parameters": parameters}}
    simulation = simulate(parse(table, origin="the test"))
    simulation.start_all(actors=1)
    simulation.until_all_ended()
    scored = [(score["iteration"], score["policy"]) for score in scores_of(simulation.run_dir)]
    assert scored == [(0, "mean"), (0, "sampled"), (1, "mean"), (1, "sampled")]
    return simulation


def joints_of(simulation: Simulation) -> set[int]:
    """How many joints the postures have by which the run was scored."""
    return {segment.arrays["posture"].shape[2] for segment in simulation.segments(Phase.EVALUATE)}


def sizes_of(run_dir: Path) -> tuple[int, int]:
    """What the saved encoder observes and the saved policy moves."""
    kept = run_dir / "models/body"
    (policy,) = {PolicyModel(path.read_bytes()).action_size for path in kept.glob("policy-*.onnx")}
    (encoder,) = {EncoderModel(path.read_bytes()).observation_size for path in kept.glob("encoder-*.onnx")}
    return encoder, policy


def test_a_quadruped_babbles_encodes_and_practises(simulate: Simulate) -> None:
    run = went_through(simulate, "Mjcf", {"file": str(ANT), "senses": ["position", "velocity"]})
    assert joints_of(run) == {8}, "hips and ankles"
    assert sizes_of(run.run_dir) == (2 * 8, 8)


def test_the_fingers_of_a_robot_hand_babble_encode_and_practise(simulate: Simulate) -> None:
    fingers = {"joints": ["robot0:?FJ?", "!*J3"], "actuators": ["robot0:A_?FJ?", "!*J3"]}
    run = went_through(simulate, "Mjcf", {"file": str(SHADOW_HAND), **fingers})
    assert joints_of(run) == {13}, "three of each finger, and the little one's palm"
    assert sizes_of(run.run_dir)[1] == 9


@pytest.mark.parametrize(
    ("parameters", "images"),
    [
        (
            {
                "senses": ["position", "velocity", "torque", "vestibular", "touch"],
                "touch": {"resolution": 0.2},
            },
            0,
        ),
        ({"senses": ["position", "vision"], "vision": {"resolution": 8}}, 2 * 8 * 8 * 3),
        (
            {
                "senses": ["vision"],
                "vision": {"resolution": 8},
                "degradation": {"vision": {"delay_steps": 2}},
            },
            2 * 8 * 8 * 3,
        ),
    ],
    ids=["felt", "seen and felt", "seen late"],
)
def test_an_encoder_learns_from_any_mixture_of_senses(
    simulate: Simulate, parameters: dict[str, Any], images: int
) -> None:
    run = went_through(simulate, "MimoRollover", {**parameters, "settle_steps": 0, "episode_steps": 20})
    (joints,) = joints_of(run)
    observed, moved = sizes_of(run.run_dir)
    assert joints >= moved > 40
    vectors = {
        s.arrays["observation"].shape[2] for s in run.segments(Phase.BABBLE) if "observation" in s.arrays
    }
    pixels = {s.arrays["image"].shape[2] for s in run.segments(Phase.BABBLE) if "image" in s.arrays}
    assert pixels == ({images} if images else set())
    assert observed == sum(vectors) + images
