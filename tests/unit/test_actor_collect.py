"""An actor's segments: what is recorded, where goals switch, when models change."""

import numpy as np
import pytest

from babble.policy.goals import GoalClock
from protocol.messages import Phase
from services.actor.collect import EvaluationCollector, SegmentCollector, ways_of
from services.actor.config import Body, body_of, seeds_of
from services.actor.models import Held, ModelShelf
from services.runtime.settings import parse

SETTINGS = parse(
    {
        "scenario": "test",
        "actors": {"envs_per_actor": 3, "segment_steps": 12},
        "goals": {"period_steps": 5, "walk_steps_per_goal": 4},
        "evaluation": {"columns": 3, "legs": 3, "leg_steps": 6},
    },
    origin="test",
)


class Half:
    """An encoder: z_0 grows along x, so that it is known from the position."""

    latent_dim = 2

    def latent(self, observation: np.ndarray) -> np.ndarray:
        first = 0.5 + 0.4 * observation[:, :1]
        return np.concatenate([first, 1 - first], axis=1).astype(np.float32)


class Push:
    """A policy: towards the goal along x; tells its name by its log-probability."""

    def __init__(self, name: float) -> None:
        self.name = name

    def act(self, z, g, rng, mode="sampled"):  # type: ignore[no-untyped-def]
        action = np.zeros((len(z), 3), np.float32)
        action[:, 0] = g[:, 0] - g[:, 1]
        return action, np.full(len(z), self.name, np.float32)


class Shelf(ModelShelf):
    """A shelf with the models above."""

    def put(self, policy_version: int) -> None:
        self._held["body"] = Held(Half(), 1, Push(policy_version), policy_version)  # type: ignore[arg-type]


@pytest.fixture
def shelf() -> Shelf:
    shelf = Shelf(["body"])
    shelf.put(1)
    return shelf


@pytest.fixture
def body() -> Body:
    return body_of(SETTINGS, np.random.SeedSequence(0))


def collector_of(phase: Phase, body: Body, shelf: ModelShelf) -> SegmentCollector:
    ways = ways_of(phase, body, ["body"], shelf, SETTINGS, np.random.default_rng(1))
    return SegmentCollector(body, ways, segment_steps=12, observation=body.world.reset())


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


def test_an_evaluation_leaves_the_worlds_of_training_where_they_are(body: Body, shelf: Shelf) -> None:
    before = body.world.posture()
    fresh = body_of(SETTINGS, np.random.SeedSequence(9))
    collector = EvaluationCollector(fresh, ["body"], shelf, SETTINGS, np.random.default_rng(2))
    (finished,) = collector.advance(1)
    np.testing.assert_array_equal(body.world.posture(), before)
    assert finished.arrays["posture"].shape == (3, 3, 3)
    assert len(np.unique(finished.arrays["start_posture"], axis=0)) == 3, "columns start at random places"
    goals = finished.arrays["goal"]
    assert (goals[1:] != goals[:-1]).all(), "each leg has another goal than the last"


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
