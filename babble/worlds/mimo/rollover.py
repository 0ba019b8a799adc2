"""`MimoRollover`: the whole body on the floor (thesis 4.5): 46 motors, 49 joints, 98 observations.

With five-fingered hands 88 motors, 91 joints and 182 observations.
"""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.patterns import matching
from babble.worlds.batch import Start
from babble.worlds.checks import check_choice, check_count, check_number
from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import HANDS, Hands, load
from babble.worlds.mimo.scenes import CLEARANCE_M, add_face, add_floor, hold_head, lowest_point, place
from babble.worlds.mimo.whole_body import moving, settled
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import BodyParameters, MujocoEnv, blueprint
from babble.worlds.physics.names import names_of
from babble.worlds.physics.stability import run
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.joints import Unit
from babble.worlds.senses.rendering import View

POSES = ("supine", "prone")
TRUNK = "lower_body"
"""The middle of the trunk, against which pelvis and chest twist by 18 degrees at most, each the other way."""
REACH_SHARE = 0.3
"""At a random start, how far each joint may be from rest, as a share of half of its range."""
CALM_SECS = 1.0
"""How long a body put down at random comes to rest."""
SETTLE_SECS = 2.0
"""How long the body lies still, once, to find the pose in which episodes begin."""


@dataclass(frozen=True, kw_only=True)
class RolloverParameters(BodyParameters):
    """Parameters of `MimoRollover`."""

    senses: tuple[str, ...] = ("position", "velocity")
    angles: Unit = "radians"
    episode_steps: int = 500
    hands: Hands = "mitten"
    """all fingers as one flap ("mitten"), or each with its joints ("five_finger"), as the big toe then has"""
    start: str = "supine"
    """on the back ("supine") or on the belly ("prone")"""
    reset_noise_rad: float = 0.01
    """each joint begins so far, at most, from the settled pose"""
    settle_steps: int = 100
    """physics steps without action before an episode begins"""
    head_held: bool = True
    """the head fixed to the trunk and the eyes to the head"""
    sides: bool = False
    """whether scores say how often a change of goal turns the body from its back to its belly or back"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("hands", self.hands, HANDS)
        check_choice("start", self.start, POSES)
        check_number("reset_noise_rad", self.reset_noise_rad, least=0, most=1)
        check_count("settle_steps", self.settle_steps, least=0, most=10_000)


class MimoRollover(MujocoEnv):
    """The body lying on a floor; nothing is rewarded from outside."""

    Parameters = RolloverParameters
    view = View(lookat_m=(0, 0, 0.05), azimuth_deg=120, elevation_deg=-30, distance_m=1.3)

    def build(self, parameters: RolloverParameters) -> Blueprint:
        """The whole body on a floor."""
        spec = infant(load(parameters.hands))
        add_floor(spec)
        add_face(spec)
        place(spec, parameters.start)
        if parameters.head_held:
            hold_head(spec)
        model = spec.compile()
        joints = matching(names_of(model, "joint"), ["robot:*"], "joint")
        return blueprint(
            "MimoRollover",
            model,
            parameters,
            joints=joints,
            actuators=np.arange(model.nu),
            task=lambda: Lying(model, moving(model, head_held=parameters.head_held)[0], parameters),
            sided=model.body(TRUNK).id if parameters.sides else None,
        )


class Lying(Play):
    """Episodes begin at rest on the floor, a little different each time."""

    def __init__(self, model: mujoco.MjModel, loose: Indices, parameters: RolloverParameters) -> None:
        """`loose` are the joints that are not held."""
        super().__init__(model, loose)
        self._noise = parameters.reset_noise_rad
        self._settle_steps = parameters.settle_steps
        self._settled = settled(model, {}, SETTLE_SECS)

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """At rest with a little noise; a random start is on either side, with its limbs anywhere near."""
        data.qpos[:] = self._settled
        middle = data.qpos[self._qpos]
        if start == "random":
            if rng.integers(2):
                turn_over(data.qpos)
            reach = REACH_SHARE * rng.uniform(-1, 1, len(middle)) * (self._high - self._low) / 2
            data.qpos[self._qpos] = np.clip(middle + reach, self._low, self._high)
            put_down(self.model, data)
            run(self.model, data, round(CALM_SECS / self.model.opt.timestep))
        else:
            data.qpos[self._qpos] = middle + rng.uniform(-self._noise, self._noise, len(middle))
        run(self.model, data, self._settle_steps)


def turn_over(qpos: NDArray[np.float64]) -> None:
    """Turn a root pose, the first seven numbers, by half a turn about its long axis."""
    half_turn, turned = np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(4)
    mujoco.mju_mulQuat(turned, qpos[3:7], half_turn)
    qpos[3:7] = turned


def put_down(model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Move the body up or down until its lowest point is just above the floor."""
    mujoco.mj_kinematics(model, data)
    data.qpos[2] += CLEARANCE_M - lowest_point(model, data)
