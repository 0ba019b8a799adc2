"""An actor's evaluation: in fresh worlds, a little at a time, with the models it began with."""

import numpy as np
import pytest

from babble.breakdowns import Breakdowns
from babble.legs import Witness
from protocol.messages import Phase
from services.actor.config import Body, body_of
from services.actor.evaluation import EvaluationCollector
from services.actor.stages import Term
from services.runtime.settings import parse
from tests.unit.actor_doubles import Shelf

SETTINGS = parse(
    {
        "scenario": "test",
        "actors": {"envs_per_actor": 3, "segment_steps": 12},
        "evaluation": {"columns": 3, "legs": 3, "leg_steps": 6},
    },
    origin="test",
)


@pytest.fixture
def shelf() -> Shelf:
    shelf = Shelf()
    shelf.put(1)
    return shelf


def collector_of(shelf: Shelf, body: Body | None = None) -> EvaluationCollector:
    body = body or body_of(SETTINGS, np.random.SeedSequence(9))
    return EvaluationCollector(
        Term.of(Phase.EVALUATE, ["body"], SETTINGS),
        body,
        shelf,
        np.random.default_rng(2),
        breakdowns=Breakdowns("Cuboid"),
        witness=Witness(),
    )


def test_legs_start_at_random_places_and_each_has_another_goal(shelf: Shelf) -> None:
    (finished,) = collector_of(shelf).advance(18)
    assert finished.arrays["posture"].shape == (3, 3, 3)
    assert len(np.unique(finished.arrays["start_posture"], axis=0)) == 3, "columns start at random places"
    goals = finished.arrays["goal"]
    assert (goals[1:] != goals[:-1]).all(), "each leg has another goal than the last"
    assert (finished.steps, finished.columns, finished.policy) == (18, 3, "mean")


def test_however_it_is_sliced_the_legs_are_the_same(shelf: Shelf) -> None:
    (at_once,) = collector_of(shelf).advance(100)
    sliced = collector_of(shelf)
    assert sliced.at_border()
    for step in range(1, 18):
        assert sliced.advance(1) == []
        assert not sliced.at_border()
        assert sliced.env_steps == 3 * step
    (finished,) = sliced.advance(1)
    assert sliced.at_border()
    for name, array in at_once.arrays.items():
        np.testing.assert_array_equal(finished.arrays[name], array)


def test_a_walk_that_has_begun_keeps_its_models_and_its_kind_of_actions(shelf: Shelf) -> None:
    collector = collector_of(shelf)
    collector.advance(5)
    shelf.put(2)
    collector.mode = "sampled"
    (first,) = collector.advance(13)
    (second,) = collector.advance(18)
    assert [(each.policy_version, each.policy) for each in (first, second)] == [(1, "mean"), (2, "sampled")]
    assert (first.first_step, second.first_step) == (0, 18)
