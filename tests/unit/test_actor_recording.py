"""What an actor records of its steps: each of them once, as it was, in every phase and at every level."""

from typing import Any

import numpy as np
import pytest

from babble.legs import Witness
from babble.worlds.batch import Step
from protocol.messages import Phase, PhaseAnnounced
from services.actor.recording import Recording, Tee
from tests.unit import test_actor_episodes as leaves
from tests.unit import test_actor_levels as levels

EVERY_PHASE = [Phase.BABBLE, Phase.GROUND, Phase.WALK, Phase.PRACTISE, Phase.EVALUATE]
CHUNK_STEPS = 7


def announced(phase: Phase, term: int = 1) -> PhaseAnnounced:
    return PhaseAnnounced(
        run="r", term=term, block="all", life="coordinator-0", seq=0, phase=phase, blocks={}
    )


class Recorded:
    """Acting in one phase of an episodic world: the rows, and what the world itself went through."""

    def __init__(self, level: int, phase: Phase, *, every_steps: int = 1, **parameters: Any) -> None:
        stage: Any = levels if level else leaves
        self.columns = stage.COLUMNS
        self.recording = Recording(every_steps=every_steps, chunk_steps=CHUNK_STEPS, columns=self.columns)
        self.acting = stage.Acting(phase, witness=self.recording, **parameters)
        self.recording.enter(announced(phase), self.acting.world)
        self.happened: list[tuple[np.ndarray, Step]] = []
        self._step = self.acting.world.step
        self.acting.world.step = self._noted

    def _noted(self, action: np.ndarray) -> Step:
        before = self.acting.world.state()
        step: Step = self._step(action)
        self.happened.append((before, step))
        return step

    def act(self, env_steps: int) -> "Recorded":
        """So many environment steps, and what is left of a decision then; then the term is over."""
        wanted = len(self.happened) + env_steps
        while len(self.happened) < wanted:
            self.acting.collector.advance(1)
        self.recording.close()
        return self

    def rows(self) -> dict[str, np.ndarray]:
        """All rows (N, E, ...), and in "step" the environment step of each."""
        chunks = list(self.recording.full)
        rows: dict[str, np.ndarray] = {
            name: np.concatenate([chunk.arrays[name] for chunk in chunks]) for name in chunks[0].arrays
        }
        every = self.recording._every
        rows["step"] = np.concatenate([c.first_step + every * np.arange(c.steps) for c in chunks])
        return rows


@pytest.mark.parametrize("phase", EVERY_PHASE)
@pytest.mark.parametrize("level", [0, 1])
def test_each_environment_step_is_a_row_with_the_state_before_it_and_the_reward_it_gave(
    level: int, phase: Phase
) -> None:
    recorded = Recorded(level, phase, limit_steps=8).act(60)
    rows, happened = recorded.rows(), recorded.happened
    assert len(happened) * recorded.columns == recorded.acting.collector.env_steps
    assert rows["step"].tolist() == list(range(len(happened)))
    np.testing.assert_array_equal(rows["state"], [before for before, _ in happened])
    np.testing.assert_array_equal(rows["external_reward"], [step.external_reward for _, step in happened])
    assert {chunk.steps for chunk in list(recorded.recording.full)[:-1]} == {CHUNK_STEPS}


@pytest.mark.parametrize("phase", EVERY_PHASE)
@pytest.mark.parametrize("level", [0, 1])
def test_an_episode_has_one_number_as_long_as_it_goes_on(level: int, phase: Phase) -> None:
    """Above the leaves episodes end within decisions too, and bodies are begun anew at the end of those."""
    rows = Recorded(level, phase, limit_steps=8, fails_every=29).act(100).rows()
    episode, age, step = rows["episode"], rows["state"][..., 1], rows["step"]
    same = episode[1:] == episode[:-1]
    np.testing.assert_array_equal(same, (age[1:] == age[:-1] + 1) & (np.diff(step) == 1)[:, None])
    assert (np.diff(episode, axis=0) >= 0).all()


@pytest.mark.parametrize("phase", EVERY_PHASE)
@pytest.mark.parametrize("level", [0, 1])
def test_of_a_simulation_that_breaks_down_the_open_rows_are_dropped_and_counted(
    level: int, phase: Phase
) -> None:
    recorded = Recorded(level, phase, fails_every=23).act(70)
    rows, columns = recorded.rows(), recorded.columns
    assert len(set(rows["step"].tolist())) == len(rows["step"]), "no step twice"
    assert len(rows["step"]) * columns + recorded.recording.dropped_rows == len(recorded.happened) * columns
    assert recorded.acting.breakdowns.episodes > 1
    # 22 good steps: three chunks of 7, one open row, and that of the step that broke down.
    assert recorded.recording.dropped_rows == 2 * columns * recorded.acting.breakdowns.episodes
    for row, step in enumerate(rows["step"].tolist()):
        np.testing.assert_array_equal(rows["state"][row], recorded.happened[step][0])
    for name, array in rows.items():
        assert np.isfinite(array).all(), name


@pytest.mark.parametrize("level", [0, 1])
def test_every_third_step_is_a_row_whatever_is_dropped_in_between(level: int) -> None:
    recorded = Recorded(level, Phase.PRACTISE, every_steps=3, fails_every=50).act(120)
    rows = recorded.rows()
    assert (rows["step"] % 3 == 0).all()
    kept = len(rows["step"]) * recorded.columns
    due = -(-len(recorded.happened) // 3) * recorded.columns
    assert kept + recorded.recording.dropped_rows == due
    for row, step in enumerate(rows["step"].tolist()):
        np.testing.assert_array_equal(rows["state"][row], recorded.happened[step][0])


def test_a_block_that_acts_on_its_latent_is_recorded_with_what_it_acts_on() -> None:
    rows = Recorded(0, Phase.PRACTISE, limit_steps=8).act(30).rows()
    np.testing.assert_allclose(rows["latent/body"][..., 0], 0.5 + 0.4 * rows["state"][..., 0], atol=1e-6)
    going = rows["goal/body"][..., 0] - rows["goal/body"][..., 1]
    ahead = np.diff(rows["state"][..., 0], axis=0)
    same = np.diff(rows["episode"], axis=0) == 0
    np.testing.assert_array_equal(
        np.sign(ahead[same]), going[:-1][same], "the row's goal is that of its step"
    )


def test_above_the_leaves_each_row_has_what_each_block_last_acted_on() -> None:
    rows = Recorded(1, Phase.PRACTISE).act(60).rows()
    assert {"latent/top", "goal/top", "latent/leaf", "goal/leaf"} < rows.keys()
    np.testing.assert_allclose(rows["latent/leaf"][..., 0], 0.5 + 0.4 * rows["state"][..., 0], atol=1e-6)
    decided = rows["state"][:: levels.HELD, :, 0].repeat(levels.HELD, axis=0)
    np.testing.assert_allclose(rows["latent/top"][..., 0], levels.latent_at(decided), atol=1e-6)
    assert not (rows["latent/top"][1:] == rows["latent/top"][:-1]).all()


@pytest.mark.parametrize(("level", "named"), [(0, set()), (1, {"latent/leaf", "goal/leaf"})])
def test_who_babbles_acts_on_no_latent(level: int, named: set[str]) -> None:
    rows = Recorded(level, Phase.BABBLE).act(9).rows()
    assert {name for name in rows if "/" in name} == named


def test_a_term_ends_its_last_chunk_and_the_steps_of_a_life_are_counted_on() -> None:
    recorded = Recorded(0, Phase.PRACTISE)
    recorded.act(10)
    recorded.recording.enter(announced(Phase.EVALUATE, 2), recorded.acting.world)
    recorded.act(5)
    chunks = recorded.recording.full
    assert [(c.announced.term, c.first_step, c.steps) for c in chunks] == [(1, 0, 7), (1, 7, 3), (2, 10, 5)]
    last, first = chunks[1].arrays["episode"][-1], chunks[2].arrays["episode"][0]
    assert (first > last).all(), "an episode is of one term"


class Looking(Witness):
    """Counts what it sees."""

    def __init__(self) -> None:
        self.looking = True
        self.seen: list[float] = []
        self.cuts = self.passes = 0

    def see(self, observation: np.ndarray, seen: Any) -> None:
        self.seen.append(float(observation[0, 0]))

    def passed(self) -> None:
        self.passes += 1

    def cut(self) -> None:
        self.cuts += 1


@pytest.mark.parametrize(("stage", "passes"), [(leaves, 0), (levels, 20)])
def test_views_see_what_they_look_at_while_all_is_recorded(stage: Any, passes: int) -> None:
    recording, views = Recording(every_steps=1, chunk_steps=4, columns=stage.COLUMNS), Looking()
    tee = Tee(recording, views)  # type: ignore[arg-type]
    acting = stage.Acting(Phase.PRACTISE, witness=tee, limit_steps=10)
    recording.enter(announced(Phase.PRACTISE), acting.world)
    while acting.world.steps < 20:
        views.looking = not views.looking
        acting.collector.advance(1)
    recording.close()
    assert sum(chunk.steps for chunk in recording.full) == 20
    assert 0 < len(views.seen) < 20
    assert views.passes == passes
    assert views.cuts >= 2, "an episode ended twice"
