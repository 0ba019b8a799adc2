"""A coarse skin for pictures: a few hundred points, spread over any body so that all of it is seen.

A skin that is only made coarser would have most of its points on MIMo's finger tips, and none that show
on its legs: distances differ by a factor of twenty. Here they differ by about the root of that.
"""

import math
from collections.abc import Mapping
from glob import escape

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.patterns import PatternError
from babble.worlds.drawing.poses import turned
from babble.worlds.senses.skin import MAX_RESOLUTION, SkinError, skin
from babble.worlds.senses.surfaces import SKINNED
from babble.worlds.senses.touch import Touch

Points = NDArray[np.float64]
Indices = NDArray[np.int64]
MOST_POINTS = 600
ENOUGH_POINTS = 400
FIRST_EXTENTS = 0.12
"""The first guess of the distance between points, as a share of the model's size; rather too long."""
MOST_STEP = 10.0
LONGEST_M = 0.04
"""Longer distances of the skin's table stand for one point on the body, which is found at this one too."""
TRIES = 8
MOST_FACES = 10_000
"""Of meshes that can be touched; laying points over more takes seconds."""
_TINY = 1e-3
"""A resolution at which a skin tells its distances at almost no cost."""


def coarse_touch(model: mujoco.MjModel) -> Touch | None:
    """Of at most `MOST_POINTS` points on the model's bodies; None where they can have no skin."""
    if _faces(model) > MOST_FACES:
        return None
    try:
        own_m = {patch.name: _TINY * patch.distance_m for patch in skin(model, resolution=_TINY)}
        spacing_m = (FIRST_EXTENTS * model.stat.extent) ** 2 / LONGEST_M
        best, most = None, 0
        for _ in range(TRIES):
            touch = Touch(model, components="norm", distances_m=_distances_m(own_m, spacing_m))
            (size,) = touch.shape
            if most < size <= MOST_POINTS:
                best, most = touch, size
            if most >= ENOUGH_POINTS:
                break
            spacing_m *= min(max(size / (0.9 * MOST_POINTS), 1 / MOST_STEP), MOST_STEP)
    except (SkinError, PatternError):
        return None
    return best


def outwards(model: mujoco.MjModel, body: Indices, points: Points) -> Points:
    """(n, 3) unit vectors out of the body (n,) at points (n, 3) of its skin, about; in the body's frame.

    Away from the core of the geom's box: what is left of it if all sides give way by the least of its half
    sizes. Exact for spheres and capsules, and away from the edges for boxes and cylinders.
    """
    away = np.zeros_like(points)
    for each in np.unique(body):
        mine = body == each
        first, number = model.body_geomadr[each], model.body_geomnum[each]
        nearest = np.full(mine.sum(), np.inf)
        for geom in range(first, first + number):
            if model.geom_type[geom] not in SKINNED:
                continue
            turn = np.repeat(model.geom_quat[geom][None], len(nearest), axis=0)
            middle, half = np.split(model.geom_aabb[geom], 2)
            local = turned(turn * (1, -1, -1, -1), points[mine] - model.geom_pos[geom]) - middle
            core = half - half.min()
            beyond = (np.abs(local) / half).max(axis=1)
            closer = beyond < nearest
            nearest[closer] = beyond[closer]
            out = turned(turn, local - np.clip(local, -core, core))
            away[np.flatnonzero(mine)[closer]] = out[closer]
    return np.asarray(away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-12))


def _distances_m(own_m: Mapping[str, float], spacing_m: float) -> dict[str, float]:
    """By body: the geometric mean of its own distance in the skin's table and `spacing_m`, about."""
    return {
        escape(name): metres * max(math.sqrt(spacing_m / min(metres, LONGEST_M)), 1 / MAX_RESOLUTION)
        for name, metres in own_m.items()
    }


def _faces(model: mujoco.MjModel) -> int:
    meets = (model.geom_contype | model.geom_conaffinity) != 0
    meshes = meets & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_bodyid > 0)
    return int(model.mesh_facenum[model.geom_dataid[meshes]].sum())
