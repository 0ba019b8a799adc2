"""Where a body feels: points spread over the surface of its parts, denser where an infant feels more.

Of a body that is made of several geoms, the points inside another of its geoms are left out, as in
MIMo. Everything comes from the model alone: no state, so nothing depends on when a skin is made.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from types import MappingProxyType

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.patterns import matching
from babble.worlds.physics.names import names_of
from babble.worlds.senses.surfaces import SKINNED, inside, surface

MIMO_DISTANCES_M: Mapping[str, float] = MappingProxyType(
    {
        "*_eye": 1.0,
        "head": 0.013,
        "upper_body": 0.030,
        "chest": 0.030,
        "lower_body": 0.025,
        "hip": 0.025,
        "*_upper_arm": 0.024,
        "*_lower_arm": 0.024,
        "*_hand": 0.007,
        "*_lfmetacarpal": 0.007,
        "*_fingers": 0.002,
        "*distal": 0.002,
        "*middle": 0.004,
        "*knuckle": 0.004,
        "*_thhub": 0.004,
        "*_thbase": 0.004,
        "*_upper_leg": 0.027,
        "*_lower_leg": 0.038,
        "*_foot": 0.015,
        "*_toes": 0.010,
        "*_big_toe": 0.010,
    }
)
"""How far apart points are on each part of MIMo, by patterns over the names of bodies; the first counts.

The published figures of mimoEnv, from adults' two-point discrimination. Later MIMo's chest, a part of
version 1's upper body, has the distance of the latter.
"""
OTHER_DISTANCE_M = 0.02
"""On bodies that no pattern matches."""
MAX_RESOLUTION = 4.0
MAX_POINTS = 100_000


class SkinError(ValueError):
    """A skin that cannot be made; the text is one sentence for a person."""


@dataclass(frozen=True)
class Patch:
    """The skin of one body of the model."""

    body: int
    name: str
    distance_m: float
    """how far apart neighbouring points are, about"""
    points: NDArray[np.float64]
    """(n, 3) in the body's frame, in metres"""


def skin(
    model: mujoco.MjModel,
    bodies: Sequence[str] = ("*",),
    resolution: float = 1.0,
    distances_m: Mapping[str, float] = MIMO_DISTANCES_M,
) -> tuple[Patch, ...]:
    """The patches of all bodies that match a pattern and can be touched, in the order of the bodies.

    `resolution` is the number of points per length relative to `distances_m`: 0.5 doubles the distances
    and leaves about a quarter of the points. Only geoms that can collide have points; the world's body
    has none. Raises `SkinError`, or the `PatternError` of a pattern that matches nothing.
    """
    if not isinstance(resolution, int | float) or not 0 < resolution <= MAX_RESOLUTION:
        raise SkinError(
            f"touch: resolution is a number above 0 and at most {MAX_RESOLUTION:g}, got {resolution!r}"
        )
    names = names_of(model, "body")
    patches = []
    for body in matching(names, bodies, "body"):
        geoms = _touchable(model, body)
        if body == 0 or not geoms:
            continue
        distance_m = _distance_m(names[body], distances_m) / resolution
        points = _points(model, geoms, distance_m)
        patches.append(Patch(int(body), names[body], distance_m, points))
    _check(patches, bodies)
    return tuple(patches)


def _check(patches: Sequence[Patch], bodies: Sequence[str]) -> None:
    number = sum(len(patch.points) for patch in patches)
    if not number:
        raise SkinError(
            f"touch: no body that matches {', '.join(bodies)} has a geom that can collide and has skin "
            "(sphere, ellipsoid, capsule, cylinder, box, mesh); choose other bodies or leave touch out"
        )
    if number > MAX_POINTS:
        raise SkinError(
            f"touch: the skin would have {number:,} points, more than {MAX_POINTS:,}; "
            "lower the resolution or choose fewer bodies"
        )


def _distance_m(name: str, distances_m: Mapping[str, float]) -> float:
    return next(
        (metres for pattern, metres in distances_m.items() if fnmatchcase(name, pattern)), OTHER_DISTANCE_M
    )


def _touchable(model: mujoco.MjModel, body: int) -> list[int]:
    """The body's geoms that can be in a contact."""
    start, number = model.body_geomadr[body], model.body_geomnum[body]
    paired = {*model.pair_geom1, *model.pair_geom2}
    return [
        geom
        for geom in range(start, start + number)
        if model.geom_type[geom] in SKINNED
        and (model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired)
    ]


def _points(model: mujoco.MjModel, geoms: Sequence[int], distance_m: float) -> NDArray[np.float64]:
    """(n, 3) in the body's frame. Should each geom's points lie in the others, all are kept."""
    poses = {geom: (_rotation(model, geom), model.geom_pos[geom]) for geom in geoms}
    every, outside = [], []
    for geom in geoms:
        rotation, origin = poses[geom]
        points = surface(model, geom, distance_m) @ rotation.T + origin
        hidden = np.zeros(len(points), np.bool_)
        for other in geoms:
            if other != geom:
                rotation, origin = poses[other]
                hidden |= inside(model, other, (points - origin) @ rotation)
        every.append(points)
        outside.append(points[~hidden])
    return np.concatenate(outside if any(map(len, outside)) else every)


def _rotation(model: mujoco.MjModel, geom: int) -> NDArray[np.float64]:
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, model.geom_quat[geom])
    return rotation.reshape(3, 3)
