"""Acting in one phase: steps of the worlds in, finished segments out; no wire, no clock.

All blocks of a level act in the same worlds at the same time, those below them as their limbs. Models are
swapped only at the border of a segment, so a segment has one encoder and one policy version.

When a simulation breaks down, the unfinished segments of all blocks are dropped: no number of it
is ever published. What follows is a new episode in every column, for there are steps missing.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from babble.breakdowns import Breakdowns
from babble.legs import Witness
from babble.levels import LevelWorld, Stage
from babble.segments import SegmentBuilder
from babble.worlds.batch import Flags, Step
from services.actor.config import Body
from services.actor.models import ModelShelf
from services.actor.recording import Recording
from services.actor.stages import Term, staged, way_of
from services.actor.ways import Floats, PolicyMode, Record, Way


@dataclass(frozen=True)
class Finished:
    """A finished segment of one block."""

    block: str
    arrays: Record
    policy: PolicyMode
    encoder_version: int
    policy_version: int
    steps: int
    """of the block: one for each row of the arrays"""
    columns: int
    first_step: int


class Collector(Protocol):
    """One phase's way of acting."""

    @property
    def env_steps(self) -> int:
        """Environment steps done so far, summed over the columns."""
        ...

    def at_border(self) -> bool:
        """True between two segments."""

    def note_progress(self, progress: float) -> None:
        """Hear which share of what is wanted in this term is held, of all actors: from 0 to 1."""

    def advance(self, steps: int) -> list[Finished]:
        """Step the worlds up to `steps` times, at most to the end of the segment.

        Raises `babble.breakdowns.UnstableError` if their simulation breaks down again and again.
        """


class SegmentCollector:
    """BABBLE, WALK, GROUND and PRACTISE: step, record, build segments."""

    def __init__(
        self,
        stage: Stage,
        way: Way,
        *,
        segment_steps: int,
        observation: Floats,
        breakdowns: Breakdowns,
    ) -> None:
        """`segment_steps` are those of the stage, `observation` (E, n) is the stage's at the beginning."""
        self._stage = stage
        self._way = way
        self._observation = observation
        self._breakdowns = breakdowns
        self._columns = stage.world.columns
        self._episode = np.zeros(self._columns, np.int32)
        self._segment_steps = segment_steps
        self._builders = {block: SegmentBuilder(segment_steps, self._columns) for block in stage.observed}
        self._steps = self._first_step = 0

    @property
    def env_steps(self) -> int:
        """See `Collector.env_steps`."""
        return self._columns * self._stage.env_steps(self._steps)

    @property
    def body_observation(self) -> Floats:
        """(E, n) the observation of the body itself, for whoever acts next."""
        world = self._stage.world
        return world.body_observation if isinstance(world, LevelWorld) else self._observation

    def at_border(self) -> bool:
        """True between two segments."""
        return all(len(builder) == 0 for builder in self._builders.values())

    def note_progress(self, progress: float) -> None:
        """See `Collector.note_progress`; noise may change with it."""
        self._way.note_progress(progress)

    def advance(self, steps: int) -> list[Finished]:
        """Step up to `steps` times; the blocks' segments end together, or are dropped together."""
        if self.at_border():
            self._first_step = self._steps
            self._way.begin_segment()
        for _ in range(steps):
            finished = self._step_once()
            if self.at_border():
                return finished
        return []

    def _step_once(self) -> list[Finished]:
        stage, before = self._stage, self._observation
        action = self._way.act(before)
        if stage.witness.looking:
            stage.witness.see(before, self._way.seen)
        step = stage.world.step(action)
        stage.witness.stepped(step)
        self._steps += 1
        if step.failed is not None and step.failed.any():
            self._drop(step, step.failed)
            return []
        finished = self._keep(before, step)
        ended = step.terminated | step.truncated
        self._observation = step.observation
        if ended.any():
            self._observation = stage.world.restart(ended)
            self._episode = self._episode + ended.astype(np.int32)
            stage.witness.begun(ended)
        if ended[0]:
            stage.witness.cut()
        return finished

    def _keep(self, before: Floats, step: Step) -> list[Finished]:
        finished = []
        for block, record in self._way.record(before, step, self._episode).items():
            arrays = self._builders[block].add(**record)
            if arrays is not None:
                finished.append(self._finish(block, arrays))
        if finished:
            self._breakdowns.finish()
        return finished

    def _drop(self, step: Step, failed: Flags) -> None:
        for builder in self._builders.values():
            builder.discard()
        self._breakdowns.note(failed, segments=len(self._builders))
        self._stage.witness.cut()
        ended = failed | step.terminated | step.truncated
        self._observation = self._stage.world.restart(ended)
        self._stage.witness.begun(ended)
        self._episode = self._episode + np.int32(1)

    def _finish(self, block: str, arrays: dict[str, NDArray[np.generic]]) -> Finished:
        held = self._way.held(block)
        return Finished(
            block=block,
            arrays=arrays,
            policy=self._way.policy,
            encoder_version=held.encoder_version,
            policy_version=held.policy_version,
            steps=self._segment_steps,
            columns=self._columns,
            first_step=self._first_step,
        )


class OpenLoopCollector(SegmentCollector):
    """BABBLE of a run in which nobody learns: no segments are built, only what is recorded counts.

    Its borders are those of the recording's chunks.
    """

    def __init__(
        self, stage: Stage, way: Way, recording: Recording, *, observation: Floats, breakdowns: Breakdowns
    ) -> None:
        super().__init__(stage, way, segment_steps=1, observation=observation, breakdowns=breakdowns)
        self._builders = {}
        self._recording = recording

    def at_border(self) -> bool:
        """True between two chunks of rows."""
        return self._recording.open_steps == 0

    def _keep(self, before: Floats, step: Step) -> list[Finished]:
        if self._recording.full:
            self._breakdowns.finish()
        return []


def collector_of(
    term: Term,
    body: Body,
    shelf: ModelShelf,
    rng: np.random.Generator,
    *,
    observation: Floats,
    breakdowns: Breakdowns,
    witness: Witness,
    open_loop: Recording | None = None,
) -> SegmentCollector:
    """The collector of a phase that trains or collects; `observation` (E, n) is the body's present one.

    `open_loop`: nobody learns, and this recording, which looks on as or behind `witness`, is all that counts.
    Raises RuntimeError if models of the blocks below are not held.
    """
    stage = staged(term, body, shelf, witness)
    world, way = stage.world, way_of(term, body, stage, shelf, rng)
    if open_loop is not None:
        return OpenLoopCollector(stage, way, open_loop, observation=observation, breakdowns=breakdowns)
    return SegmentCollector(
        stage,
        way,
        segment_steps=term.level_settings.actors.segment_steps,
        observation=world.resume(observation) if isinstance(world, LevelWorld) else observation,
        breakdowns=breakdowns,
    )
