"""What surrounds the body and how it lies in it: floor, lights, postures, a face. No textures."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from babble.worlds.mimo.body import ROOT, turn

__all__ = [
    "CLEARANCE_M",
    "POSTURES",
    "Posture",
    "add_face",
    "add_floor",
    "add_sky",
    "hold_head",
    "lowest_point",
    "place",
    "set_angles",
    "weld",
]

CLEARANCE_M = 0.001
FACE_GROUP = 2
"""The site group of pupils and mouth; an eye's own view can leave it out."""


@dataclass(frozen=True)
class Posture:
    """How the body is put down: the rotation of its root and the joints that are not at 0, in degrees."""

    turn_deg: tuple[float, float, float]
    joints_deg: Mapping[str, float]


def _both_sides(angles: Mapping[str, float]) -> dict[str, float]:
    return {f"robot:{side}_{name}": angle for side in ("right", "left") for name, angle in angles.items()}


POSTURES: dict[str, Posture] = {
    "standing": Posture((0, 0, 0), {}),
    "supine": Posture((0, -90, 0), {}),
    "prone": Posture((0, 90, 0), {}),
    "sitting": Posture((0, 10, 0), _both_sides({"hip1": -95, "hip2": -25, "knee": -30, "elbow": -20})),
}
"""supine: on the back; prone: on the belly; sitting: legs forward and apart, leaning on nothing."""


def add_floor(spec: mujoco.MjSpec) -> None:
    """A floor at height 0 under a sky; see `add_sky`."""
    add_sky(spec)
    spec.add_material(name="floor", rgba=(0.66, 0.66, 0.62, 1), specular=0, shininess=0)
    spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(0, 0, 0.25), material="floor"
    )


def add_sky(spec: mujoco.MjSpec) -> None:
    """A sky of one colour and two lights, of which one casts shadows: for what hangs in the air."""
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_FLAT,
        rgb1=(0.80, 0.87, 0.93),
        width=2,
        height=12,
    )
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = (0.35,) * 3, (0.25,) * 3
    spec.worldbody.add_light(
        pos=(0, 0, 3),
        dir=(0, 0, -1),
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        diffuse=(0.4,) * 3,
        specular=(0,) * 3,
        castshadow=False,
    )
    spec.worldbody.add_light(pos=(1.5, 1, 3), dir=(-0.4, -0.3, -0.8), diffuse=(0.25,) * 3, specular=(0,) * 3)


def place(spec: mujoco.MjSpec, posture: str) -> dict[str, float]:
    """Put the body's root down in one of `POSTURES`, so that its lowest point is just above height 0.

    Returns the angles of the joints that the posture bends, in radians by joint name; `set_angles` puts them
    into a simulation. Joints that the body lacks are left out. Raises ValueError for an unknown posture.
    """
    if posture not in POSTURES:
        raise ValueError(f"there is no posture {posture!r}; the postures are {', '.join(POSTURES)}")
    chosen = POSTURES[posture]
    angles = {name: math.radians(deg) for name, deg in chosen.joints_deg.items() if spec.joint(name)}
    root = spec.body(ROOT)
    turn(root, chosen.turn_deg)
    model = spec.copy().compile()
    data = mujoco.MjData(model)
    set_angles(model, data, angles)
    mujoco.mj_kinematics(model, data)
    root.pos = (0, 0, CLEARANCE_M - lowest_point(model, data))
    return angles


def set_angles(model: mujoco.MjModel, data: mujoco.MjData, angles_rad: Mapping[str, float]) -> None:
    """Write joint angles into `data.qpos`; nothing is computed from them yet."""
    for name, angle in angles_rad.items():
        data.qpos[model.joint(name).qposadr[0]] = angle


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData) -> float:
    """The height of the body's lowest point, from the support of each geom along z."""
    up = data.geom_xmat[:, 6:9]
    size, kind = model.geom_size, model.geom_type
    long = np.abs(up[:, 2]) * size[:, 1]
    reach = np.select(
        [
            kind == mujoco.mjtGeom.mjGEOM_SPHERE,
            kind == mujoco.mjtGeom.mjGEOM_CAPSULE,
            kind == mujoco.mjtGeom.mjGEOM_BOX,
        ],
        [size[:, 0], size[:, 0] + long, (np.abs(up) * size).sum(axis=1)],
        size[:, 0] * np.hypot(up[:, 0], up[:, 1]) + long,
    )
    of_body = model.body_rootid[model.geom_bodyid] == model.body(ROOT).id
    return float((data.geom_xpos[:, 2] - reach)[of_body].min())


def hold_head(spec: mujoco.MjSpec) -> None:
    """Weld head and eyes to the trunk, as MIMo's rollover scene does: an infant that does not look around."""
    for body, onto in (("head", "upper_body"), ("left_eye", "head"), ("right_eye", "head")):
        weld(spec, body, onto)


def weld(spec: mujoco.MjSpec, body: str, onto: str) -> None:
    """Hold two bodies together as they are at the model's initial pose."""
    equality = spec.add_equality(
        type=mujoco.mjtEq.mjEQ_WELD, name1=body, name2=onto, objtype=mujoco.mjtObj.mjOBJ_BODY
    )
    # MuJoCo's default is a joint's polynomial, which a weld reads as an anchor a metre away. A pose of zeros
    # means the initial one; data[10] weighs rotation against position.
    equality.data[:] = 0
    equality.data[10] = 1


def add_face(spec: mujoco.MjSpec) -> None:
    """Pupils and a mouth, to see where the infant looks: sites, so that nothing of the physics changes."""
    for side in ("left", "right"):
        if eye := spec.body(f"{side}_eye"):
            _dot(
                eye,
                f"{side}_pupil",
                pos=(0.0102, 0, 0),
                size=(0.0016, 0.0052, 0.0052),
                rgba=(0.1, 0.08, 0.06, 1),
            )
    if head := spec.body("head"):
        _dot(head, "mouth", pos=(0.0805, 0, 0.047), size=(0.002, 0.013, 0.0035), rgba=(0.75, 0.35, 0.35, 1))


def _dot(body: mujoco.MjsBody, name: str, **figures: tuple[float, ...]) -> None:
    body.add_site(name=name, type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, group=FACE_GROUP, **figures)
