"""Sending a trained block from vertex to vertex, for its scores (thesis ch. 4)."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from babble.breakdowns import Breakdowns
from babble.policy.act import Floats, Mode
from babble.policy.goals import WalkClock
from babble.policy.together import Acts, Encoders, Encodes, Policies
from babble.worlds.batch import Flags, Step, World

Seen = tuple[Floats, Floats]
"""What a block acts on: its latent and its goal, each (E, d)."""


class Witness:
    """Looks on while worlds are stepped, for people or a recorder; this one never looks.

    It changes nothing it sees, and keeps none of the arrays it is shown: they may be written over.
    """

    looking = False
    """Whether the next step is to be seen."""

    def see(self, observation: Floats, seen: Mapping[str, Seen | None]) -> None:
        """Before each step that is looked at: the world's observation (E, n), and what each block acts on.

        None for a block that acts without a latent.
        """

    def stepped(self, step: Step) -> None:
        """After each environment step of the body: what it gave, before anything is begun anew."""

    def begun(self, columns: Flags) -> None:
        """A new episode has begun in the flagged columns (E,)."""

    def passed(self) -> None:
        """After each environment step of a world whose steps are several: the next one may be seen too."""

    def cut(self) -> None:
        """What comes next in the first column does not go on from what was seen of it."""


@dataclass(frozen=True)
class Walker:
    """One block's models, and which part of the body they see and move."""

    encoder: Encodes
    policy: Acts
    observed: NDArray[np.intp]
    """indices of the world's observation"""
    driven: NDArray[np.intp]
    """indices of the world's action"""


@dataclass(frozen=True)
class Legs:
    """Where each leg ended: L legs of E columns."""

    posture: NDArray[Any]
    """(L, E, p), of the whole body"""
    latent: NDArray[Any]
    """(L, E, d)"""
    goal: NDArray[Any]
    """(L, E) the vertex that was aimed at"""
    start_posture: NDArray[Any] | None = None
    """(E, p) where the columns began"""
    external_reward: NDArray[Any] | None = None
    """(L, E) the task's own reward, the mean over the second half of each leg's steps: in the first
    half the body is still on its way from the vertex before; None where there is no task"""
    side: NDArray[Any] | None = None
    """(L, E) the side the whole body lay on, see `World.side`; None where sides do not count"""


@dataclass
class Path:
    """What a walk went through, T steps in all."""

    posture: list[Floats] = field(default_factory=list)
    """1 + T arrays (E, p), the start first"""
    latent: dict[str, list[Floats]] = field(default_factory=dict)
    """by block, T arrays (E, d): what each step was taken at"""


class Walk:
    """All columns go from random starts to `legs` vertices, `leg_steps` each, never one twice in a row.

    All blocks walk at once, each to vertices of its own. An episode that ends on the way begins anew,
    towards the same vertex. When a column's simulation breaks down, the whole walk begins again.
    """

    def __init__(
        self,
        world: World,
        walkers: Mapping[str, Walker],
        rng: np.random.Generator,
        legs: int,
        leg_steps: int,
        mode: Mode = "mean",
        *,
        breakdowns: Breakdowns | None = None,
        traced: bool = False,
        witness: Witness | None = None,
    ) -> None:
        """`breakdowns` counts them (its own are counted if none is given); `traced` keeps the `path`."""
        self.steps = 0
        """steps of the world so far, also of attempts that broke down"""
        self.path = Path()
        """of the present attempt; empty unless traced"""
        self._world = world
        self._walkers = walkers
        self._encoders = Encoders({block: walker.encoder for block, walker in walkers.items()})
        self._policies = Policies({block: walker.policy for block, walker in walkers.items()})
        self._rng = rng
        self._legs, self._leg_steps = legs, leg_steps
        self._mode: Mode = mode
        self._breakdowns = breakdowns or Breakdowns(world.id)
        self._traced = traced
        self._witness = witness or Witness()
        self._begin()

    @property
    def done(self) -> bool:
        """True once all legs are walked."""
        return len(self._postures) == self._legs

    def advance(self, steps: int) -> bool:
        """Up to `steps` more steps of the world; true once the walk is done.

        Raises `UnstableError` if the simulation breaks down again and again.
        """
        for _ in range(steps):
            if self.done:
                break
            self._step()
        return self.done

    def legs(self) -> dict[str, Legs]:
        """The legs by block. Raises RuntimeError before the walk is done."""
        if not self.done:
            raise RuntimeError("the legs are known once the walk is done")
        rewards = np.stack(self._rewards) if self._world.rewarded else None
        sides = np.stack(self._sides) if self._sides else None
        return {
            block: Legs(
                posture=np.stack(self._postures),
                latent=np.stack([latent for latent, _ in ends]),
                goal=np.stack([goal for _, goal in ends]),
                start_posture=self._start,
                external_reward=rewards,
                side=sides,
            )
            for block, ends in self._ends.items()
        }

    def _begin(self) -> None:
        self._clocks = {
            block: WalkClock(self._world.columns, walker.encoder.latent_dim, self._leg_steps, self._rng)
            for block, walker in self._walkers.items()
        }
        self._observation = self._world.reset("random")
        self._start = self._world.posture()
        self._in_leg = 0
        self._reward = np.zeros(self._world.columns, np.float32)
        self._postures: list[Floats] = []
        self._rewards: list[Floats] = []
        self._sides: list[Floats] = []
        self._ends: dict[str, list[tuple[Floats, NDArray[np.int32]]]] = {b: [] for b in self._walkers}
        self._seen: dict[str, Seen | None] = {}
        self._witness.begun(np.ones(self._world.columns, np.bool_))
        self._witness.cut()
        if self._traced:
            self.path = Path([self._start], {block: [] for block in self._walkers})

    def _step(self) -> None:
        action = self._action()
        if self._witness.looking:
            self._witness.see(self._observation, self._seen)
        step = self._world.step(action)
        self._witness.stepped(step)
        self.steps += 1
        if step.failed is not None and step.failed.any():
            self._breakdowns.note(step.failed, len(self._walkers))
            self._begin()
            return
        if self._traced:
            self.path.posture.append(self._world.posture())
        if self._in_leg >= self._leg_steps // 2:
            self._reward = self._reward + step.external_reward
        self._in_leg += 1
        if self._in_leg == self._leg_steps:
            self._arrive(step)
        for clock in self._clocks.values():
            clock.tick()
        ended = step.terminated | step.truncated
        self._observation = step.observation
        if ended.any():
            self._observation = self._world.restart(ended)
            self._witness.begun(ended)
        if ended[0]:
            self._witness.cut()

    def _action(self) -> Floats:
        """The action (E, a) of all blocks together; what no block drives stays at 0."""
        action = np.zeros((self._world.columns, self._world.action_size), np.float32)
        latents = self._latents(self._observation)
        goals = {block: clock.goal for block, clock in self._clocks.items()}
        self._seen = {block: (latent, goals[block]) for block, latent in latents.items()}
        for block, (part, _) in self._policies.act(latents, goals, self._rng, self._mode).items():
            action[:, self._walkers[block].driven] = part
        if self._traced:
            for block, latent in latents.items():
                self.path.latent[block].append(latent)
        return action

    def _latents(self, observation: Floats) -> dict[str, Floats]:
        return self._encoders.latents(
            {block: observation[:, walker.observed] for block, walker in self._walkers.items()}
        )

    def _arrive(self, step: Step) -> None:
        self._postures.append(self._world.posture())
        if (side := self._world.side()) is not None:
            self._sides.append(side)
        self._rewards.append(self._reward / np.float32(self._leg_steps - self._leg_steps // 2))
        self._reward, self._in_leg = np.zeros_like(self._reward), 0
        for block, latent in self._latents(step.observation).items():
            self._ends[block].append((latent, self._clocks[block].index.astype(np.int32)))
        if self.done:
            self._breakdowns.finish()


def walk_blocks(
    world: World,
    walkers: Mapping[str, Walker],
    rng: np.random.Generator,
    legs: int,
    leg_steps: int,
    mode: Mode = "mean",
) -> dict[str, Legs]:
    """A whole `Walk` in one go; the legs by block. Raises `UnstableError`."""
    walk = Walk(world, walkers, rng, legs, leg_steps, mode)
    while not walk.advance(leg_steps):
        pass
    return walk.legs()


def walk_legs(
    world: World,
    encoder: Encodes,
    policy: Acts,
    rng: np.random.Generator,
    legs: int,
    leg_steps: int,
    mode: Mode = "mean",
) -> Legs:
    """The legs of one block that sees and moves the whole body; see `Walk`."""
    walker = Walker(encoder, policy, np.arange(world.observation_size), np.arange(world.action_size))
    return walk_blocks(world, {"": walker}, rng, legs, leg_steps, mode)[""]
