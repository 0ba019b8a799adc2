"""Fixtures of the simulated runs."""

from collections.abc import Callable
from pathlib import Path

import pytest

from services.runtime.settings import RunSettings, parse
from tests.simulated.harness import Simulation

TINY = {
    "scenario": "tiny",
    "actors": {"envs_per_actor": 2, "segment_steps": 16},
    "phases": {
        "babble_steps": 256,
        "ground_steps": 256,
        "walk_steps": 192,
        "practise_steps": 128,
        "iterations": 1,
    },
    "encoder": {"batch": 16, "encode": {"updates": 30}, "refine": {"updates": 30, "window_steps": 4}},
    "policy": {"rollout_columns": 4, "epochs": 2, "minibatch": 32},
    "goals": {"period_steps": 10, "walk_steps_per_goal": 10},
    "evaluation": {"columns": 4, "legs": 3, "leg_steps": 10},
}


@pytest.fixture
def tiny() -> RunSettings:
    """A run of all phases that takes well under a second."""
    return parse(TINY, origin="the tiny scenario")


@pytest.fixture
def simulate(tmp_path: Path) -> Callable[..., Simulation]:
    """Makes simulations, each with its own run folder."""
    made: list[Simulation] = []

    def make(settings: RunSettings, **options: object) -> Simulation:
        simulation = Simulation(settings, tmp_path / f"run-{len(made)}", **options)  # type: ignore[arg-type]
        simulation.run_dir.mkdir()
        made.append(simulation)
        return simulation

    return make
