"""What a trained block achieved: it is sent from vertex to vertex, and where it ends is compared.

Separation alone proves nothing (an untrained encoder reaches 0.94 in a box), so a score always
carries z_min too.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import TypedDict

import numpy as np
from numpy.typing import NDArray

from babble.landmarks import Landmark
from babble.legs import Legs, Path, Walk, Walker, walk_blocks, walk_legs

__all__ = [
    "REACHED",
    "Legs",
    "Path",
    "ScoreValues",
    "Walk",
    "Walker",
    "score",
    "walk_blocks",
    "walk_legs",
]

REACHED = 0.9
"""A goal counts as reached when the latent is at least so near to it; see `nearness`."""
LIES = 0.5
"""A body lies on its back or belly when its front is within 60 degrees of the vertical; else on a flank."""
ROUNDING = 1e-6
"""Components of a latent on the simplex sum to 1 up to this."""

Doubles = NDArray[np.float64]


class ScoreValues(TypedDict):
    """The measures of `score`."""

    separation: float
    separation_worst: float
    z_min: float
    z_goal: float
    switch_success: float
    crossing: float | None
    landmarks: dict[str, float]
    landmark_vertices: dict[str, int]
    external_reward: float | None
    external_reward_by_vertex: list[float | None] | None


def score(
    legs: Legs, diameter: float, crossing_axis: int | None = None, landmarks: Sequence[Landmark] = ()
) -> ScoreValues:
    """The measures of an evaluation. The first leg is not scored: it started somewhere, not at a vertex.

    - separation: how far apart the ends for different goals are, over the diameter. For two vertices
      the mean distance of consecutive legs' ends over columns and legs, and separation_worst the
      least. For more, distances between the vertices' mean ends: the mean over pairs, and the least.
    - z_min: the mean of z_j at the ends of legs to vertex j, for the worst j that was a goal; z_goal:
      the mean over all legs; switch_success: the share of legs with z_goal >= 0.9. Without the simplex z_j
      may be any number, and the `nearness` to the vertex is taken for it.
    - crossing: the share of consecutive legs that end on opposite sides of `crossing_axis`; where legs say
      which side the body lies on, that end on its back and on its belly; see `_crossing`.
    - landmarks: of the legs to the vertex that stands for a landmark, the share that ended at it. At
      most one vertex stands for a landmark and one landmark for a vertex, so that the sum of the shares
      is greatest; landmark_vertices says which. One that no leg reached has share 0 and no vertex.
    - external_reward: the mean over legs of the task's own reward per step in a leg's second half, and
      the same by vertex (None for one that was no goal). None where there is no task.

    Raises ValueError for fewer than three legs, or arrays that do not fit.
    """
    _check(legs)
    posture, goal = legs.posture[1:].astype(np.float64), legs.goal[1:].astype(np.int64)
    visited, latent_dim = np.unique(goal), legs.latent.shape[2]
    at_goal = nearness(legs.latent[1:].astype(np.float64), goal)
    apart = _apart(posture, goal, visited, latent_dim) / diameter
    shares, vertices = _reached(landmarks, posture, goal, visited)
    external, by_vertex = _external(legs, goal, latent_dim)
    return ScoreValues(
        separation=float(apart.mean()),
        separation_worst=float(apart.min()),
        z_min=float(min(at_goal[goal == vertex].mean() for vertex in visited)),
        z_goal=float(at_goal.mean()),
        switch_success=float((at_goal >= REACHED).mean()),
        crossing=_crossing(legs, crossing_axis),
        landmarks=shares,
        landmark_vertices=vertices,
        external_reward=external,
        external_reward_by_vertex=by_vertex,
    )


def nearness(latent: Doubles, goal: NDArray[np.int64]) -> Doubles:
    """(..., d) and the vertices aimed at (...) -> (...): z_j, but at most 1 - ||e_j - z|| / sqrt(2).

    On the simplex ||e_j - z|| <= sqrt(2) (1 - z_j), so it is z_j there. Off the simplex, where a latent far
    beyond the vertex would have a z_j of 5, it is 1 at the vertex only and falls with the distance from it.
    """
    at_goal = np.take_along_axis(latent, goal[..., None], axis=-1)[..., 0]
    apart = np.linalg.norm(latent - np.eye(latent.shape[-1])[goal], axis=-1)
    return np.asarray(np.minimum(at_goal, 1 - apart / np.sqrt(2) + ROUNDING))


def _check(legs: Legs) -> None:
    shape = legs.goal.shape
    told = {"external_reward": legs.external_reward, "side": legs.side}
    shapes = {name: array.shape for name, array in told.items() if array is not None}
    fits = legs.posture.shape[:2] == shape and legs.latent.shape[:2] == shape
    if len(legs.goal) < 3 or not fits or any(other != shape for other in shapes.values()):
        also = "".join(f", and {name} {other}" for name, other in shapes.items())
        raise ValueError(
            "a score needs three or more legs with posture (L, E, p), latent (L, E, d), goal (L, E) and "
            f"perhaps external_reward and side (L, E), got {legs.posture.shape}, {legs.latent.shape} and "
            f"{legs.goal.shape}{also}"
        )


def _apart(posture: Doubles, goal: NDArray[np.int64], visited: NDArray[np.int64], latent_dim: int) -> Doubles:
    if latent_dim == 2:
        return np.asarray(np.linalg.norm(posture[1:] - posture[:-1], axis=2))
    ends = [posture[goal == vertex].mean(axis=0) for vertex in visited]
    return np.array([np.linalg.norm(one - other) for one, other in combinations(ends, 2)])


def _crossing(legs: Legs, axis: int | None) -> float | None:
    """By side each end needs |side| > 0.5: a body that stops on a flank has not rolled over.

    A body that rolls without regard to its goals may reach 2 p (1 - p) <= 0.5, for a share p of ends on
    the back.
    """
    if axis is not None:
        side = np.sign(legs.posture[1:, :, axis])
    elif legs.side is not None:
        side = np.sign(legs.side[1:]) * (np.abs(legs.side[1:]) > LIES)
    else:
        return None
    return float((side[1:] * side[:-1] < 0).mean())


def _reached(
    landmarks: Sequence[Landmark], posture: Doubles, goal: NDArray[np.int64], visited: NDArray[np.int64]
) -> tuple[dict[str, float], dict[str, int]]:
    """The share of each landmark, and the vertex that stands for it."""
    at = {landmark.name: landmark.at(posture) for landmark in landmarks}
    shares = {name: {int(v): float(there[goal == v].mean()) for v in visited} for name, there in at.items()}
    vertices = _assigned(shares)
    found = {name: shares[name][vertices[name]] if name in vertices else 0.0 for name in shares}
    return found, vertices


def _assigned(shares: dict[str, dict[int, float]]) -> dict[str, int]:
    """Landmark -> vertex, each at most once, with the greatest sum of shares; none where the share is 0.

    Goes through the vertices and keeps, for each set of landmarks, the best way to have placed it so far.
    """
    best: dict[frozenset[str], tuple[float, dict[str, int]]] = {frozenset(): (0.0, {})}
    for vertex in sorted({vertex for by_vertex in shares.values() for vertex in by_vertex}):
        for placed, (total, chosen) in list(best.items()):
            for name in (name for name in shares if name not in placed):
                share, more = shares[name][vertex], placed | {name}
                if share > 0 and (more not in best or total + share > best[more][0]):
                    best[more] = (total + share, {**chosen, name: vertex})
    _, found = max(best.values(), key=lambda way: way[0])
    return {name: found[name] for name in shares if name in found}


def _external(
    legs: Legs, goal: NDArray[np.int64], latent_dim: int
) -> tuple[float | None, list[float | None] | None]:
    if legs.external_reward is None:
        return None, None
    rewards = legs.external_reward[1:].astype(np.float64)
    by_vertex = [
        float(rewards[goal == vertex].mean()) if (goal == vertex).any() else None
        for vertex in range(latent_dim)
    ]
    return float(rewards.mean()), by_vertex
