"""Which posture each goal of a block with children is, in terms of its children: where each of them ended."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from babble.parts import Part
from babble.scores import REACHED
from services.launcher.evaluate import Rollout, Version

MOST_PAIRS = 6
"""Of more pairs of goals only the nearest are told."""


@dataclass(frozen=True, kw_only=True)
class ChildEnd:
    """Where a child was at the ends of the legs to one goal of its parent."""

    vertex: int
    """the child's vertex that was nearest most often"""
    share: float
    """of the legs it was"""
    z: float
    """the mean of that vertex's component of the child's latent"""
    reached: float
    """the share of legs in which the child was at a vertex, whichever: a component of 0.9 or more"""
    landmark: str | None
    """where the child ended most often of the named postures of what it moves; None where it has none"""
    landmark_share: float | None
    """of the legs at that one"""
    at_landmark: float | None
    """of the legs at any of them"""


@dataclass(frozen=True, kw_only=True)
class ChildEnds:
    """The postures that a block's goals are."""

    run: str
    version: Version
    policy: str
    goals: Mapping[int, Mapping[str, ChildEnd]]
    """by goal that a leg had, by child"""

    @property
    def children(self) -> list[str]:
        """The children, in the order in which the block observes them."""
        return list(next(iter(self.goals.values())))

    @property
    def differing(self) -> dict[tuple[int, int], list[str]]:
        """By pair of goals, the children that ended at different vertices."""
        return {
            (one, other): [
                child
                for child in self.children
                if self.goals[one][child].vertex != self.goals[other][child].vertex
            ]
            for one, other in itertools.combinations(self.goals, 2)
        }

    def words(self) -> list[str]:
        """In how many children goals differ, and how surely children are at a vertex; a line each."""
        count, differing = len(self.children), self.differing
        least = min((len(names) for names in differing.values()), default=0)
        pairs = [pair for pair in differing if len(differing) <= MOST_PAIRS or len(differing[pair]) == least]
        lines = [
            f"goals {one} and {other} differ in {len(differing[one, other])} of {count} children"
            for one, other in pairs[:MOST_PAIRS]
        ]
        ends = [end for row in self.goals.values() for end in row.values()]
        sure = f"at a vertex (z >= {REACHED}) in {min(end.reached for end in ends):.0%} of the legs or more"
        named = [end.at_landmark for end in ends if end.at_landmark is not None]
        posed = f", at a landmark in {min(named):.0%} or more" if named else ""
        return [*lines, f"each child ends {sure}{posed}"]

    def json(self) -> dict[str, Any]:
        """For programs: one object, told from the rows of scores by its key "goals"."""
        version = self.version
        return {
            "run": self.run,
            "block": version.block,
            "iteration": version.iteration,
            "phase": version.phase.value,
            "policy": self.policy,
            "goals": [
                {"goal": goal, "children": {child: vars(end) for child, end in row.items()}}
                for goal, row in self.goals.items()
            ],
            "differing": [{"goals": pair, "children": names} for pair, names in self.differing.items()],
        }


def child_ends(rollout: Rollout, version: Version) -> ChildEnds | None:
    """The postures of a block that was rolled out; None for a leaf. The first legs do not count."""
    block = version.block
    if block not in rollout.arrived:
        return None
    legs, places = rollout.legs[block], rollout.tree.child_slices(block)
    goal = legs.goal[1:]
    goals = {
        int(vertex): {
            child: _end(
                rollout.arrived[block][1:][goal == vertex][:, place],
                legs.posture[1:][goal == vertex],
                rollout.parts[child],
            )
            for child, place in places.items()
        }
        for vertex in np.unique(goal)
    }
    return ChildEnds(run=rollout.run.name, version=version, policy=rollout.mode, goals=goals)


def table_of(ends: ChildEnds) -> list[list[str]]:
    """For people, a head and a row per child: by goal its vertex, z there, its landmark."""
    head = ["child", *(f"goal {goal}" for goal in ends.goals)]
    return [head, *([child, *(_cell(row[child]) for row in ends.goals.values())] for child in ends.children)]


def _cell(end: ChildEnd) -> str:
    words = f"{end.vertex} ({end.z:.2f})"
    if end.landmark is None:
        return words
    return f"{words} {end.landmark} {end.landmark_share:.0%}" if end.landmark_share else f"{words} elsewhere"


def _end(latent: NDArray[Any], posture: NDArray[Any], part: Part) -> ChildEnd:
    """Of K legs: the child's latents (K, d), and the postures (K, p) of the whole body."""
    nearest = latent.argmax(axis=1)
    vertex = int(np.bincount(nearest).argmax())
    name, share, any_share = _landmark(part, posture[:, part.components])
    return ChildEnd(
        vertex=vertex,
        share=float((nearest == vertex).mean()),
        z=float(latent[:, vertex].mean()),
        reached=float((latent.max(axis=1) >= REACHED).mean()),
        landmark=name,
        landmark_share=share,
        at_landmark=any_share,
    )


def _landmark(part: Part, posture: NDArray[Any]) -> tuple[str | None, float | None, float | None]:
    """Where most of the postures (K, q) are, the share, and the share that is at any landmark."""
    if not part.landmarks:
        return None, None, None
    there: Sequence[NDArray[Any]] = [landmark.at(posture) for landmark in part.landmarks]
    shares = [float(each.mean()) for each in there]
    best = int(np.argmax(shares))
    return part.landmarks[best].name, shares[best], float(np.any(there, axis=0).mean())
