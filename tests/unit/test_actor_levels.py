"""What an actor records above the leaves when episodes end, or the simulation breaks down, within a step."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from babble.breakdowns import Breakdowns
from babble.legs import Seen, Witness
from protocol.messages import Phase
from services.actor.collect import collector_of
from services.actor.config import Body
from services.actor.evaluation import EvaluationCollector
from services.actor.stages import Term
from services.runtime.settings import RunSettings, parse
from tests.simulated.episodic import SPEED, EpisodicWorld
from tests.unit.actor_doubles import Shelf
from tests.unit.trees import tree_on

ROWS, COLUMNS, HELD = 6, 2, 5
"""HELD environment steps is what an action of the level is held for."""
ACTING = (Phase.BABBLE, Phase.WALK, Phase.GROUND, Phase.PRACTISE)


def settings_of(**top: Any) -> RunSettings:
    table = {
        "scenario": "test",
        "actors": {"envs_per_actor": COLUMNS, "segment_steps": ROWS},
        "goals": {"period_steps": 1_000_000, "walk_steps_per_goal": 50, "external_weight": 1.0},
        "evaluation": {"columns": COLUMNS, "legs": 3, "leg_steps": 10},
        "block": [{"name": "leaf"}, {"name": "top", "children": ["leaf"], **top}],
        "level": [{}, {"decision_steps": HELD}],
    }
    return parse(table, origin="test")


class Acting:
    """Collecting in one phase of a level above a leaf; the top's latent is a line over the place."""

    def __init__(
        self,
        phase: Phase,
        settings: RunSettings | None = None,
        witness: Witness | None = None,
        **parameters: Any,
    ) -> None:
        settings = settings or settings_of()
        self.world = EpisodicWorld(COLUMNS, np.random.default_rng(0), **parameters)
        body = Body.of(self.world, tree_on(settings, 2, 1))
        self.breakdowns = Breakdowns("Episodic")
        shelf = Shelf(body.tree)
        shelf.put(1, actuators=1, block="leaf")
        shelf.put(1, actuators=2, block="top")
        term, rng = Term.of(phase, ["top"], settings), np.random.default_rng(1)
        how: dict[str, Any] = {"breakdowns": self.breakdowns, "witness": witness or Witness()}
        if phase is Phase.EVALUATE:
            self.collector: Any = EvaluationCollector(term, body, shelf, rng, **how)
        else:
            self.collector = collector_of(term, body, shelf, rng, observation=self.world.reset(), **how)

    def segments(self, count: int) -> list[Any]:
        found: list[Any] = []
        while len(found) < count:
            found += self.collector.advance(1)
        return found

    def arrays(self) -> dict[str, np.ndarray]:
        return self.segments(1)[0].arrays  # type: ignore[no-any-return]


def latent_at(place: np.ndarray) -> np.ndarray:
    """The top's latent, in its first component."""
    return 0.5 + 0.4 * (0.5 + 0.4 * place)


def test_a_decision_ends_where_the_episode_within_it_ended_and_the_next_begins_at_its_start() -> None:
    arrays = Acting(Phase.PRACTISE, limit_steps=8).arrays()
    up = arrays["goal"][0, :, 0] * 2 - 1
    np.testing.assert_array_equal(arrays["truncated"][:, 0], [0, 1] * 3)
    # Five steps of the body, and the three that are left until the episode ends.
    for row, place in [(0, 5 * SPEED), (1, 8 * SPEED), (2, 5 * SPEED)]:
        np.testing.assert_allclose(arrays["next_latent"][row, :, 0], latent_at(place * up), atol=1e-6)
    np.testing.assert_allclose(arrays["latent"][[0, 2, 4], :, 0], latent_at(np.float32(0)), atol=1e-6)
    np.testing.assert_array_equal(arrays["latent"][[1, 3, 5]], arrays["next_latent"][[0, 2, 4]])
    # The reward of a step is the place it arrives at: 0.1 to 0.5, then 0.6 to 0.8.
    np.testing.assert_allclose(arrays["external_reward"][:2], [0.3 * up, 0.7 * up], atol=1e-6)


def test_episodes_shorter_than_a_decision_all_begin_anew() -> None:
    acting = Acting(Phase.PRACTISE, limit_steps=2)
    arrays = acting.arrays()
    assert len(acting.world.restarted) == 3 * ROWS, "after 2 and 4 of the five steps, and at the end of them"
    assert arrays["truncated"].all()
    assert np.abs(arrays["next_latent"][..., 0] - latent_at(np.float32(0))).max() == pytest.approx(0.16 * 0.2)


def test_the_posture_of_a_leg_is_that_of_its_latent_where_an_episode_ended_in_its_last_step() -> None:
    arrays = Acting(Phase.EVALUATE, limit_steps=8).arrays()
    towards = 1.0 - 2.0 * arrays["goal"]
    # From a random start to the first vertex; from there on, each leg begins with an episode.
    np.testing.assert_allclose(arrays["posture"][1:, :, 0], 0.8 * towards[1:], atol=1e-6)
    np.testing.assert_allclose(arrays["latent"][..., 0], latent_at(arrays["posture"][..., 0]), atol=1e-6)


@pytest.mark.parametrize("phase", [*ACTING, Phase.EVALUATE])
def test_steps_of_a_decision_that_a_breakdown_left_undone_are_not_counted(phase: Phase) -> None:
    acting = Acting(phase, fails_every=16 if phase in (Phase.BABBLE, Phase.WALK) else 47)
    found = acting.segments(6)
    assert acting.breakdowns.episodes
    assert acting.collector.env_steps == acting.world.steps * COLUMNS
    for segment in found:
        for name, array in segment.arrays.items():
            assert np.isfinite(array).all(), name
    firsts = [segment.first_step for segment in found]
    assert firsts == sorted(set(firsts))
    assert firsts[-1] > (len(found) - 1) * found[0].steps, "the gap can be seen"


@pytest.mark.parametrize("phase", ACTING)
def test_after_a_breakdown_whoever_acts_next_goes_on_from_where_the_body_is(phase: Phase) -> None:
    acting = Acting(phase, fails_every=11)
    while not acting.breakdowns.segments:
        acting.collector.advance(1)
    place = acting.collector.body_observation[:, 0]
    np.testing.assert_allclose(place, acting.world.posture()[:, 0])
    assert place[0] == 0


class Watching(Witness):
    """Follows the first column from one break to the next."""

    looking = True

    def __init__(self) -> None:
        self.ways: list[list[float]] = [[]]
        self.goals: list[np.ndarray] = []
        self.steps = 0

    def see(self, observation: np.ndarray, seen: Mapping[str, Seen | None]) -> None:
        self.ways[-1].append(float(observation[0, 0]))
        leaf = seen["leaf"]
        assert leaf is not None
        self.goals.append(leaf[1])

    def passed(self) -> None:
        self.steps += 1

    def cut(self) -> None:
        self.ways.append([])


@pytest.mark.parametrize("phase", [*ACTING, Phase.EVALUATE])
def test_no_way_that_people_see_leads_across_the_end_of_an_episode(phase: Phase) -> None:
    witness = Watching()
    acting = Acting(phase, witness=witness, limit_steps=8)
    acting.segments(2)
    ways = [way for way in witness.ways if way]
    assert sum(map(len, ways)) == witness.steps == acting.world.steps
    for way in ways:
        assert len(way) <= 8
        assert np.abs(np.diff(way)).max(initial=0) <= SPEED + 1e-6, "a way has no gaps"


def test_babbling_sends_limbs_to_vertices_whatever_the_form_of_the_policys_goals() -> None:
    witness = Watching()
    Acting(Phase.BABBLE, settings_of(policy={"subgoals": "softmax"}), witness).segments(4)
    np.testing.assert_array_equal(np.max(witness.goals, axis=2), 1)
    practised = Watching()
    Acting(Phase.PRACTISE, settings_of(policy={"subgoals": "softmax"}), practised).segments(1)
    assert np.max(practised.goals) < 1
