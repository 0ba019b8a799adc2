"""A coarse skin for pictures: a few hundred points, spread over any body so that all of it is seen.

A skin that is only made coarser would have most of its points on MIMo's finger tips, and none that show
on its legs: distances differ by a factor of twenty. Here they differ by about the root of that.
"""

import math
from collections import defaultdict
from collections.abc import Sequence
from glob import escape

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.drawing.poses import turned
from babble.worlds.physics.patterns import PatternError
from babble.worlds.senses.sense import Floats
from babble.worlds.senses.skin import MAX_RESOLUTION, Patch, SkinError, skin
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


class CoarseTouch:
    """The forces on the points of a coarse skin, by the rule of `babble.worlds.senses.touch`."""

    def __init__(self, touches: Sequence[Touch]) -> None:
        self._touches = tuple(touches)
        self.patches: tuple[Patch, ...] = tuple(patch for touch in touches for patch in touch.patches)
        """whose points are, one after the other, those of `read`"""
        self.size = sum(len(patch.points) for patch in self.patches)

    def read(self, data: mujoco.MjData) -> Floats:
        """(N,) the norm of the force on each point in newton, after a step or mj_forward."""
        return np.concatenate([touch.read([data])[0] for touch in self._touches])


def coarse_touch(model: mujoco.MjModel) -> CoarseTouch | None:
    """At most `MOST_POINTS` points on the model's bodies; None where they can have no skin."""
    if _faces(model) > MOST_FACES:
        return None
    try:
        own_m = {patch.name: _TINY * patch.distance_m for patch in skin(model, resolution=_TINY)}
        spacing_m = (FIRST_EXTENTS * model.stat.extent) ** 2 / LONGEST_M
        best: CoarseTouch | None = None
        for _ in range(TRIES):
            found = CoarseTouch(_touches(model, own_m, spacing_m))
            if found.size <= MOST_POINTS and (best is None or found.size > best.size):
                best = found
            if ENOUGH_POINTS <= found.size <= MOST_POINTS:
                break
            step = found.size / (0.9 * MOST_POINTS)
            spacing_m *= min(max(step, 1 / MOST_STEP), MOST_STEP)
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


def _touches(model: mujoco.MjModel, own_m: dict[str, float], spacing_m: float) -> list[Touch]:
    """One for all bodies whose distances in the skin's own table are within an octave of one another.

    Here a body's points are as far apart as the geometric mean of its own distance and `spacing_m`.
    """
    alike: dict[int, list[str]] = defaultdict(list)
    for name, metres in own_m.items():
        alike[round(math.log2(min(metres, LONGEST_M)))].append(escape(name))
    return [
        Touch(model, names, min(math.sqrt(2**octave / spacing_m), MAX_RESOLUTION), components="norm")
        for octave, names in alike.items()
    ]


def _faces(model: mujoco.MjModel) -> int:
    meets = (model.geom_contype | model.geom_conaffinity) != 0
    meshes = meets & (model.geom_type == mujoco.mjtGeom.mjGEOM_MESH) & (model.geom_bodyid > 0)
    return int(model.mesh_facenum[model.geom_dataid[meshes]].sum())
