"""An actor's segments: what is recorded, where goals switch, when models change."""

import numpy as np
import pytest

from babble.breakdowns import Breakdowns
from babble.legs import Witness
from babble.policy.goals import GoalClock
from protocol.messages import Phase
from services.actor.collect import SegmentCollector
from services.actor.collect import collector_of as collecting
from services.actor.config import Body, body_of, seeds_of
from services.actor.models import ModelShelf
from services.actor.stages import Term
from services.runtime.settings import parse
from tests.unit.actor_doubles import Shelf

SETTINGS = parse(
    {
        "scenario": "test",
        "actors": {"envs_per_actor": 3, "segment_steps": 12},
        "goals": {"period_steps": 5, "walk_steps_per_goal": 4},
        "evaluation": {"columns": 3, "legs": 3, "leg_steps": 6},
    },
    origin="test",
)


@pytest.fixture
def shelf() -> Shelf:
    shelf = Shelf()
    shelf.put(1)
    return shelf


@pytest.fixture
def body() -> Body:
    return body_of(SETTINGS, np.random.SeedSequence(0))


def collector_of(phase: Phase, body: Body, shelf: ModelShelf) -> SegmentCollector:
    return collecting(
        Term.of(phase, ["body"], SETTINGS),
        body,
        shelf,
        np.random.default_rng(1),
        observation=body.world.reset(),
        breakdowns=Breakdowns("test"),
        witness=Witness(),
    )


def test_babbling_records_where_the_body_was_before_each_step(body: Body, shelf: Shelf) -> None:
    collector = collector_of(Phase.BABBLE, body, shelf)
    assert collector.advance(11) == []
    (finished,) = collector.advance(5)
    observation = finished.arrays["observation"]
    assert observation.shape == (12, 3, 3)
    np.testing.assert_array_equal(observation[0], 0)
    assert finished.policy == "random"
    assert collector.env_steps == 36
    (following,) = collector.advance(12)
    assert following.first_step == 12
    step = np.abs(following.arrays["observation"][0] - observation[-1])
    assert (step <= 0.08 + 1e-6).all(), "the next segment goes on where the last one ended"


def test_a_practice_segment_is_one_chain_of_latents_with_truncations_where_goals_switch(
    body: Body, shelf: Shelf
) -> None:
    (finished,) = collector_of(Phase.PRACTISE, body, shelf).advance(12)
    arrays = finished.arrays
    np.testing.assert_array_equal(arrays["latent"][1:], arrays["next_latent"][:-1])
    changed = (arrays["goal"][1:] != arrays["goal"][:-1]).any(axis=2)
    assert changed.any()
    assert (arrays["truncated"][:-1][changed] == 1).all(), "a switch cuts the return at the step before it"
    assert (arrays["truncated"].sum(axis=0) >= 2).all(), "goals are drawn every 5 of 12 steps"
    assert not arrays["terminated"].any()


def test_the_goals_of_a_walk_last_their_steps_and_then_differ(body: Body, shelf: Shelf) -> None:
    (finished,) = collector_of(Phase.WALK, body, shelf).advance(12)
    x = finished.arrays["observation"][:, :, 0]
    directions = np.sign(np.diff(x, axis=0))
    assert (np.abs(np.diff(directions, axis=0)).sum(axis=0) >= 2).all(), "each column turned around"
    assert finished.policy == "sampled"


def test_models_change_only_at_the_border_of_a_segment(body: Body, shelf: Shelf) -> None:
    collector = collector_of(Phase.PRACTISE, body, shelf)
    collector.advance(6)
    shelf.put(2)
    (first,) = collector.advance(12)
    (second,) = collector.advance(12)
    assert (first.policy_version, second.policy_version) == (1, 2)
    assert (first.arrays["log_prob"] == 1).all()
    assert (second.arrays["log_prob"] == 2).all()


def test_replacing_an_actor_does_not_repeat_its_experience() -> None:
    drawn = {
        seeds_of(SETTINGS, index, life).generate_state(2).tobytes()
        for index, life in [(0, "actor-aa"), (1, "actor-aa"), (0, "actor-bb")]
    }
    assert len(drawn) == 3


def test_goal_clocks_of_the_columns_are_out_of_step() -> None:
    clock = GoalClock(64, 2, 100, np.random.default_rng(0))
    switches = [clock.tick() for _ in range(100)]
    assert np.sum(switches) == 64
    assert max(np.sum(step) for step in switches) < 10
