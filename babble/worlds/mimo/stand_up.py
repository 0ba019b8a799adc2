"""`MimoStandUp`: the child sits at a bar, its hands fixed to it, and stands up (thesis 1.1, fig. 1.2)."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np

from babble.landmarks import Landmark
from babble.worlds.batch import Floats
from babble.worlds.checks import check_number
from babble.worlds.mimo.body import ROOT, SENSOR_SITES, infant, turn
from babble.worlds.mimo.figures import Figures, load
from babble.worlds.mimo.scenes import add_face, add_floor, hold_head
from babble.worlds.mimo.whole_body import Stirred, StirredParameters, moving
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import MujocoEnv, blueprint
from babble.worlds.physics.task import Copies
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.rendering import View

BAR_HEIGHT_M, BAR_RADIUS_M, BAR_HALF_LENGTH_M = 0.37, 0.011, 0.26
ANKLES_M = (-0.02, 0.06)
"""How far the ankles are before the bar and to either side: the toes are under it."""
HANDS_APART_M = 0.24
STIFF_SECS = 0.01
"""Time constant of what holds hands and feet: two physics steps, the stiffest that is stable."""
GRIP_HALF_WIDTH_M = 0.02
PALM_MIDDLE_M = (0.005, 0.02)
"""of the hand in its own frame: along its width and its length"""
SOLE_BELOW_FOOT_M = 0.0099
MARK = 0.25
"""Shares of the ranges, -1 to 1: beyond it hips and knees are stretched and the shins upright on the feet,
below its negative the child sits. Stretched legs alone may also hang from the bar, leaning far back."""
PALM_TO_BAR_M = 0.01 + 0.001 + BAR_RADIUS_M
"""from the middle of the palm, half of its thickness and a millimetre of air, to the bar's axis"""
SEAT_M = (-0.215, 0.0, 0.046)
LEAN_DEG = -46.0
SITTING_DEG: dict[str, float] = {
    "shoulder_horizontal": 75,
    "shoulder_ad_ab": 115,
    "elbow": -8,
    "hand1": -9,
    "hand2": 33,
    "hand3": 8,
    "fingers": -78,
    "hip1": -95,
    "hip3": -3,
    "knee": -101,
    "foot1": -40,
}
"""Of both sides, in degrees; the trunk's are below. Found by letting the body, put into a squat before
the bar, sag for 3 s; each world lets it come to rest from here once more."""
BEND_DEG = 30.5
SETTLE_SECS = 1.0


@dataclass(frozen=True, kw_only=True)
class StandUpParameters(StirredParameters):
    """Parameters of `MimoStandUp`."""

    senses: tuple[str, ...] = ("position", "velocity", "vestibular")
    episode_steps: int = 500
    alpha: float = 0.0005
    """of eq. 1: metres of head height that a squared torque of 1 (N m)^2 costs"""
    feet_held: bool = True
    """whether the soles are fixed to the floor, as in MIMo's public scene; free ones creep forward while
    the child rests, until its legs are straight, but it can stand up with them too"""
    head_held: bool = True
    """the head fixed to the trunk and the eyes to the head; their joints are then no part of the world"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("alpha", self.alpha, least=0.0, most=1.0)


class MimoStandUp(MujocoEnv):
    """Sitting with both hands on a bar; rewarded for the head's height, in metres, less alpha |torque|^2.

    The reward of a step is eq. 1: the height of the middle of the head above the floor, minus `alpha`
    times the sum of the squares of all motors' torques in N m, at the end of the step. Sitting still
    gives 0.40; standing, with the head at 0.67 m, 0.59 to 0.65, as it takes 25 to 170 (N m)^2 to hold;
    uniformly random actions 0.22, as they spend 225 (N m)^2 for a head at 0.33 m.
    """

    Parameters = StandUpParameters
    view = View(lookat_m=(-0.06, 0, 0.34), azimuth_deg=150, elevation_deg=-15, distance_m=1.35)

    def build(self, parameters: StandUpParameters) -> Blueprint:
        """The whole body with mitten hands, sitting on a floor before a bar."""
        figures = load("mitten")
        spec, angles_rad = sitting_at_a_bar(figures, feet_held=parameters.feet_held)
        if parameters.head_held:
            hold_head(spec)
        model = spec.compile()
        joints, motors = moving(model, head_held=parameters.head_held)
        return blueprint(
            "MimoStandUp",
            model,
            parameters,
            joints=joints,
            actuators=motors,
            task=lambda: StandingUp(model, joints, figures, parameters, angles_rad),
            landmarks=_landmarks(model, joints),
        )


class StandingUp(Stirred):
    """Rewarded by eq. 1."""

    rewarded = True

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Indices,
        figures: Figures,
        parameters: StandUpParameters,
        angles_rad: Mapping[str, float],
    ) -> None:
        super().__init__(model, joints, figures, parameters, angles_rad, SETTLE_SECS)
        self._head = model.geom("head").id
        self._alpha = parameters.alpha

    def reward(self, copies: Copies) -> Floats:
        """(E,) metres: the head's height less alpha |torque|^2."""
        height = np.array([data.geom_xpos[self._head, 2] for data in copies])
        torque = np.array([data.actuator_force for data in copies]) * self.model.actuator_gear[:, 0]
        return (height - self._alpha * (torque**2).sum(axis=1)).astype(np.float32)


def sitting_at_a_bar(figures: Figures, *, feet_held: bool) -> tuple[mujoco.MjSpec, dict[str, float]]:
    """The body before the bar, its hands on it, and the angles (rad) of its joints when it sits there."""
    spec = infant(figures)
    add_floor(spec)
    add_face(spec)
    _add_bar(spec)
    turn(spec.body(ROOT), (0.0, LEAN_DEG, 0.0), pos=SEAT_M)
    for side, outwards in (("right", -1.0), ("left", 1.0)):
        _hold_hand(spec, side, outwards)
        if feet_held:
            _hold_foot(spec, side, outwards)
    angles_deg = {
        f"robot:{side}_{part}": angle for side in ("right", "left") for part, angle in SITTING_DEG.items()
    }
    angles_deg |= {"robot:hip_bend1": BEND_DEG, "robot:hip_bend2": BEND_DEG}
    return spec, {name: math.radians(angle) for name, angle in angles_deg.items()}


def _add_bar(spec: mujoco.MjSpec) -> None:
    """A rail along y above the origin, on two posts; of the world itself, so that it has no skin."""
    ends = [np.array([0.0, side * BAR_HALF_LENGTH_M, BAR_HEIGHT_M]) for side in (-1, 1)]
    for name, start, end in (
        ("rail", *ends),
        *((f"post_{number}", end, end * (1, 1, 0)) for number, end in enumerate(ends)),
    ):
        spec.worldbody.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=(*start, *end),
            size=(BAR_RADIUS_M, 0, 0),
            rgba=(0.83, 0.66, 0.45, 1),
        )


def _hold_hand(spec: mujoco.MjSpec, side: str, outwards: float) -> None:
    """Fix two points before the palm to the rail's axis, so that the hand can only turn about the rail.

    Thumbs point inwards. Palms face along y in the hand's frame: the right one to -y, the left to +y.
    """
    across, along = PALM_MIDDLE_M
    for end in (-1, 1):
        grip, hold = f"{side}_grip_{end}", f"{side}_hold_{end}"
        pos = (across + end * GRIP_HALF_WIDTH_M, outwards * PALM_TO_BAR_M, along)
        spec.body(f"{side}_hand").add_site(name=grip, pos=pos, group=SENSOR_SITES)
        y = outwards * (HANDS_APART_M / 2 - end * GRIP_HALF_WIDTH_M)
        spec.worldbody.add_site(name=hold, pos=(0, y, BAR_HEIGHT_M), group=SENSOR_SITES)
        _join(spec, mujoco.mjtEq.mjEQ_CONNECT, grip, hold)


def _hold_foot(spec: mujoco.MjSpec, side: str, outwards: float) -> None:
    """Fix the sole to the floor where it stands."""
    x, y = ANKLES_M
    sole, print_ = f"{side}_sole", f"{side}_footprint"
    spec.body(f"{side}_foot").add_site(name=sole, pos=(0, 0, -SOLE_BELOW_FOOT_M), group=SENSOR_SITES)
    spec.worldbody.add_site(name=print_, pos=(x, outwards * y, 0), group=SENSOR_SITES)
    _join(spec, mujoco.mjtEq.mjEQ_WELD, sole, print_)


def _join(spec: mujoco.MjSpec, kind: mujoco.mjtEq, site: str, other: str) -> None:
    equality = spec.add_equality(type=kind, name1=site, name2=other, objtype=mujoco.mjtObj.mjOBJ_SITE)
    equality.data[:] = 0
    equality.data[10] = 1  # a weld's weight of rotation against position
    equality.solref = (STIFF_SECS, 1)


def _landmarks(model: mujoco.MjModel, joints: Indices) -> tuple[Landmark, ...]:
    names = [model.joint(joint).name for joint in joints]
    groups = tuple(
        tuple(names.index(f"robot:{side}_{part}") for part in parts for side in ("right", "left"))
        for parts in (("hip1",), ("knee",), ("knee", "foot1"))
    )
    return (Landmark("standing", groups, MARK, 1.0),)
