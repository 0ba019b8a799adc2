"""What a trained block achieved: it is sent from vertex to vertex, and where it ends is compared.

Separation alone proves nothing (an untrained encoder reaches 0.94 in a box), so a score always
carries z_min too.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal, Protocol, TypedDict

import numpy as np
from numpy.typing import NDArray

from babble.policy.goals import WalkClock
from babble.worlds.batch import World

Floats = NDArray[np.float32]
REACHED = 0.9
"""A goal counts as reached when its component of the latent is at least this."""


class ScoreValues(TypedDict):
    """The measures of `score`."""

    separation: float
    separation_worst: float
    z_min: float
    z_goal: float
    switch_success: float
    crossing: float | None


class Encodes(Protocol):
    """The encoder as scores need it; babble.policy.act.EncoderModel."""

    @property
    def latent_dim(self) -> int:
        """d"""
        ...

    def latent(self, observation: Floats) -> Floats:
        """(E, n) -> (E, d)."""
        ...


class Acts(Protocol):
    """The policy as scores need it; babble.policy.act.PolicyModel."""

    def act(
        self, z: Floats, g: Floats, rng: np.random.Generator, mode: Literal["sampled", "mean"] = "sampled"
    ) -> tuple[Floats, Floats]:
        """Actions (E, a) and their log probabilities (E,)."""
        ...


@dataclass(frozen=True)
class Legs:
    """Where each leg ended: L legs of E columns."""

    posture: NDArray[Any]
    """(L, E, p)"""
    latent: NDArray[Any]
    """(L, E, d)"""
    goal: NDArray[Any]
    """(L, E) the vertex that was aimed at"""
    start_posture: NDArray[Any] | None = None
    """(E, p) where the columns began"""


def score(legs: Legs, diameter: float, crossing_axis: int | None = None) -> ScoreValues:
    """The measures of an evaluation. The first leg is not scored: it started somewhere, not at a vertex.

    - separation: how far apart the ends for different goals are, over the diameter. For two vertices
      the mean distance of consecutive legs' ends over columns and legs, and separation_worst the
      least. For more, distances between the vertices' mean ends: the mean over pairs, and the least.
    - z_min: the mean of z_j at the ends of legs to vertex j, for the worst j that was a goal; z_goal:
      the mean over all legs; switch_success: the share of legs with z_goal >= 0.9.
    - crossing: the share of consecutive legs that end on opposite sides of `crossing_axis`.

    Raises ValueError for fewer than three legs, or arrays that do not fit together.
    """
    shape = legs.goal.shape
    if len(legs.goal) < 3 or legs.posture.shape[:2] != shape or legs.latent.shape[:2] != shape:
        raise ValueError(
            "a score needs three or more legs with posture (L, E, p), latent (L, E, d) and goal (L, E), "
            f"got {legs.posture.shape}, {legs.latent.shape} and {legs.goal.shape}"
        )
    posture, goal = legs.posture[1:].astype(np.float64), legs.goal[1:].astype(np.int64)
    at_goal = np.take_along_axis(legs.latent[1:].astype(np.float64), goal[:, :, None], axis=2)[:, :, 0]
    visited = np.unique(goal)
    apart = _apart(posture, goal, visited, legs.latent.shape[2]) / diameter
    crossing = None
    if crossing_axis is not None:
        side = np.sign(posture[:, :, crossing_axis])
        crossing = float((side[1:] * side[:-1] < 0).mean())
    return ScoreValues(
        separation=float(apart.mean()),
        separation_worst=float(apart.min()),
        z_min=float(min(at_goal[goal == vertex].mean() for vertex in visited)),
        z_goal=float(at_goal.mean()),
        switch_success=float((at_goal >= REACHED).mean()),
        crossing=crossing,
    )


@dataclass(frozen=True)
class Walker:
    """One block's models, and which part of the body they see and move."""

    encoder: Encodes
    policy: Acts
    observed: NDArray[np.intp]
    """indices of the world's observation"""
    driven: NDArray[np.intp]
    """indices of the world's action"""


def walk_legs(
    world: World,
    encoder: Encodes,
    policy: Acts,
    rng: np.random.Generator,
    legs: int,
    leg_steps: int,
    mode: Literal["sampled", "mean"] = "mean",
) -> Legs:
    """The legs of one block that sees and moves the whole body; see `walk_blocks`."""
    walker = Walker(encoder, policy, np.arange(world.observation_size), np.arange(world.action_size))
    return walk_blocks(world, {"": walker}, rng, legs, leg_steps, mode)[""]


def walk_blocks(
    world: World,
    walkers: Mapping[str, Walker],
    rng: np.random.Generator,
    legs: int,
    leg_steps: int,
    mode: Literal["sampled", "mean"] = "mean",
) -> dict[str, Legs]:
    """Send all columns from random starts to `legs` vertices, `leg_steps` each, never one twice in a row.

    All blocks walk at once, each to vertices of its own; returns the legs by block.
    """
    clocks = {
        block: WalkClock(world.columns, walker.encoder.latent_dim, leg_steps, rng)
        for block, walker in walkers.items()
    }
    observation = world.reset("random")
    start = world.posture()
    postures: list[Floats] = []
    ends: dict[str, list[tuple[Floats, NDArray[np.int32]]]] = {block: [] for block in walkers}
    for _ in range(legs):
        goals = {block: (clock.index.astype(np.int32), clock.goal) for block, clock in clocks.items()}
        for _ in range(leg_steps):
            action = _acted(world, walkers, observation, {b: g for b, (_, g) in goals.items()}, rng, mode)
            observation = world.step(action).observation
            for clock in clocks.values():
                clock.tick()
        postures.append(world.posture())
        for block, walker in walkers.items():
            ends[block].append((walker.encoder.latent(observation[:, walker.observed]), goals[block][0]))
    return {
        block: Legs(
            posture=np.stack(postures),
            latent=np.stack([latent for latent, _ in reached]),
            goal=np.stack([goal for _, goal in reached]),
            start_posture=start,
        )
        for block, reached in ends.items()
    }


def _acted(
    world: World,
    walkers: Mapping[str, Walker],
    observation: Floats,
    goals: Mapping[str, Floats],
    rng: np.random.Generator,
    mode: Literal["sampled", "mean"],
) -> Floats:
    """The action (E, a) of all blocks together; what no block drives stays at 0."""
    action = np.zeros((world.columns, world.action_size), np.float32)
    for block, walker in walkers.items():
        latent = walker.encoder.latent(observation[:, walker.observed])
        action[:, walker.driven], _ = walker.policy.act(latent, goals[block], rng, mode)
    return action


def _apart(
    posture: NDArray[np.float64], goal: NDArray[np.int64], visited: NDArray[np.int64], latent_dim: int
) -> NDArray[np.float64]:
    if latent_dim == 2:
        return np.asarray(np.linalg.norm(posture[1:] - posture[:-1], axis=2))
    ends = [posture[goal == vertex].mean(axis=0) for vertex in visited]
    return np.array([np.linalg.norm(one - other) for one, other in combinations(ends, 2)])
