"""What is seen of a MuJoCo model: solids of a few kinds, meshes, strings, a floor, each fixed to its body.

What MuJoCo's own viewer shows at its start is drawn: the groups 0 to 2, in the colours of materials. Of
sites only those that pictures show (MIMo's face) are; the others are marks. Left out is what is mostly
transparent, height fields, and strings that are wound around something.
"""

from dataclasses import dataclass
from typing import Any, Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.drawing.poses import combined, turned
from babble.worlds.senses.rendering import STUDIO

Array = NDArray[np.float64]
Numbers = NDArray[Any]
Indices = NDArray[np.int64]
Colours = NDArray[np.uint8]
Kind = Literal["capsules", "cylinders", "boxes", "ellipsoids"]
_GEOM = mujoco.mjtGeom
KINDS: dict[Kind, tuple[int, ...]] = {
    "capsules": (int(_GEOM.mjGEOM_CAPSULE),),
    "cylinders": (int(_GEOM.mjGEOM_CYLINDER),),
    "boxes": (int(_GEOM.mjGEOM_BOX),),
    "ellipsoids": (int(_GEOM.mjGEOM_SPHERE), int(_GEOM.mjGEOM_ELLIPSOID)),
}
SHOWN_GROUPS = 3
LEAST_ALPHA = 0.3
DEFAULT_RGBA = np.array([0.5, 0.5, 0.5, 1.0], np.float32)
"""MuJoCo's; a thing of this colour takes that of its material."""
MOST_FACES = 100_000
"""Of all meshes together; those that are too many are drawn as the boxes around them."""


@dataclass(frozen=True)
class Solids:
    """G things of one kind, each fixed to a body."""

    body: Indices
    """(G,)"""
    position: Array
    """(G, 3) of the middle, in the frame of the body, in metres"""
    quaternion: Array
    """(G, 4)"""
    size: Array
    """(G, 3) in metres: half sizes of a box; semi-axes of an ellipsoid; of capsule and cylinder, which lie
    along z, the radius and half the length (without the caps)"""
    colour: Colours
    """(G, 4)"""

    def __len__(self) -> int:
        return len(self.body)

    def at(self, position: Numbers, quaternion: Numbers) -> tuple[Array, Array]:
        """Where they are, (G, 3) and (G, 4), with the bodies at `position` (B, 3), `quaternion` (B, 4)."""
        turn = quaternion[self.body]
        return position[self.body] + turned(turn, self.position), combined(turn, self.quaternion)

    def chosen(self, which: NDArray[np.bool_]) -> "Solids":
        """Those that are flagged (G,)."""
        return Solids(
            self.body[which],
            self.position[which],
            self.quaternion[which],
            self.size[which],
            self.colour[which],
        )

    def __add__(self, others: "Solids") -> "Solids":
        return Solids(
            np.concatenate([self.body, others.body]),
            np.concatenate([self.position, others.position]),
            np.concatenate([self.quaternion, others.quaternion]),
            np.concatenate([self.size, others.size]),
            np.concatenate([self.colour, others.colour]),
        )


@dataclass(frozen=True)
class Mesh:
    """A surface of triangles, and where it is found."""

    vertices: NDArray[np.float32]
    """(3 T, 3) the corners of one triangle after the other, in metres"""
    normals: NDArray[np.float32]
    """(3 T, 3)"""
    solids: Solids
    """the things of this surface, all of one colour; their sizes mean nothing"""


@dataclass(frozen=True)
class String:
    """A string that is straight between the points it passes."""

    body: Indices
    """(n,) of each point"""
    position: Array
    """(n, 3) of the points, in the frames of their bodies"""
    radius_m: float
    colour: Colours
    """(4,)"""

    def at(self, position: Numbers, quaternion: Numbers) -> Array:
        """(n, 3) where it passes, with the bodies at `position` (B, 3), `quaternion` (B, 4)."""
        return np.asarray(position[self.body] + turned(quaternion[self.body], self.position))


@dataclass(frozen=True)
class Floor:
    """A plane that is fixed to the world."""

    normal: tuple[float, float, float]
    distance_m: float
    """from the world's origin, along the normal"""


@dataclass(frozen=True)
class Drawing:
    """All that is seen of a model."""

    solids: dict[Kind, Solids]
    """without kinds of which there is none"""
    meshes: tuple[Mesh, ...]
    strings: tuple[String, ...]
    floor: Floor | None


def drawing(model: mujoco.MjModel) -> Drawing:
    """What is seen of the model."""
    geoms, sites = _things(model, "geom"), _things(model, "site")
    geoms.shown &= geoms.group < SHOWN_GROUPS
    sites.shown &= np.isin(sites.group, STUDIO.site_groups)
    meshes, boxed = _meshes(model, geoms)
    solids = {}
    for kind, types in KINDS.items():
        found = geoms.of(types) + sites.of(types)
        if kind == "boxes":
            found += boxed
        if len(found):
            solids[kind] = found
    return Drawing(solids, meshes, _strings(model), _floor(model, geoms))


@dataclass
class _Things:
    """Geoms or sites as MuJoCo has them."""

    type: Numbers
    group: Numbers
    shown: NDArray[np.bool_]
    every: Solids

    def of(self, types: tuple[int, ...]) -> Solids:
        return self.every.chosen(np.isin(self.type, types) & self.shown)


def _things(model: mujoco.MjModel, what: Literal["geom", "site"]) -> _Things:
    def of(name: str) -> Numbers:
        return np.array(getattr(model, f"{what}_{name}"))

    kind, size = of("type"), of("size").astype(np.float64)
    size[kind == _GEOM.mjGEOM_SPHERE] = size[kind == _GEOM.mjGEOM_SPHERE, :1]
    rgba = _rgba(model, of("rgba"), of("matid"))
    every = Solids(of("bodyid").astype(np.int64), of("pos"), of("quat"), size, _bytes(rgba))
    return _Things(kind, of("group"), rgba[:, 3] >= LEAST_ALPHA, every)


def _rgba(model: mujoco.MjModel, own: Numbers, material: Numbers) -> Numbers:
    """(n, 4) a thing's own colour if it has one, else that of its material."""
    if not model.nmat:
        return own
    plain = (own == DEFAULT_RGBA).all(axis=1) & (material >= 0)
    return np.where(plain[:, None], model.mat_rgba[material], own)


def _bytes(rgba: Numbers) -> Colours:
    return np.rint(255 * np.clip(rgba, 0, 1)).astype(np.uint8)


def _meshes(model: mujoco.MjModel, geoms: _Things) -> tuple[tuple[Mesh, ...], Solids]:
    """The surfaces, each with the geoms of one colour that have it; and boxes for those beyond the bound."""
    is_mesh = geoms.type == _GEOM.mjGEOM_MESH
    looks: dict[tuple[int, bytes], list[int]] = {}
    for geom in np.flatnonzero(is_mesh & geoms.shown).tolist():
        look = int(model.geom_dataid[geom]), geoms.every.colour[geom].tobytes()
        looks.setdefault(look, []).append(geom)
    found, boxed, faces = [], np.zeros(len(is_mesh), np.bool_), 0
    for (mesh, _), alike in sorted(looks.items(), key=lambda item: model.mesh_facenum[item[0][0]]):
        which = np.isin(np.arange(len(is_mesh)), alike)
        faces += int(model.mesh_facenum[mesh])
        if faces > MOST_FACES:
            boxed |= which
        else:
            found.append(Mesh(*_surface(model, mesh), geoms.every.chosen(which)))
    boxes = geoms.every.chosen(boxed)
    middle, half = np.split(model.geom_aabb[boxed], 2, axis=1)
    placed = boxes.position + turned(boxes.quaternion, middle)
    return tuple(found), Solids(boxes.body, placed, boxes.quaternion, half, boxes.colour)


def _surface(model: mujoco.MjModel, mesh: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    faces = slice(model.mesh_faceadr[mesh], model.mesh_faceadr[mesh] + model.mesh_facenum[mesh])
    corners = model.mesh_vertadr[mesh] + model.mesh_face[faces].ravel()
    normals = model.mesh_normaladr[mesh] + model.mesh_facenormal[faces].ravel()
    return np.array(model.mesh_vert[corners]), np.array(model.mesh_normal[normals])


def _strings(model: mujoco.MjModel) -> tuple[String, ...]:
    """The tendons that pass through sites alone."""
    rgba = _rgba(model, np.array(model.tendon_rgba), np.array(model.tendon_matid))
    strings = []
    for tendon in range(model.ntendon):
        first, number = model.tendon_adr[tendon], model.tendon_num[tendon]
        passed = slice(first, first + number)
        straight = (model.wrap_type[passed] == mujoco.mjtWrap.mjWRAP_SITE).all()
        if straight and model.tendon_group[tendon] < SHOWN_GROUPS and rgba[tendon, 3] >= LEAST_ALPHA:
            sites = model.wrap_objid[passed]
            body, position = model.site_bodyid[sites].astype(np.int64), np.array(model.site_pos[sites])
            strings.append(String(body, position, float(model.tendon_width[tendon]), _bytes(rgba[tendon])))
    return tuple(strings)


def _floor(model: mujoco.MjModel, geoms: _Things) -> Floor | None:
    """The first plane that is fixed to the world."""
    fixed = model.body_weldid[geoms.every.body] == 0
    planes = np.flatnonzero((geoms.type == _GEOM.mjGEOM_PLANE) & geoms.shown & fixed)
    if not planes.size:
        return None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    normal = data.geom_xmat[planes[0]].reshape(3, 3)[:, 2]
    x, y, z = normal.tolist()
    return Floor((x, y, z), float(normal @ data.geom_xpos[planes[0]]))
