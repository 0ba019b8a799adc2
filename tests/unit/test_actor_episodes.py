"""What an actor makes of episodes that end, and of simulations that break down."""

from itertools import accumulate, chain
from typing import Any

import numpy as np
import pytest

from babble.breakdowns import MOST_IN_A_ROW, Breakdowns, UnstableError
from babble.legs import Witness
from protocol.messages import Phase
from services.actor.collect import collector_of
from services.actor.config import Body
from services.actor.evaluation import EvaluationCollector
from services.actor.stages import Term
from services.runtime.settings import RunSettings, parse
from tests.simulated.episodic import EpisodicWorld
from tests.unit.actor_doubles import Shelf
from tests.unit.trees import tree_on

STEPS, COLUMNS = 12, 3
WALKING = (Phase.BABBLE, Phase.WALK)
ACTING = (Phase.BABBLE, Phase.WALK, Phase.GROUND, Phase.PRACTISE)


def settings_of(**tables: Any) -> RunSettings:
    table = {
        "scenario": "test",
        "actors": {"envs_per_actor": COLUMNS, "segment_steps": STEPS},
        "goals": {"period_steps": 1_000_000, "walk_steps_per_goal": 50},
        "evaluation": {"columns": COLUMNS, "legs": 3, "leg_steps": 6},
    }
    return parse(table | tables, origin="test")


class Acting:
    """An actor's collecting in one phase of an episodic world."""

    def __init__(
        self,
        phase: Phase,
        settings: RunSettings | None = None,
        witness: Witness | None = None,
        **parameters: Any,
    ) -> None:
        settings = settings or settings_of()
        self.world = EpisodicWorld(COLUMNS, np.random.default_rng(0), **parameters)
        tree = tree_on(settings, self.world.observation_size, self.world.action_size)
        self.body = Body.of(self.world, tree)
        self.breakdowns = Breakdowns("Episodic")
        self.shelf = Shelf()
        self.shelf.put(1, actuators=1)
        rng, witness = np.random.default_rng(1), witness or Witness()
        term = Term.of(phase, ["body"], settings)
        if phase is Phase.EVALUATE:
            self.collector: Any = EvaluationCollector(
                term, self.body, self.shelf, rng, breakdowns=self.breakdowns, witness=witness
            )
        else:
            self.collector = collector_of(
                term,
                self.body,
                self.shelf,
                rng,
                observation=self.world.reset(),
                breakdowns=self.breakdowns,
                witness=witness,
            )

    def segments(self, count: int) -> list[Any]:
        found: list[Any] = []
        while len(found) < count:
            found += self.collector.advance(1)
        return found

    def arrays(self) -> dict[str, np.ndarray]:
        return self.segments(1)[0].arrays


@pytest.mark.parametrize("phase", WALKING)
def test_an_episode_that_is_cut_off_begins_anew_under_the_next_number(phase: Phase) -> None:
    arrays = Acting(phase, limit_steps=5).arrays()
    np.testing.assert_array_equal(arrays["episode"][:, 0], [0] * 5 + [1] * 5 + [2] * 2)
    age = np.rint(arrays["observation"][:, 0, 1] * 100)
    np.testing.assert_array_equal(age, [0, 1, 2, 3, 4] * 2 + [0, 1])


def test_columns_end_each_at_its_own_time() -> None:
    acting = Acting(Phase.WALK, ends_at=0.45)
    acting.world._place[0] = 0.3  # the goal is not known, so both sides are near
    acting.world._place[1] = -0.3
    episode = acting.arrays()["episode"]
    assert len({tuple(column) for column in episode.T}) > 1
    assert (np.diff(episode, axis=0) >= 0).all()
    assert all(not flags.all() for flags in acting.world.restarted[:1])


@pytest.mark.parametrize("kind", ["truncated", "terminated"])
def test_a_practice_episode_ends_on_the_latent_it_arrived_at_and_goes_on_from_the_start(kind: str) -> None:
    ends = {"limit_steps": 4} if kind == "truncated" else {"ends_at": 0.35}
    arrays = Acting(Phase.PRACTISE, **ends).arrays()
    flags = arrays[kind].astype(bool)
    other = arrays["terminated" if kind == "truncated" else "truncated"]
    assert flags[3].all(), "four steps of 0.1"
    assert not other.any()
    arrived, first = arrays["next_latent"][:-1][flags[:-1]], arrays["latent"][1:][flags[:-1]]
    np.testing.assert_allclose(np.abs(arrived[:, 0] - 0.5), 0.4 * 0.4, atol=1e-6)
    np.testing.assert_allclose(first, 0.5, err_msg="the next step is taken from the start of an episode")
    going_on = ~flags[:-1]
    np.testing.assert_array_equal(arrays["next_latent"][:-1][going_on], arrays["latent"][1:][going_on])


@pytest.mark.parametrize("phase", ACTING)
def test_of_a_simulation_that_breaks_down_nothing_is_published(phase: Phase) -> None:
    acting = Acting(phase, fails_every=31)
    found = acting.segments(4)
    assert acting.world.steps == 12 * 4 + 7, "seven steps of the third segment were for nothing"
    assert (acting.breakdowns.segments, acting.breakdowns.episodes) == (1, 1)
    for segment in found:
        for name, array in segment.arrays.items():
            assert np.isfinite(array).all(), name
    assert [segment.first_step for segment in found] == [0, 12, 31, 43], "the gap can be seen"
    assert acting.collector.env_steps == acting.world.steps * COLUMNS
    np.testing.assert_array_equal(acting.world.restarted, [[True, False, False]])


@pytest.mark.parametrize("phase", WALKING)
def test_after_a_breakdown_all_columns_are_in_a_new_episode(phase: Phase) -> None:
    found = Acting(phase, fails_every=31).segments(3)
    assert not found[1].arrays["episode"].any()
    assert (found[2].arrays["episode"] == 1).all(), "steps are missing in each of them"


def test_after_a_breakdown_practice_begins_with_the_latent_of_where_the_columns_are() -> None:
    acting = Acting(Phase.PRACTISE, fails_every=31)
    acting.segments(2)
    place = np.zeros(COLUMNS)
    while acting.world.steps < 31:
        acting.collector.advance(1)
        place = acting.world._place.copy()
    latent = acting.arrays()["latent"][0]
    np.testing.assert_allclose(latent[:, 0], 0.5 + 0.4 * place, atol=1e-6)
    assert place[0] == 0


@pytest.mark.parametrize("phase", [*ACTING, Phase.EVALUATE])
def test_a_simulation_that_always_breaks_down_is_given_up_in_one_sentence(phase: Phase) -> None:
    acting = Acting(phase, fails_every=11)
    with pytest.raises(UnstableError, match="simulation of Episodic broke down 20 times") as refused:
        acting.segments(1)
    assert acting.world.steps == MOST_IN_A_ROW * 11
    assert "smaller timestep, weaker actuators or a lower gain" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_now_and_then_a_breakdown_is_no_reason_to_end() -> None:
    acting = Acting(Phase.PRACTISE, fails_every=19)
    acting.segments(60)
    assert acting.breakdowns.segments > MOST_IN_A_ROW


def test_an_evaluation_in_which_a_column_breaks_down_begins_again() -> None:
    acting = Acting(Phase.EVALUATE, fails_every=25)
    acting.segments(1)
    (second,) = acting.segments(1)
    assert acting.world.steps == 18 + 7 + 18
    assert (acting.breakdowns.segments, acting.breakdowns.episodes) == (1, 1)
    for name, array in second.arrays.items():
        assert np.isfinite(array).all(), name
    assert second.arrays["posture"].shape == (3, COLUMNS, 1)
    assert second.first_step == 18 + 7, "the steps that were for nothing count too"
    assert acting.collector.env_steps == acting.world.steps * COLUMNS


def test_an_episode_that_ends_in_an_evaluation_begins_anew_and_the_leg_goes_on() -> None:
    acting = Acting(Phase.EVALUATE, limit_steps=4)
    arrays = acting.arrays()
    towards = 1.0 - 2.0 * arrays["goal"]
    np.testing.assert_allclose(arrays["posture"][0, :, 0], 0.2 * towards[0], atol=1e-6)
    # The second leg's end is also the end of an episode: it counts where the body arrived.
    np.testing.assert_allclose(arrays["posture"][1, :, 0], 0.4 * towards[1], atol=1e-6)
    np.testing.assert_allclose(arrays["latent"][1, :, 0], 0.5 + 0.4 * arrays["posture"][1, :, 0], atol=1e-6)


def test_the_external_reward_of_a_leg_is_that_of_its_second_half() -> None:
    arrays = Acting(Phase.EVALUATE, limit_steps=6).arrays()
    towards = 1.0 - 2.0 * arrays["goal"]
    # From the middle the steps end at 0.1, 0.2 ... 0.6, and the reward is the place.
    np.testing.assert_allclose(arrays["external_reward"][1:], 0.5 * towards[1:], atol=1e-6)


class Looking(Witness):
    """Sees each step of the first column, and where its way is broken off."""

    looking = True

    def __init__(self) -> None:
        self.seen: list[Any] = []
        self.ways: list[list[float]] = [[]]

    def see(self, observation: np.ndarray, seen: Any) -> None:
        self.ways[-1].append(observation[0, 0])
        self.seen.append(seen["body"])

    def cut(self) -> None:
        self.ways.append([])


@pytest.mark.parametrize("phase", [*ACTING, Phase.EVALUATE])
def test_a_witness_sees_what_each_step_is_taken_on_and_where_an_episode_ends(phase: Phase) -> None:
    witness = Looking()
    acting = Acting(phase, witness=witness, limit_steps=5)
    acting.segments(1)
    ways = [way for way in witness.ways if way]
    assert [len(way) for way in ways[:2]] == [5, 5]
    assert sum(map(len, ways)) == acting.world.steps
    for way in ways:
        assert np.max(np.abs(np.diff(way))) <= 0.1 + 1e-6, "a way has no gaps"
    if phase is Phase.BABBLE:
        assert witness.seen == [None] * acting.world.steps
        return
    for latent, place in zip((seen[0] for seen in witness.seen), chain(*ways), strict=True):
        assert latent[0, 0] == pytest.approx(0.5 + 0.4 * place)
    assert all(goal.shape == (COLUMNS, 2) for _, goal in witness.seen)


@pytest.mark.parametrize("phase", [*ACTING, Phase.EVALUATE])
def test_a_witness_sees_a_way_end_where_the_simulation_breaks_down(phase: Phase) -> None:
    witness = Looking()
    acting = Acting(phase, witness=witness, fails_every=25)
    acting.segments(3)
    assert acting.breakdowns.episodes
    ended = list(accumulate(len(way) for way in witness.ways if way))
    assert 25 in ended, "the step that failed is the last of its way"
    assert ended[-1] == acting.world.steps


@pytest.mark.parametrize(("weight", "sent"), [(0.0, False), (0.5, True)])
def test_the_external_reward_travels_only_where_it_has_a_weight(weight: float, sent: bool) -> None:
    arrays = Acting(Phase.GROUND, settings_of(goals={"external_weight": weight})).arrays()
    assert ("external_reward" in arrays) == sent
    if sent:
        arrived = (arrays["next_latent"][:, :, 0] - 0.5) / 0.4
        np.testing.assert_allclose(arrays["external_reward"], arrived, atol=1e-5)
