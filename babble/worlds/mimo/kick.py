"""`MimoKick`: on its back, a leg tied to a mobile that moves as the child kicks (thesis 5.2).

The mobile paradigm of Rovee-Collier: with the ribbon tied, kicking pays in proportion to its vigour
(conjugate reinforcement); untied, the same mobile hangs there and shows how much the child kicks anyhow.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from babble.worlds.batch import Floats
from babble.worlds.checks import check_choice, check_number
from babble.worlds.mimo.body import SENSOR_SITES, infant
from babble.worlds.mimo.figures import Figures, load
from babble.worlds.mimo.scenes import add_face, add_floor, hold_head, place
from babble.worlds.mimo.whole_body import Stirred, StirredParameters, moving
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import MujocoEnv, blueprint
from babble.worlds.physics.task import Copies
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.rendering import View

Triple = tuple[float, float, float]

HOOK_M = (-0.2, 0.0, 0.78)
"""The mobile hangs above the chest, out of reach of hands and feet; feet are towards +x."""
POST_X_M = -0.7
"""of the stand, behind the head"""
STEM_M, ARM_M, STRING_M = 0.12, 0.12, 0.12
BALL_RADIUS_M, BALL_KG, CROSS_KG = 0.025, 0.02, 0.04
HUB_DAMPING, BALL_DAMPING = 8e-3, 1e-3
"""N m s: the mobile comes to rest within some seconds."""
SWING_DEG = 70.0
BALLS: tuple[tuple[tuple[int, int], tuple[float, float, float, float]], ...] = (
    ((1, 0), (0.85, 0.25, 0.2, 1)),
    ((0, 1), (0.95, 0.75, 0.2, 1)),
    ((-1, 0), (0.2, 0.5, 0.8, 1)),
    ((0, -1), (0.35, 0.7, 0.35, 1)),
)
"""Of each ball: its arm's direction, and its colour."""
ANKLE_M = -0.15
"""on the lower leg, from the knee"""
SETTLE_SECS = 5.0


@dataclass(frozen=True, kw_only=True)
class KickParameters(StirredParameters):
    """Parameters of `MimoKick`."""

    senses: tuple[str, ...] = ("position", "velocity")
    episode_steps: int = 500
    side: str = "right"
    """the leg that is tied: right or left"""
    tied: bool = True
    """whether the ribbon is tied; without it, nothing that the child does moves the mobile"""
    ribbon_m: float = 0.65
    """the ribbon's length, beyond which it pulls; lying still, ankle and mobile are about 0.76 m apart"""
    ribbon_stiffness: float = 20.0
    """in N/m"""
    head_held: bool = True
    """the head fixed to the trunk and the eyes to the head; their joints are then no part of the world"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("side", self.side, ("right", "left"))
        check_number("ribbon_m", self.ribbon_m, least=0.3, most=1.0)
        check_number("ribbon_stiffness", self.ribbon_stiffness, least=1.0, most=200.0)


class MimoKick(MujocoEnv):
    """Supine under a mobile, tied to one leg; rewarded for the mobile's speed, in m/s.

    The reward of a step is the mean of the speeds of the mobile's four balls: (|v1| + ... + |v4|) / 4,
    with v the velocity of a ball's middle in m/s.
    """

    Parameters = KickParameters
    view = View(lookat_m=(-0.2, 0, 0.36), azimuth_deg=115, elevation_deg=-10, distance_m=1.5)

    def build(self, parameters: KickParameters) -> Blueprint:
        """The whole body with mitten hands on its back under the mobile."""
        figures = load("mitten")
        spec = infant(figures)
        add_floor(spec)
        add_face(spec)
        angles_rad = place(spec, "supine")
        if parameters.head_held:
            hold_head(spec)
        _add_stand(spec)
        knot = _add_mobile(spec)
        if parameters.tied:
            _tie(spec, parameters, knot)
        model = spec.compile()
        joints, motors = moving(model, head_held=parameters.head_held)
        return blueprint(
            "MimoKick",
            model,
            parameters,
            joints=joints,
            actuators=motors,
            task=lambda: Kicking(model, joints, figures, parameters, angles_rad),
        )


class Kicking(Stirred):
    """Rewarded for the mean speed of the mobile's balls."""

    rewarded = True

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Indices,
        figures: Figures,
        parameters: KickParameters,
        angles_rad: Mapping[str, float],
    ) -> None:
        super().__init__(model, joints, figures, parameters, angles_rad, SETTLE_SECS)
        starts = [model.sensor(_speed_of(ball)).adr[0] for ball in range(len(BALLS))]
        self._velocities = np.add.outer(starts, range(3))
        """(balls, 3) where they are in the sensor data"""

    def reward(self, copies: Copies) -> Floats:
        """(E,) m/s"""
        velocity = np.array([data.sensordata for data in copies])[:, self._velocities]
        return np.linalg.norm(velocity, axis=2).mean(axis=1).astype(np.float32)


def _add_stand(spec: mujoco.MjSpec) -> None:
    """A post behind the head with a boom to the hook."""
    x, y, z = HOOK_M
    for foot, top in (((POST_X_M, y, 0), (POST_X_M, y, z)), ((POST_X_M, y, z), (x, y, z))):
        _rod(spec.worldbody, foot, top, radius=0.012)


def _add_mobile(spec: mujoco.MjSpec) -> str:
    """A cross that hangs and turns on a stem, a ball on a string from each arm. Returns the knot's site.

    Nothing of it collides, and its bodies have no name: they are no part of the child, nor of its skin.
    """
    hub = spec.worldbody.add_body(pos=HOOK_M)
    for axis, limit in (("x", SWING_DEG), ("y", SWING_DEG), ("z", None)):
        _hinge(hub, f"mobile:{axis}", axis, HUB_DAMPING, limit)
    cross = (0.0, 0.0, -STEM_M)
    _rod(hub, (0, 0, 0), cross, radius=0.003, mass=0.002)
    for ball, ((x, y), colour) in enumerate(BALLS):
        end = (ARM_M * x, ARM_M * y, -STEM_M)
        _rod(hub, cross, end, radius=0.005, mass=CROSS_KG / len(BALLS))
        pendulum = hub.add_body(pos=end)
        for axis in "xy":
            _hinge(pendulum, f"mobile:{ball}{axis}", axis, BALL_DAMPING, SWING_DEG)
        _rod(pendulum, (0, 0, 0), (0, 0, -STRING_M), radius=0.0015, mass=0.001)
        _ball(spec, pendulum, ball, colour)
    knot = "mobile:knot"
    hub.add_site(name=knot, pos=cross, size=(0.004, 0, 0), group=SENSOR_SITES)
    return knot


def _ball(spec: mujoco.MjSpec, pendulum: mujoco.MjsBody, ball: int, colour: tuple[float, ...]) -> None:
    name, pos = f"mobile:{ball}", (0, 0, -STRING_M)
    pendulum.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        name=name,
        pos=pos,
        size=(BALL_RADIUS_M, 0, 0),
        mass=BALL_KG,
        rgba=colour,
        contype=0,
        conaffinity=0,
    )
    spec.add_sensor(
        name=_speed_of(ball),
        type=mujoco.mjtSensor.mjSENS_FRAMELINVEL,
        objtype=mujoco.mjtObj.mjOBJ_GEOM,
        objname=name,
    )


def _speed_of(ball: int) -> str:
    return f"mobile:velocity{ball}"


def _tie(spec: mujoco.MjSpec, parameters: KickParameters, knot: str) -> None:
    """A ribbon from the ankle to the mobile: a spring that pulls when it is stretched, and never pushes."""
    ankle = f"{parameters.side}_ankle"
    leg = spec.body(f"{parameters.side}_lower_leg")
    leg.add_site(name=ankle, pos=(0, 0, ANKLE_M), group=SENSOR_SITES)
    ribbon = spec.add_tendon(name="ribbon", springlength=(0, parameters.ribbon_m))
    ribbon.width, ribbon.rgba = 0.004, (0.9, 0.45, 0.6, 1)
    ribbon.stiffness[0] = parameters.ribbon_stiffness
    ribbon.wrap_site(ankle)
    ribbon.wrap_site(knot)


def _hinge(body: mujoco.MjsBody, name: str, axis: str, damping: float, limit_deg: float | None) -> None:
    hinge = body.add_joint(name=name, axis=np.eye(3)["xyz".index(axis)])
    hinge.damping[0] = damping
    if limit_deg is not None:
        hinge.limited, hinge.range = True, (-limit_deg, limit_deg)


def _rod(
    body: mujoco.MjsBody, start: Triple, end: Triple, *, radius: float, mass: float | None = None
) -> None:
    """A thin rod; one with a mass is light and lets everything through."""
    rod = body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_CAPSULE,
        fromto=(*start, *end),
        size=(radius, 0, 0),
        rgba=(0.83, 0.66, 0.45, 1),
    )
    if mass is not None:
        rod.mass, rod.contype, rod.conaffinity = mass, 0, 0
