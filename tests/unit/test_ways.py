"""How actors act under the switches of the coverage study: goals, and noise whose colour changes."""

from typing import Any

import numpy as np
import pytest

from babble.breakdowns import Breakdowns
from babble.legs import Seen, Witness
from babble.noise import Coloured
from protocol.messages import Phase
from services.actor.collect import SegmentCollector, collector_of
from services.actor.config import Body
from services.actor.evaluation import EvaluationCollector
from services.actor.stages import Term, has_episodes
from services.actor.ways import RandomWay
from services.runtime.settings import RunSettings, parse
from tests.simulated.episodic import EpisodicWorld
from tests.unit.actor_doubles import Shelf
from tests.unit.trees import tree_on

COLUMNS, ROWS, EPISODE = 4, 60, 7
ENDLESS = {"id": "Cuboid"}
ENDING = {"id": "MimoFinger", "parameters": {"episode_steps": 5}}
"""What the settings say; the world of these tests is an `EpisodicWorld` in any case."""


def settings_of(world: dict[str, Any], **changes: Any) -> RunSettings:
    table = {
        "scenario": "test",
        "world": world,
        "actors": {"envs_per_actor": COLUMNS, "segment_steps": ROWS},
        "goals": {"kind": "random", "period_steps": 10, "walk_steps_per_goal": 10},
        "evaluation": {"columns": COLUMNS, "legs": 3, "leg_steps": 10},
    }
    return parse(table | changes, origin="test")


class Noting(Witness):
    """Keeps the goals that were acted on."""

    looking = True

    def __init__(self) -> None:
        self.goals: list[np.ndarray] = []

    def see(self, observation: np.ndarray, seen: Any) -> None:
        known: Seen | None = seen["body"]
        assert known is not None
        self.goals.append(known[1])


def acted(phase: Phase, world: dict[str, Any], limit_steps: int) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """The goals of each step of a segment, and its arrays."""
    settings, witness = settings_of(world), Noting()
    body = Body.of(
        EpisodicWorld(COLUMNS, np.random.default_rng(0), limit_steps=limit_steps), tree_on(settings, 2, 1)
    )
    shelf, rng, breakdowns = Shelf(body.tree), np.random.default_rng(1), Breakdowns("test")
    shelf.put(1, actuators=1)
    term = Term.of(phase, ["body"], settings)
    collector: Any
    if phase is Phase.EVALUATE:
        collector = EvaluationCollector(term, body, shelf, rng, breakdowns=breakdowns, witness=witness)
    else:
        collector = collector_of(
            term, body, shelf, rng, observation=body.world.reset(), breakdowns=breakdowns, witness=witness
        )
    (finished,) = collector.advance(ROWS)
    return np.stack(witness.goals), finished.arrays


@pytest.mark.parametrize("phase", [Phase.GROUND, Phase.PRACTISE, Phase.WALK])
def test_random_goals_are_points_that_hold_for_an_episode_and_then_differ(phase: Phase) -> None:
    goals, arrays = acted(phase, ENDING, EPISODE)
    np.testing.assert_allclose(goals.sum(axis=2), 1, atol=1e-6)
    assert ((goals > 0) & (goals < 1)).all(), "none of them is a vertex"
    changed = (goals[1:] != goals[:-1]).any(axis=2)
    border = np.arange(1, ROWS) % EPISODE == 0
    assert (changed == border[:, None]).all()
    for one in range(COLUMNS - 1):
        assert (goals[:, one] != goals[:, one + 1]).any()
    if phase is not Phase.WALK:
        np.testing.assert_array_equal(arrays["goal"], goals)
        np.testing.assert_array_equal(arrays["truncated"][:-1].astype(bool), changed)


@pytest.mark.parametrize("phase", [Phase.PRACTISE, Phase.WALK])
def test_without_episodes_random_goals_hold_for_their_period_and_a_switch_is_a_truncation(
    phase: Phase,
) -> None:
    goals, arrays = acted(phase, ENDLESS, 0)
    changed = (goals[1:] != goals[:-1]).any(axis=2)
    for column in changed.T:
        assert set(np.diff(np.flatnonzero(column))) == {10}
    if phase is Phase.PRACTISE:
        np.testing.assert_array_equal(arrays["truncated"][:-1].astype(bool), changed)
        np.testing.assert_array_equal(arrays["latent"][1:], arrays["next_latent"][:-1])


def test_evaluation_goes_to_vertices_all_the_same() -> None:
    goals, arrays = acted(Phase.EVALUATE, ENDING, 0)
    assert set(np.unique(goals)) == {0.0, 1.0}
    assert set(np.unique(arrays["goal"])) <= {0, 1}


def test_a_world_has_episodes_where_it_is_cut_off() -> None:
    assert has_episodes(settings_of(ENDING))
    assert has_episodes(settings_of({"id": "MimoRollover"})), "500 steps are its default"
    assert not has_episodes(settings_of({"id": "MimoRollover", "parameters": {"episode_steps": 0}}))
    assert not has_episodes(settings_of(ENDLESS))


def babbling(kind: str) -> tuple[RandomWay, SegmentCollector]:
    noise = {"kind": kind, "exponents": [0.2, 1.2], "block_steps": 16, "scale": 0.3}
    settings = settings_of(ENDLESS, babbling=noise)
    body = Body.of(EpisodicWorld(COLUMNS, np.random.default_rng(0)), tree_on(settings, 2, 1))
    collector = collector_of(
        Term.of(Phase.BABBLE, ["body"], settings), body, Shelf(body.tree), np.random.default_rng(1),
        observation=body.world.reset(), breakdowns=Breakdowns("test"), witness=Witness(),
    )  # fmt: skip
    way = collector._way
    assert isinstance(way, RandomWay)
    return way, collector


def test_the_colour_of_babbling_follows_the_progress_of_the_phase() -> None:
    way, collector = babbling("coloured")
    (noise,) = way._noises.values()
    assert isinstance(noise, Coloured)
    assert noise.beta == pytest.approx(0.2)
    way.note_progress(0.5)
    assert noise.beta == pytest.approx(0.7)
    assert len(collector.advance(ROWS)) == 1
    way.note_progress(1.0)
    assert noise.beta == pytest.approx(1.2)


def test_other_noises_are_as_they_were_whatever_the_progress() -> None:
    (told, told_collector), (_, collector) = babbling("ou"), babbling("ou")
    told.note_progress(0.5)
    (one,), (other,) = told_collector.advance(ROWS), collector.advance(ROWS)
    np.testing.assert_array_equal(one.arrays["observation"], other.arrays["observation"])
