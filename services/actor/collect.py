"""Acting in one phase: steps of the worlds in, finished segments out; no wire, no clock.

All blocks of a level act in the same worlds at the same time. Models are swapped only at the
border of a segment, so a segment has one encoder and one policy version.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from babble.noise import make_noise
from babble.policy.goals import GoalClock, WalkClock
from babble.scores import Walker, walk_blocks
from babble.segments import SegmentBuilder
from protocol.messages import Phase
from services.actor.config import Body
from services.actor.models import Held, ModelShelf
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
        """Step the worlds up to `steps` times, at most to the end of the segment."""


class SegmentCollector:
    """BABBLE, WALK, GROUND and PRACTISE: step, record, build segments."""

    def __init__(self, body: Body, ways: dict[str, Way], *, segment_steps: int, observation: Floats) -> None:
        self.env_steps = 0
        self.observation = observation
        self._body = body
        self._ways = ways
        self._columns = body.world.columns
        self._episode = np.zeros(self._columns, np.int32)
        self._segment_steps = segment_steps
        self._builders = {block: SegmentBuilder(segment_steps, self._columns) for block in ways}
        self._segments_done = 0

    def at_border(self) -> bool:
        """True between two segments."""
        return all(len(builder) == 0 for builder in self._builders.values())

    def advance(self, steps: int) -> list[Finished]:
        """Step up to `steps` times; the blocks' segments end together."""
        if self.at_border():
            for way in self._ways.values():
                way.begin_segment()
        for _ in range(steps):
            finished = self._step_once()
            if finished:
                self._segments_done += 1
                return finished
        return []

    def _step_once(self) -> list[Finished]:
        tree, world = self._body.tree, self._body.world
        before = self.observation
        action = np.zeros((self._columns, world.action_size), np.float32)
        for block, way in self._ways.items():
            action[:, tree.driven(block)] = way.act(before[:, tree.observed(block)])
        step = world.step(action)
        self.env_steps += self._columns
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
        return finished

    def _finish(self, block: str, way: Way, arrays: dict[str, NDArray[np.generic]]) -> Finished:
        return Finished(
            block=block,
            arrays=arrays,
            policy=way.policy,
            encoder_version=way.held.encoder_version,
            policy_version=way.held.policy_version,
            steps=self._segment_steps,
            columns=self._columns,
            first_step=self._segments_done * self._segment_steps,
        )


class EvaluationCollector:
    """EVALUATE: legs from random starts in fresh worlds; what is trained on is left where it is."""

    def __init__(
        self,
        body: Body,
        blocks: list[str],
        shelf: ModelShelf,
        settings: RunSettings,
        rng: np.random.Generator,
    ) -> None:
        self.env_steps = 0
        self.mode: PolicyMode = "mean"
        self._body = body
        self._blocks = blocks
        self._shelf = shelf
        self._settings = settings.evaluation
        self._rng = rng
        self._done = 0

    def at_border(self) -> bool:
        """Always: an evaluation is done in one go."""
        return True

    def advance(self, steps: int) -> list[Finished]:
        """All legs of one set of fresh columns, all blocks at once."""
        if self.mode == "random":
            raise RuntimeError("an evaluation acts by the policy, never at random")
        world, settings = self._body.world, self._settings
        held = {block: self._shelf.of(block) for block in self._blocks}
        walkers = {block: self._walker(block, models) for block, models in held.items()}
        walked = walk_blocks(world, walkers, self._rng, settings.legs, settings.leg_steps, self.mode)
        steps_done = settings.legs * settings.leg_steps
        self.env_steps += steps_done * world.columns
        self._done += 1
        return [
            Finished(
                block=block,
                arrays={
                    "start_posture": np.asarray(legs.start_posture),
                    "posture": legs.posture,
                    "latent": legs.latent,
                    "goal": legs.goal,
                },
                policy=self.mode,
                encoder_version=held[block].encoder_version,
                policy_version=held[block].policy_version,
                steps=steps_done,
                columns=world.columns,
                first_step=(self._done - 1) * steps_done,
            )
            for block, legs in walked.items()
        ]

    def _walker(self, block: str, held: Held) -> Walker:
        if held.encoder is None or held.policy is None:
            raise RuntimeError(f"block {block} was evaluated before it held an encoder and a policy")
        tree = self._body.tree
        return Walker(held.encoder, held.policy, tree.observed(block), tree.driven(block))


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
            ways[block] = RandomWay(noise)
        elif phase is Phase.WALK:
            walk = WalkClock(columns, latent_dim, settings.goals.walk_steps_per_goal, rng)
            ways[block] = WalkWay(block, shelf, walk, rng)
        else:
            clock = GoalClock(columns, latent_dim, settings.goals.period_steps, rng)
            ways[block] = PractiseWay(block, shelf, clock, rng)
    return ways
