"""Acting in one phase: steps of the worlds in, finished segments out; no wire, no clock.

All blocks of a level act in the same worlds at the same time. Models are swapped only at the
border of a segment, so a segment has one encoder and one policy version.

When a simulation breaks down, the unfinished segments of all blocks are dropped: no number of it
is ever published. What follows is a new episode in every column, for there are steps missing.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from babble.breakdowns import Breakdowns
from babble.legs import Witness
from babble.noise import make_noise
from babble.policy.goals import GoalClock, WalkClock
from babble.segments import SegmentBuilder
from babble.worlds.batch import Flags, Step
from protocol.messages import Phase
from services.actor.config import Body
from services.actor.models import ModelShelf
from services.actor.ways import Floats, PolicyMode, PractiseWay, RandomWay, Record, WalkWay, Way
from services.runtime.settings import RunSettings


@dataclass(frozen=True)
class Finished:
    """A finished segment of one block."""

    block: str
    arrays: Record
    policy: PolicyMode
    encoder_version: int
    policy_version: int
    steps: int
    columns: int
    first_step: int


class Collector(Protocol):
    """One phase's way of acting."""

    env_steps: int
    """Environment steps done so far, summed over the columns."""

    def at_border(self) -> bool:
        """True between two segments."""

    def advance(self, steps: int) -> list[Finished]:
        """Step the worlds up to `steps` times, at most to the end of the segment.

        Raises `babble.breakdowns.UnstableError` if their simulation breaks down again and again.
        """


class SegmentCollector:
    """BABBLE, WALK, GROUND and PRACTISE: step, record, build segments."""

    def __init__(
        self,
        body: Body,
        ways: dict[str, Way],
        *,
        segment_steps: int,
        observation: Floats,
        breakdowns: Breakdowns,
        witness: Witness,
    ) -> None:
        self.env_steps = 0
        self.observation = observation
        self._breakdowns = breakdowns
        self._witness = witness
        self._body = body
        self._ways = ways
        self._columns = body.world.columns
        self._episode = np.zeros(self._columns, np.int32)
        self._segment_steps = segment_steps
        self._builders = {block: SegmentBuilder(segment_steps, self._columns) for block in ways}
        self._steps = self._first_step = 0

    def at_border(self) -> bool:
        """True between two segments."""
        return all(len(builder) == 0 for builder in self._builders.values())

    def advance(self, steps: int) -> list[Finished]:
        """Step up to `steps` times; the blocks' segments end together, or are dropped together."""
        if self.at_border():
            self._first_step = self._steps
            for way in self._ways.values():
                way.begin_segment()
        for _ in range(steps):
            finished = self._step_once()
            if self.at_border():
                return finished
        return []

    def _step_once(self) -> list[Finished]:
        tree, world = self._body.tree, self._body.world
        before = self.observation
        action = np.zeros((self._columns, world.action_size), np.float32)
        for block, way in self._ways.items():
            action[:, tree.driven(block)] = way.act(before[:, tree.observed(block)])
        if self._witness.looking:
            self._witness.see(before, {block: way.seen for block, way in self._ways.items()})
        step = world.step(action)
        self._steps += 1
        self.env_steps += self._columns
        if step.failed is not None and step.failed.any():
            self._drop(step, step.failed)
            return []
        finished = []
        for block, way in self._ways.items():
            seen = tree.observed(block)
            record = way.record(before[:, seen], step.observation[:, seen], step, self._episode)
            arrays = self._builders[block].add(**record)
            if arrays is not None:
                finished.append(self._finish(block, way, arrays))
        ended = step.terminated | step.truncated
        self.observation = world.restart(ended) if ended.any() else step.observation
        self._episode = self._episode + ended.astype(np.int32)
        if ended[0]:
            self._witness.cut()
        if finished:
            self._breakdowns.finish()
        return finished

    def _drop(self, step: Step, failed: Flags) -> None:
        for builder in self._builders.values():
            builder.discard()
        self._breakdowns.note(failed, segments=len(self._builders))
        self._witness.cut()
        self.observation = self._body.world.restart(failed | step.terminated | step.truncated)
        self._episode = self._episode + np.int32(1)

    def _finish(self, block: str, way: Way, arrays: dict[str, NDArray[np.generic]]) -> Finished:
        return Finished(
            block=block,
            arrays=arrays,
            policy=way.policy,
            encoder_version=way.held.encoder_version,
            policy_version=way.held.policy_version,
            steps=self._segment_steps,
            columns=self._columns,
            first_step=self._first_step,
        )


def ways_of(
    phase: Phase,
    body: Body,
    blocks: list[str],
    shelf: ModelShelf,
    settings: RunSettings,
    rng: np.random.Generator,
) -> dict[str, Way]:
    """Each block's way of acting in a phase that trains or collects."""
    columns = body.world.columns
    ways: dict[str, Way] = {}
    for block in blocks:
        latent_dim = body.tree.specs[block].latent_dim
        if phase is Phase.BABBLE:
            noise = make_noise(
                settings.babbling.kind,
                scale=settings.babbling.scale,
                columns=columns,
                size=body.tree.action_size_of(block),
                rng=rng,
                correlation=settings.babbling.correlation,
                hold_steps=settings.babbling.hold_steps,
            )
            ways[block] = RandomWay(noise, body.layouts[block].pack)
        elif phase is Phase.WALK:
            walk = WalkClock(columns, latent_dim, settings.goals.walk_steps_per_goal, rng)
            ways[block] = WalkWay(block, shelf, walk, rng, body.layouts[block].pack)
        else:
            clock = GoalClock(columns, latent_dim, settings.goals.period_steps, rng)
            external = settings.goals.external_weight != 0
            ways[block] = PractiseWay(block, shelf, clock, rng, external=external)
    return ways
