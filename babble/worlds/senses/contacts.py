"""The contacts of several copies of a body, with their forces, as arrays."""

import itertools
from collections.abc import Sequence
from typing import Any, NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.senses.sense import Copies

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
AXES = np.arange(3)
ELLIPTIC = int(mujoco.mjtCone.mjCONE_ELLIPTIC)


class Contacts(NamedTuple):
    """C contacts of all copies. Arrays may be MuJoCo's own memory: not to be written to, nor kept."""

    copy: Indices
    """(C,) which copy"""
    geoms: NDArray[np.int32]
    """(C, 2) geom1 and geom2; below 0 for a flex, which is no geom"""
    place: Array
    """(C, 3) midway between the two surfaces, in the world, in metres"""
    axes: Array
    """(C, 3, 3) rows are unit vectors in the world: the normal, from geom1 to geom2, and two tangents"""
    gap_m: Array
    """(C,) between the surfaces, below 0 where they overlap"""
    force: Array
    """(C, 3) on geom2 along these axes, in newton; geom1 feels the opposite; 0 where nothing presses"""


def contacts_of(model: mujoco.MjModel, copies: Copies) -> Contacts | None:
    """All contacts, or None where there are none. Nothing in the copies is changed.

    Forces are those of the constraint solver (`efc_force`), which for elliptic cones holds normal and
    friction as they are; pyramids are taken apart by `mj_contactForce`.
    """
    numbers = [data.ncon for data in copies]
    busy = [index for index, number in enumerate(numbers) if number]
    if not busy:
        return None
    touched = [copies[index] for index in busy]
    lists = [data.contact for data in touched]
    elliptic = model.opt.cone == ELLIPTIC
    return Contacts(
        np.arange(len(copies)).repeat(numbers),
        joined([each.geom for each in lists]),
        joined([each.pos for each in lists]),
        joined([each.frame for each in lists]).reshape(-1, 3, 3),
        joined([each.dist for each in lists]),
        _elliptic(touched, lists) if elliptic else _pyramidal(model, touched),
    )


def joined(parts: Sequence[NDArray[Any]]) -> NDArray[Any]:
    """One after the other; a single one as it is."""
    return parts[0] if len(parts) == 1 else np.concatenate(parts)


def _elliptic(copies: Copies, lists: Sequence[Any]) -> Array:
    forces = [data.efc_force for data in copies]
    every, first = joined(forces), joined([each.efc_address for each in lists])
    if not len(every):
        return np.zeros((len(first), 3))
    # A contact that MuJoCo left out of its constraints has no address and no force.
    dims = joined([each.dim for each in lists]) * (first >= 0)
    if len(copies) > 1:
        starts = [0, *itertools.accumulate(map(len, forces[:-1]))]
        first = first + np.repeat(starts, [data.ncon for data in copies])
    return every.take(first[:, None] + AXES, mode="clip") * (dims[:, None] > AXES)


def _pyramidal(model: mujoco.MjModel, copies: Copies) -> Array:
    every, found = [], np.zeros(6)
    for data in copies:
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, found)
            every.append(found[:3].copy())
    return np.array(every)
