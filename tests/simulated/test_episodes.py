"""Whole runs in worlds whose episodes end, break down, take their time or have a task of their own."""

import itertools
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.worlds import WORLDS, WorldEntry
from protocol.messages import Phase
from services.actor.service import QUANTUM_SECS
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings, SettingsError, WorldSettings
from tests.simulated.episodic import EpisodicWorld
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]
Make = Callable[..., RunSettings]
ACTING = (Phase.GROUND, Phase.PRACTISE)
STEP_SECS = 0.02


@pytest.fixture
def episodic(tiny: RunSettings, monkeypatch: pytest.MonkeyPatch) -> Make:
    """Makes settings: the tiny run in an episodic world with some parameters, and other changes."""
    entry = WorldEntry("Episodic", "a line", "2", "tests.simulated.episodic")
    monkeypatch.setitem(WORLDS, "Episodic", entry)

    def make(parameters: dict[str, Any] | None = None, **sections: dict[str, Any]) -> RunSettings:
        changed = {name: getattr(tiny, name).model_copy(update=new) for name, new in sections.items()}
        world = WorldSettings(id="Episodic", parameters=parameters or {})
        return tiny.model_copy(update={"world": world, **changed})

    return make


def scores_of(run_dir: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run_dir / "scores.jsonl").read_text().splitlines()]


def totals_of(simulation: Simulation, life: str) -> dict[str, int]:
    return simulation.statuses(life)[-1][1].totals


@pytest.mark.parametrize("parameters", [{"limit_steps": 7}, {"ends_at": 0.3}])
def test_a_run_whose_episodes_end_goes_through_all_phases(
    episodic: Make, simulate: Simulate, parameters: dict[str, Any]
) -> None:
    simulation = simulate(episodic(parameters))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    flag = "truncated" if "limit_steps" in parameters else "terminated"
    assert any(segment.arrays[flag].any() for segment in simulation.segments(*ACTING))
    for phase in (Phase.BABBLE, Phase.WALK):
        assert max(segment.arrays["episode"].max() for segment in simulation.segments(phase)) > 1
    assert len(scores_of(simulation.run_dir)) == 4


def test_nothing_of_a_simulation_that_broke_down_is_sent_and_the_run_ends_all_the_same(
    episodic: Make, simulate: Simulate
) -> None:
    simulation = simulate(episodic({"fails_every": 41}))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    for segment in simulation.segments(*Phase):
        for name, array in segment.arrays.items():
            assert np.isfinite(array).all(), f"{segment.phase} {name}"
    for life in ("actor-0", "actor-1"):
        totals = totals_of(simulation, life)
        assert totals["dropped_segments"] >= totals["failed_episodes"] > 2
        assert "breaks down now and then (episodes lost: " in simulation.statuses(life)[-1][1].last_error
    assert len(scores_of(simulation.run_dir)) == 4


def test_an_actor_whose_simulation_always_breaks_down_says_so_and_ends(
    episodic: Make, simulate: Simulate
) -> None:
    simulation = simulate(episodic({"fails_every": 10}))
    simulation.start_all(actors=1)
    with pytest.raises(UserError, match="simulation of Episodic broke down 20 times in a row"):
        simulation.until_all_ended()
    assert simulation.segments(*Phase) == []


def test_a_slow_world_does_not_keep_an_actor_from_saying_that_it_lives(
    episodic: Make, simulate: Simulate, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = simulate(episodic(evaluation={"leg_steps": 100}))
    step = EpisodicWorld.step

    def slow(world: EpisodicWorld, action: Any) -> Any:
        simulation.clock.advance(STEP_SECS)
        return step(world, action)

    monkeypatch.setattr(EpisodicWorld, "step", slow)
    simulation.start_all(actors=1)
    simulation.until_all_ended()
    assert simulation.segments(Phase.EVALUATE), "three legs of 100 steps take 6 s"
    times = [secs for secs, _ in simulation.statuses("actor-0")]
    interval_secs = simulation.settings.wire.status_secs
    assert max(after - before for before, after in itertools.pairwise(times)) < (
        interval_secs + 2 * (QUANTUM_SECS + STEP_SECS)
    )


def test_the_tasks_own_reward_is_sent_trained_on_and_scored(episodic: Make, simulate: Simulate) -> None:
    simulation = simulate(episodic(goals={"goal_weight": 0.0, "external_weight": 2.0}))
    simulation.start_all(actors=2)
    simulation.until_all_ended()
    segments = simulation.segments(*ACTING)
    assert all("external_reward" in segment.arrays for segment in segments)
    learner = [status for _, status in simulation.statuses("policy_learner-0")]
    measured = next(status.metrics for status in learner if "body/policy/reward_mean" in status.metrics)
    assert measured["body/policy/reward_mean"] == pytest.approx(
        2 * measured["body/policy/external_reward_mean"], rel=1e-5
    )
    for row in scores_of(simulation.run_dir):
        assert -1 <= row["external_reward"] <= 1
        assert len(row["external_reward_by_vertex"]) == 2
        assert row["landmarks"].keys() == {"left", "right"}


def test_experience_without_the_reward_that_is_trained_on_is_refused_by_name(
    episodic: Make, simulate: Simulate
) -> None:
    simulation = simulate(episodic(goals={"external_weight": 1.0}))
    simulation.start_all(actors=0)
    simulation.settings = episodic()
    simulation.start("actor", "actor-other")

    def refused() -> bool:
        newest = simulation.statuses("policy_learner-0")[-1:]
        return any(status.refused.get("bad-array", 0) > 0 for _, status in newest)

    simulation.until(refused)
    said = simulation.statuses("policy_learner-0")[-1][1].last_error
    assert "it has no external_reward" in said
    assert "goals.external_weight" in said


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"actors": {"envs_per_actor": 4096, "segment_steps": 4096}}, r"babble or walk of .* 201\.3 MB"),
        (
            {"evaluation": {"legs": 400_000, "leg_steps": 1}, "actors": {"envs_per_actor": 16}},
            r"evaluate of .* lower actors\.envs_per_actor or evaluation\.legs",
        ),
    ],
)
def test_segments_too_large_for_a_frame_are_refused_before_anything_is_done(
    episodic: Make, simulate: Simulate, settings: dict[str, Any], sentence: str
) -> None:
    simulation = simulate(episodic(**settings))
    with pytest.raises(SettingsError, match=sentence) as refused:
        simulation.start("actor", "actor-0")
    assert "\n" not in str(refused.value)


def test_a_sense_without_a_renderer_is_one_sentence(
    episodic: Make, simulate: Simulate, monkeypatch: pytest.MonkeyPatch
) -> None:
    def blind(*_: object) -> None:
        raise ValueError("there is no OpenGL here; install libosmesa6")

    monkeypatch.setattr(EpisodicWorld, "reset", blind)
    with pytest.raises(SettingsError, match="there is no OpenGL here"):
        simulate(episodic()).start("actor", "actor-0")


@pytest.mark.parametrize("service", ["actor", "policy_learner"])
def test_a_weight_for_a_reward_that_there_is_not_is_refused_at_the_start(
    tiny: RunSettings, simulate: Simulate, service: str
) -> None:
    goals = tiny.goals.model_copy(update={"external_weight": 0.5})
    simulation = simulate(tiny.model_copy(update={"goals": goals}))
    with pytest.raises(SettingsError, match=r"goals\.external_weight is 0\.5, .* Cuboid has no reward"):
        simulation.start(service, f"{service}-0")


def test_without_a_task_no_reward_is_sent_and_none_is_scored(tiny: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(tiny)
    simulation.start_all(actors=1)
    simulation.until_all_ended()
    evaluated = simulation.segments(Phase.EVALUATE)
    assert evaluated
    assert all("external_reward" not in segment.arrays for segment in evaluated)
    assert all(row["external_reward"] is None for row in scores_of(simulation.run_dir))


@pytest.mark.parametrize("service", ["actor", "encoder_learner", "policy_learner"])
@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"world": WorldSettings(id="Sphere")}, "there is no world 'Sphere'"),
        ({"world": WorldSettings(id="Cuboid", parameters={"speed": "fast"})}, "Cuboid: "),
        ({"world": WorldSettings(id="Episodic")}, "observes 9, but the world has 0 to 1"),
    ],
)
def test_a_world_or_blocks_that_cannot_be_are_one_sentence(
    episodic: Make, simulate: Simulate, service: str, change: dict[str, Any], sentence: str
) -> None:
    settings = episodic()
    blocks = [settings.block[0].model_copy(update={"observes": [9]})]
    simulation = simulate(settings.model_copy(update={"block": blocks, **change}))
    with pytest.raises(SettingsError, match=sentence):
        simulation.start(service, f"{service}-0")
