"""`MimoReach`: a sitting child that can move its right arm, and a ball in the air to touch (thesis 1.1)."""

import math
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.batch import Flags, Floats, Start
from babble.worlds.checks import check_number
from babble.worlds.mimo.body import SENSOR_SITES, infant
from babble.worlds.mimo.cuts import cut
from babble.worlds.mimo.figures import Figures, load
from babble.worlds.mimo.scenes import add_face, add_floor, place, set_angles
from babble.worlds.mimo.whole_body import Stirred, StirredParameters
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import MujocoEnv, blueprint
from babble.worlds.physics.task import Copies
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.rendering import View

ARM = ("robot:right_shoulder_*", "robot:right_elbow", "robot:right_hand?", "robot:right_fingers")
LOOKING_RAD = {
    name: math.radians(angle)
    for name, angle in {
        "robot:head_tilt": 15,
        "robot:left_shoulder_horizontal": 20,
        "robot:left_elbow": -40,
    }.items()
}
"""Besides the sitting posture: the head bent to where the ball will be, the other hand in the lap."""
HAND_MIDDLE_M = (0.005, 0.0, 0.0416)
"""of the hand in its own frame: where the fingers begin"""
BALL_RADIUS_M = 0.03
PARKED_M = (0.0, 0.0, 2.0)
"""where the ball is while nobody may touch it"""
NEAREST_M, FARTHEST_M = (0.06, -0.30, 0.10), (0.40, 0.15, 0.50)
"""Corners of the box in front of the child in which the ball may be, where the hand can get to."""
CLEAR_M = 0.08
"""The ball is at least so far from the hand at the beginning."""
TOUCHING_M = 0.15
"""The hand reaches 0.05 m from where its fingers begin: farther away it need not be asked for a touch."""
SHARE_OF_RANGE = 0.8
MAX_DRAWS = 1000
SETTLE_SECS = 3.0


@dataclass(frozen=True, kw_only=True)
class ReachParameters(StirredParameters):
    """Parameters of `MimoReach`."""

    senses: tuple[str, ...] = ("position", "velocity")
    episode_steps: int = 200
    target_felt: bool = True
    """whether the sense "target" is added: from the hand to the ball, (3,) in metres: forward, left, up"""
    touch_bonus: float = 10.0
    """reward of the step in which the hand touches the ball"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_number("touch_bonus", self.touch_bonus, least=0.0, most=1e6)


class MimoReach(MujocoEnv):
    """Reaching with the right arm; rewarded by minus the distance to the ball, and by a bonus at touch.

    The reward of a step is -d, with d the distance in metres from where the fingers begin to the middle
    of the ball, plus `touch_bonus` when palm or fingers touch the ball, which ends the episode. The ball
    does not move; its place is drawn anew for each episode, where the hand can get to. All of the child
    but its right arm is held still.
    """

    Parameters = ReachParameters
    view = View(lookat_m=(0.08, -0.03, 0.24), azimuth_deg=200, elevation_deg=-15, distance_m=1.1)

    def build(self, parameters: ReachParameters) -> Blueprint:
        """The child held in a sitting posture, with the joints of one arm."""
        figures = load("mitten")
        model = sitting_with_a_free_arm(figures).compile()
        joints = np.arange(model.njnt)
        made = blueprint(
            "MimoReach",
            model,
            parameters,
            joints=joints,
            actuators=np.arange(model.nu),
            task=lambda: Reaching(model, joints, figures, parameters),
        )
        if not parameters.target_felt:
            return made
        return replace(made, senses=lambda actuation, rng: [*made.senses(actuation, rng), Target(model)])


class Target:
    """Where the ball is, seen from the hand; implements `Sense`."""

    name = "target"
    shape = (3,)
    components = ("forward", "left", "up")

    def __init__(self, model: mujoco.MjModel) -> None:
        self._hand = model.site("reaching").id
        self._ball = model.geom("ball").id

    def read(self, copies: Copies) -> Floats:
        """(E, 3) metres: forward, to the left and up."""
        return np.array(
            [data.geom_xpos[self._ball] - data.site_xpos[self._hand] for data in copies], np.float32
        )


class Reaching(Stirred):
    """Rewarded by nearness, over at touch."""

    rewarded = True

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Indices,
        figures: Figures,
        parameters: ReachParameters,
    ) -> None:
        super().__init__(model, joints, figures, parameters, {}, SETTLE_SECS)
        self._target = Target(model)
        self._bonus = parameters.touch_bonus
        self._ball = model.geom("ball").id
        self._hand_site = model.site("reaching").id
        hand = [model.body(f"right_{part}").id for part in ("hand", "fingers")]
        self._of_hand = np.isin(model.geom_bodyid, hand)
        self._spare = mujoco.MjData(model)

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """The arm at rest and then pushed; the ball where the hand could be and nothing else is."""
        super().begin(data, rng, start)
        for _ in range(MAX_DRAWS):
            data.mocap_pos[0] = self._place(rng)
            mujoco.mj_fwdPosition(self.model, data)
            if self._distance([data])[0] > CLEAR_M and not (data.contact.geom == self._ball).any():
                return
        raise ValueError(f"no place for the ball was found in {MAX_DRAWS} draws; give the arm more mobility")

    def reward(self, copies: Copies) -> Floats:
        """(E,) minus metres, with the bonus at touch."""
        distance = self._distance(copies)
        return (self._bonus * self._touched(copies, distance) - distance).astype(np.float32)

    def terminated(self, copies: Copies) -> Flags:
        """Whose hand touches the ball."""
        return self._touched(copies, self._distance(copies))

    def _distance(self, copies: Copies) -> Floats:
        return np.sqrt((self._target.read(copies) ** 2).sum(axis=1))

    def _touched(self, copies: Copies, distance: Floats) -> Flags:
        touched = distance < TOUCHING_M
        for index in np.flatnonzero(touched).tolist():
            pairs = copies[index].contact.geom
            touched[index] = self._of_hand[pairs[(pairs == self._ball).any(axis=1)]].any()
        return np.asarray(touched)

    def _place(self, rng: np.random.Generator) -> NDArray[np.float64]:
        """(3,) where the hand is in a random posture of the arm that bumps into nothing, in front."""
        middle, half = (self._low + self._high) / 2, SHARE_OF_RANGE * (self._high - self._low) / 2
        spare = self._spare
        for _ in range(MAX_DRAWS):
            spare.qpos[self._qpos] = middle + half * rng.uniform(-1, 1, len(middle))
            mujoco.mj_fwdPosition(self.model, spare)
            place = spare.site_xpos[self._hand_site]
            if not spare.ncon and ((place > NEAREST_M) & (place < FARTHEST_M)).all():
                return np.array(place)
        raise ValueError(
            f"no free posture of the arm was found in {MAX_DRAWS} draws; give the arm more mobility"
        )


def sitting_with_a_free_arm(figures: Figures) -> mujoco.MjSpec:
    """The child, stiff in the sitting posture but for the joints of its right arm; a floor and a ball."""
    whole = infant(figures)
    angles_rad = place(whole, "sitting") | LOOKING_RAD
    posed = whole.compile()
    data = mujoco.MjData(posed)
    set_angles(posed, data, {name: angle for name, angle in angles_rad.items() if not _of_arm(name)})
    mujoco.mj_kinematics(posed, data)
    spec = cut(figures, root="hip", joints=ARM)
    for body in spec.bodies[1:]:
        _pose(body, data)
    add_floor(spec)
    add_face(spec)
    spec.body("right_hand").add_site(name="reaching", pos=HAND_MIDDLE_M, group=SENSOR_SITES)
    ball = spec.worldbody.add_body(pos=PARKED_M, mocap=True)  # nameless, so that it has no skin
    ball.add_geom(
        name="ball",
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(BALL_RADIUS_M, 0, 0),
        rgba=(0.85, 0.25, 0.2, 1),
    )
    return spec


def _pose(body: mujoco.MjsBody, data: mujoco.MjData) -> None:
    """Put a body on its parent as it is in `data`, of another model with bodies of these names."""
    there, above = data.body(body.name), data.body(body.parent.name)
    back, turned, pos = np.zeros(4), np.zeros(4), np.zeros(3)
    mujoco.mju_negQuat(back, above.xquat)
    mujoco.mju_mulQuat(turned, back, there.xquat)
    mujoco.mju_rotVecQuat(pos, there.xpos - above.xpos, back)
    body.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.pos, body.quat = pos, turned


def _of_arm(joint: str) -> bool:
    return any(fnmatchcase(joint, pattern) for pattern in ARM)
