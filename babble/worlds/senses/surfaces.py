"""Points spread over the surface of a geom, and which points lie inside one; all in the geom's frame.

How the rings and lattices are laid is MIMo's published arrangement (Mattern et al., "MIMo: A Multi-Modal
Infant Model", IEEE TCDS 2024; package mimoTouch), so that a body has as many points here as there.
"""

from collections.abc import Sequence
from math import ceil, pi, sin

import mujoco
import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Flags = NDArray[np.bool_]
_CENTRE: Points = np.zeros((1, 3))
_GEOM = mujoco.mjtGeom
SKINNED = {
    int(kind)
    for kind in (
        _GEOM.mjGEOM_SPHERE,
        _GEOM.mjGEOM_CAPSULE,
        _GEOM.mjGEOM_CYLINDER,
        _GEOM.mjGEOM_BOX,
        _GEOM.mjGEOM_ELLIPSOID,
        _GEOM.mjGEOM_MESH,
    )
}
"""The geom types that can have points; planes and height fields are ground, not skin."""


def surface(model: mujoco.MjModel, geom: int, distance_m: float) -> Points:
    """(n, 3) points about `distance_m` apart on the geom's surface; the centre alone if it is smaller.

    `geom` must be of a type in `SKINNED`.
    """
    kind, size = model.geom_type[geom], model.geom_size[geom]
    if kind == _GEOM.mjGEOM_SPHERE:
        return _sphere(size[0], distance_m)
    if kind == _GEOM.mjGEOM_ELLIPSOID:
        return _sphere(size.max(), distance_m) / size.max() * size
    if kind == _GEOM.mjGEOM_CAPSULE:
        return _capsule(size[0], size[1], distance_m)
    if kind == _GEOM.mjGEOM_CYLINDER:
        return _cylinder(size[0], size[1], distance_m)
    if kind == _GEOM.mjGEOM_BOX:
        return _box(size, distance_m)
    return _mesh(model, model.geom_dataid[geom], distance_m)


def inside(model: mujoco.MjModel, geom: int, points: Points) -> Flags:
    """(n,) which points lie inside the geom; a point on its surface is outside, and meshes hold nothing."""
    kind, size = model.geom_type[geom], model.geom_size[geom]
    beyond = np.abs(points)
    across = np.hypot(points[:, 0], points[:, 1])
    if kind == _GEOM.mjGEOM_SPHERE:
        depth = size[0] - np.linalg.norm(points, axis=1)
    elif kind == _GEOM.mjGEOM_ELLIPSOID:
        depth = (1 - np.linalg.norm(points / size, axis=1)) * size.min()
    elif kind == _GEOM.mjGEOM_CAPSULE:
        depth = size[0] - np.hypot(across, np.maximum(beyond[:, 2] - size[1], 0))
    elif kind == _GEOM.mjGEOM_CYLINDER:
        depth = np.minimum(size[0] - across, size[1] - beyond[:, 2])
    elif kind == _GEOM.mjGEOM_BOX:
        depth = (size - beyond).min(axis=1)
    else:
        depth = np.full(len(points), -1.0)
    return np.asarray(depth > 1e-9)


def _sphere(radius: float, distance: float) -> Points:
    if distance > radius:
        return _CENTRE
    rings = ceil(pi * radius / distance)
    tilts = [(i + 0.5) * pi / rings for i in range(rings)]
    return _rings(
        [(radius * sin(t), radius * np.cos(t), round(2 * pi * sin(t) * radius / distance)) for t in tilts]
    )


def _capsule(radius: float, half: float, distance: float) -> Points:
    around = ceil(2 * pi * radius / distance)
    if around < 3:
        return _axis(half + radius, distance)
    rings = [(radius, height, around) for height in _heights(half, distance)]
    steps = ceil(pi * radius / (2 * distance))
    for tilt in (i * pi / (2 * steps) for i in range(steps)):
        number = ceil(2 * pi * sin(tilt) * radius / distance)
        for side in (1, -1):
            rings.append((radius * sin(tilt), side * (half + radius * np.cos(tilt)), max(number, 1)))
    return _rings(rings)


def _cylinder(radius: float, half: float, distance: float) -> Points:
    around = ceil(2 * pi * radius / distance)
    if around < 3:
        return _axis(half, distance)
    rings = [(radius, height, around) for height in _heights(half, distance)]
    for inner in np.linspace(0, radius, round(radius / distance) + 1)[:-1]:
        number = max(ceil(2 * pi * inner / distance), 1)
        rings += [(inner, half, number), (inner, -half, number)]
    return _rings(rings)


def _box(size: Points, distance: float) -> Points:
    if 0.75 * distance > size.max():
        return _CENTRE
    counts = np.maximum(2, np.ceil(2 * size / distance).astype(int))
    lines = [np.linspace(-half, half, count) for half, count in zip(size, counts, strict=True)]
    faces = []
    for axis, line in enumerate(lines):
        # Edges and corners belong to the first face that has them.
        inner = [each[1:-1] for each in lines[:axis]]
        grid = np.meshgrid(*inner, line[[0, -1]], *lines[axis + 1 :], indexing="ij")
        faces.append(np.stack(grid, axis=-1).reshape(-1, 3))
    return np.concatenate(faces)


def _mesh(model: mujoco.MjModel, mesh: int, distance: float) -> Points:
    """A lattice over each triangle, of which one point in each cube of the distance is kept."""
    first, number = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    corners = model.mesh_vert[model.mesh_vertadr[mesh] + model.mesh_face[first : first + number]]
    points = []
    for a, b, c in corners.astype(np.float64):
        steps = max(1, ceil(max(np.linalg.norm(b - a), np.linalg.norm(c - a)) / distance))
        u, v = (grid.ravel() / steps for grid in np.mgrid[: steps + 1, : steps + 1])
        within = u + v <= 1 + 1e-9
        points.append(a + u[within, None] * (b - a) + v[within, None] * (c - a))
    every = np.concatenate(points)
    _, kept = np.unique(np.floor(every / distance).astype(np.int64), axis=0, return_index=True)
    return np.asarray(every[np.sort(kept)])


def _axis(half: float, distance: float) -> Points:
    """For what is thinner than the distance between points."""
    number = ceil(2 * half / distance)
    heights = np.linspace(-half, half, number) if number > 1 else np.zeros(1)
    return np.stack([0 * heights, 0 * heights, heights], axis=1)


def _heights(half: float, distance: float) -> Points:
    return np.linspace(-half, half, ceil(2 * half / distance) + 1)


def _rings(rings: Sequence[tuple[float, float, int]]) -> Points:
    """The points of rings about the z axis, each given by its radius, height and number of points."""
    points = []
    for radius, height, number in rings:
        angles = 2 * pi * np.arange(number) / number
        points.append(
            np.stack([radius * np.cos(angles), radius * np.sin(angles), np.full(number, height)], axis=1)
        )
    return np.concatenate(points)
