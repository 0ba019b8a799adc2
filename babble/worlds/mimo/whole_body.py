"""What worlds of the whole child share: which parts of it move, and how its episodes begin."""

from collections.abc import Mapping
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.patterns import matching
from babble.worlds.batch import Start
from babble.worlds.checks import check_number
from babble.worlds.mimo.figures import Figures
from babble.worlds.mimo.scenes import set_angles
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import BodyParameters
from babble.worlds.physics.names import names_of
from babble.worlds.physics.stability import run
from babble.worlds.physics.task import Play

PUSH_SECS = {"centre": 0.2, "random": 0.5}
"""How long the torques act before an episode begins."""
CALM_SECS = {"centre": 0.2, "random": 0.1}
"""How long the body is then left to itself."""


@dataclass(frozen=True, kw_only=True)
class StirredParameters(BodyParameters):
    """Parameters of a body whose episodes begin with a push."""

    start_push: float = 0.05
    """of each joint before an episode, at most, as a share of its motor's full torque"""
    random_push: float = 1.0
    """the same before an episode with a random start"""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("start_push", "random_push"):
            check_number(name, getattr(self, name), least=0.0, most=1.0)


class Stirred(Play):
    """Episodes begin where random torques push the resting body; nothing is rewarded yet.

    Joint angles drawn at random would tear hands off a bar and put limbs into one another; where the
    simulation itself goes is always possible.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        joints: Indices,
        figures: Figures,
        parameters: StirredParameters,
        angles_rad: Mapping[str, float],
        settle_secs: float,
    ) -> None:
        """Let the body come to rest, once, from the model's pose with the joints of `angles_rad` bent."""
        super().__init__(model, joints)
        torque = {motor.joint: motor.torque for motor in figures.motors}
        self._full_push = np.zeros(model.nv)
        for joint in joints:
            self._full_push[model.jnt_dofadr[joint]] = torque.get(model.joint(joint).name, 0.0)
        self._share = {"centre": parameters.start_push, "random": parameters.random_push}
        self.rest = settled(model, angles_rad, settle_secs)

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """At rest, then pushed: a little, or for a random start much and for longer."""
        data.qpos[:] = self.rest
        self._run(data, self._share[start] * rng.uniform(-1, 1, len(self._full_push)), PUSH_SECS[start])
        self._run(data, np.zeros(len(self._full_push)), CALM_SECS[start])

    def _run(self, data: mujoco.MjData, push: NDArray[np.float64], secs: float) -> None:
        data.qfrc_applied[:] = push * self._full_push
        run(self.model, data, round(secs / self.model.opt.timestep))


def moving(model: mujoco.MjModel, *, head_held: bool) -> tuple[Indices, Indices]:
    """The child's joints and its motors; without those of head and eyes where these are held."""
    still = ("head_*", "*_eye_*") if head_held else ()
    joints = matching(names_of(model, "joint"), ["robot:*", *(f"!robot:{part}" for part in still)], "joint")
    motors = matching(names_of(model, "actuator"), ["act:*", *(f"!act:{part}" for part in still)], "actuator")
    return joints, motors


def settled(model: mujoco.MjModel, angles_rad: Mapping[str, float], secs: float) -> NDArray[np.float64]:
    """(nq,) where a body without any drive is after so long, from the model's pose with these angles."""
    data = mujoco.MjData(model)
    set_angles(model, data, angles_rad)
    mujoco.mj_step(model, data, round(secs / model.opt.timestep))
    return np.array(data.qpos)
