"""What people are shown of a whole run, and that the run does not change by it."""

from typing import Any

import numpy as np
import pytest

from protocol.messages import Phase, View
from services.runtime.settings import RunSettings, parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation
from tests.simulated.test_whole_run import Simulate, models_of, scores_of
from tests.unit.test_mjcf import ANT

OFTEN = {"latents_per_sec": 50, "poses_per_sec": 50, "images_per_sec": 50, "shown_actors": 1}
NEVER = {"latents_per_sec": 0, "poses_per_sec": 0, "images_per_sec": 0}
BLOCKS = [
    {"name": "along", "observes": [0], "drives": [0]},
    {"name": "across", "observes": [1, 2], "drives": [1, 2], "latent_dim": 3},
]
ACTING = (Phase.GROUND, Phase.WALK, Phase.PRACTISE, Phase.EVALUATE)


def settings_of(**tables: Any) -> RunSettings:
    return parse({**TINY, **tables}, origin="the test")


def run_of(simulate: Simulate, settings: RunSettings) -> Simulation:
    """A run of two actors to its end, at each turn of which every picture is due."""
    simulation = simulate(settings, turn_secs=0.1)
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    return simulation


def kinds(views: list[View]) -> set[tuple[str, str]]:
    return {(view.view, view.block) for view in views}


def test_each_phase_shows_postures_or_the_latents_of_its_blocks(simulate: Simulate) -> None:
    run = run_of(simulate, settings_of(view=OFTEN, block=BLOCKS))
    assert kinds(run.views(Phase.BABBLE)) == {("posture", "all")}, "there is no latent yet"
    for phase in ACTING:
        assert kinds(run.views(phase)) == {("latent", "along"), ("latent", "across")}, phase
    for view in run.views(*ACTING):
        latent_dim = 2 if view.block == "along" else 3
        assert view.arrays["latent"].shape == view.arrays["goal"].shape == (2, latent_dim)
        assert view.arrays["posture"].shape == (2, 3)
        np.testing.assert_allclose(view.arrays["latent"].sum(axis=1), 1, atol=1e-5)
        np.testing.assert_array_equal(np.sort(view.arrays["goal"], axis=1)[:, -1], 1)
        np.testing.assert_array_equal(view.arrays["trail"][-1], view.arrays["latent"][0])
        np.testing.assert_array_equal(view.arrays["path"][-1], view.arrays["posture"][0])
        steps = np.diff(view.arrays["path"], axis=0)
        assert (np.abs(steps) <= 0.08 + 1e-6).all(), "a way has no gaps"
    assert {view.life for view in run.views(*ACTING)} == {"actor-0", "actor-1"}
    for life in ("actor-0", "actor-1"):
        steps = [view.env_step for view in run.views(*Phase) if view.life == life]
        assert steps == sorted(steps)


def test_a_run_is_the_same_whether_it_is_shown_or_not(simulate: Simulate) -> None:
    body = {"id": "Mjcf", "parameters": {"file": str(ANT), "senses": ["position", "velocity"]}}
    often, never = (
        run_of(simulate, settings_of(view=view, world=body, phases={**TINY["phases"], "babble_steps": 64}))
        for view in (OFTEN, NEVER)
    )
    assert {view.view for view in often.views(*Phase)} == {"posture", "latent", "pose"}
    assert never.views(*Phase) == []
    assert often.segments(*Phase) == never.segments(*Phase)
    assert models_of(often.run_dir) == models_of(never.run_dir)
    assert scores_of(often.run_dir) == scores_of(never.run_dir)


def test_a_simulated_body_shows_its_poses_and_what_it_sees_and_of_one_actor_alone(simulate: Simulate) -> None:
    pytest.importorskip("mujoco")
    short = {"babble_steps": 64, "ground_steps": 64, "walk_steps": 64, "practise_steps": 64, "iterations": 1}
    body = {"senses": ["position", "vision"], "vision": {"resolution": 8}, "settle_steps": 0}
    run = run_of(
        simulate,
        settings_of(view=OFTEN, world={"id": "MimoRollover", "parameters": body}, phases=short),
    )
    seen = [view for view in run.views(*Phase) if view.view in ("pose", "image")]
    assert {view.life for view in seen} == {"actor-0"}
    assert {view.title for view in seen if view.view == "image"} == {"left eye", "right eye"}
    assert {view.arrays["pixels"].shape for view in seen if view.view == "image"} == {(8, 8, 3)}
    for phase in (Phase.BABBLE, *ACTING):
        assert {"pose", "image"} <= {view.view for view in run.views(phase)}, phase
    poses = [view.arrays for view in seen if view.view == "pose"]
    assert len({(pose["position"].shape, pose["touch"].shape) for pose in poses}) == 1
    norms = [np.linalg.norm(pose["quaternion"], axis=1) for pose in poses]
    np.testing.assert_allclose(norms, 1, atol=1e-4)
    totals = run.statuses("actor-0")[-1][1].totals
    assert totals["unshown"] == 0
    assert totals["views"] == len([view for view in run.views(*Phase) if view.life == "actor-0"])
