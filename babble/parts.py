"""The part of a body that a block moves, by which it is scored: its components, their span, its landmarks."""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from babble.blocks import BlockTree
from babble.landmarks import Landmark
from babble.legs import Legs
from babble.worlds.batch import World


@dataclass(frozen=True)
class Part:
    """Some components of a world's posture, numbered anew from 0."""

    components: NDArray[np.intp]
    """(q,) which they are of the whole posture"""
    diameter: float
    """the greatest distance between two postures of the part"""
    crossing_axis: int | None
    """the world's, where the part has it"""
    landmarks: tuple[Landmark, ...]
    turns: bool = False
    """whether it is the block's affair which side the whole body lies on"""

    def cut(self, legs: Legs) -> Legs:
        """The legs with postures (L, E, q) of the part alone, and with sides where they are its affair."""
        start = None if legs.start_posture is None else legs.start_posture[..., self.components]
        side = legs.side if self.turns else None
        return replace(legs, posture=legs.posture[..., self.components], start_posture=start, side=side)


def part_of_block(world: World, tree: BlockTree, block: str) -> Part:
    """What a block moves, itself or through its descendants.

    The whole posture belongs to a block that drives all actuators, as do sides, and to one whose actuators
    move nothing that the posture tells. Landmarks are restricted to a part. A leaf that moves a part, such as
    a finger, is at one when each of its joints is; any other block when each group's mean is.
    """
    components = moved_by(world, tree, block)
    drives_all = len(tree.driven_through(block)) == world.action_size
    if drives_all or not components:
        whole = np.arange(world.posture_size)
        return Part(whole, world.diameter, world.crossing_axis, tuple(world.landmarks), turns=drives_all)
    place = {component: index for index, component in enumerate(components)}
    single = not tree.specs[block].children
    restricted = [_restricted(landmark, place, single) for landmark in world.landmarks]
    return Part(
        components=np.array(components, dtype=np.intp),
        diameter=world.span(components),
        crossing_axis=None if world.crossing_axis is None else place.get(world.crossing_axis),
        landmarks=tuple(landmark for landmark in restricted if landmark.groups),
    )


def moved_by(world: World, tree: BlockTree, block: str) -> tuple[int, ...]:
    """The components of the posture that a block moves, itself or through its descendants, in their order."""
    actuators = tree.driven_through(block).tolist()
    return tuple(sorted({each for actuator in actuators for each in world.moves[actuator]}))


def _restricted(landmark: Landmark, place: Mapping[int, int], single: bool) -> Landmark:
    """What a landmark asks of a part; each component for itself where `single`, else by its groups."""
    kept = [tuple(place[each] for each in group if each in place) for group in landmark.groups]
    if single:
        kept = [(each,) for group in kept for each in group]
    return replace(landmark, groups=tuple(group for group in kept if group))
