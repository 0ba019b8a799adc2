"""MIMo's muscle model: each motor is replaced by two antagonists with activity, length and velocity.

After Wochner, Schumacher et al., "Learning with Muscles" (arXiv 2207.03952), with the parameters that
MIMo's authors calibrated (their actuator's user data: VMAX, and FMAX for either direction).
Where MIMo updates the activity once more at the beginning of an environment step, it is updated here
exactly once per physics step.
"""

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.physics.actuation import Actions, Copies, Flags, Floats, Indices, plain_motor

L_MIN, L_MAX = 0.5, 1.6
"""The ends of the force-length curve, in optimal fibre lengths."""
FV_MAX = 1.2
FP_MAX = 1.3
LCE_MIN, LCE_MAX = 0.75, 1.05
"""The fibre's length at either end of its joint's range."""
ACTIVATION_SECS = 0.01
DAMPING_SHARE = 1 / 20
"""What is left of a joint's damping, whose work the muscles do; its spring is taken out."""


class MuscleError(ValueError):
    """A model without what muscles need; the text is one sentence for a person."""


class Muscles:
    """Two antagonists per motor: an action is (closing..., opening...) excitations, -1 for 0 and 1 for 1.

    Needs a model whose motors were given to muscles by `hand_over`; `ranges` (motors, 2) in radians are
    those over which the muscles are stretched, also where a joint is restricted. Implements `Actuation`.
    """

    def __init__(self, model: mujoco.MjModel, actuators: Indices, ranges: Floats, columns: int) -> None:
        self.size = 2 * len(actuators)
        self.actuators = np.tile(actuators, 2)
        self._model = model
        self._motors = actuators
        joints = model.actuator_trnid[actuators, 0]
        self._qpos = model.jnt_qposadr[joints]
        self._dof = model.jnt_dofadr[joints]
        low, high = ranges.T
        moment = (LCE_MAX - LCE_MIN) / (high - low)
        self._moment = np.stack([moment, -moment], axis=1)
        """(motors, 2)"""
        self._reference = np.stack([LCE_MIN - moment * low, LCE_MIN + moment * high], axis=1)
        self._v_max, self._f_max = _calibrated(model, actuators)
        self._activity = np.zeros((columns, len(actuators), 2))
        self._force = np.zeros((columns, len(actuators), 2))

    def begin(self, columns: Flags) -> None:
        """The flagged copies' muscles are at rest."""
        self._activity[columns] = 0.0
        self._force[columns] = 0.0

    def advance(self, copies: Copies, action: Actions, physics_steps: int) -> None:
        """Excite, and step with the torque of the muscles renewed before each physics step."""
        excitation = (np.clip(np.stack(np.split(action, 2, axis=1), axis=2), -1, 1) + 1) / 2
        rate = self._model.opt.timestep / ACTIVATION_SECS
        for _ in range(physics_steps):
            self._activity = np.clip(self._activity + rate * (excitation - self._activity), 0, 1)
            position = np.array([data.qpos for data in copies])[:, self._qpos]
            velocity = np.array([data.qvel for data in copies])[:, self._dof]
            for data, torque in zip(copies, self._torque(position, velocity), strict=True):
                data.ctrl[self._motors] = torque
                mujoco.mj_step(self._model, data)

    def efforts(self) -> Floats:
        """(E, 2a): the activities and the muscles' forces, in N of MIMo's calibration."""
        flat = [part.swapaxes(1, 2).reshape(len(part), -1) for part in (self._activity, self._force)]
        return np.concatenate(flat, axis=1)

    def _torque(self, position: Floats, velocity: Floats) -> Floats:
        """(E, motors) in N m. Muscles pull: a positive force on a positive moment turns backwards."""
        length = position[..., None] * self._moment + self._reference
        speed = velocity[..., None] * self._moment
        active = force_length(length) * force_velocity(speed / self._v_max[:, None]) * self._activity
        self._force = (active + passive_force(length)) * self._f_max
        return -(self._moment * self._force).sum(axis=2)


def hand_over(model: mujoco.MjModel, actuators: Indices, joints: Indices) -> None:
    """Change a model for muscles, once: springs go, dampers weaken, motors pass any torque on.

    `joints` are the body's own, driven or not. Raises `MuscleError` for a model without the muscles'
    figures, and for an actuator that does not move a hinge with limits.
    """
    for actuator in actuators:
        joint = model.actuator_trnid[actuator, 0]
        hinge = plain_motor(model, actuator) and model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_HINGE
        if not hinge or not model.jnt_limited[joint]:
            name = model.actuator(actuator).name
            raise MuscleError(f"muscles need motors of hinges with limits, and {name!r} drives none")
    _calibrated(model, actuators)
    hinges = joints[model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_HINGE]
    model.actuator_gear[actuators, 0] = 1.0
    model.actuator_forcelimited[actuators] = 0
    model.actuator_ctrllimited[actuators] = 0
    model.jnt_stiffness[hinges] = 0.0
    model.dof_damping[model.jnt_dofadr[hinges]] *= DAMPING_SHARE


def force_length(length: Floats) -> Floats:
    """What an active muscle of a length (in optimal lengths) can hold, of its greatest force."""
    return _bump(length, L_MIN, 1.0, L_MAX) + 0.15 * _bump(length, L_MIN, (L_MIN + 0.95) / 2, 0.95)


def force_velocity(velocity: Floats) -> Floats:
    """What a muscle that shortens (< 0) or is stretched (> 0) at a share of VMAX can pull."""
    c = FV_MAX - 1
    stretched = np.where(velocity <= c, FV_MAX - (c - velocity) ** 2 / c, FV_MAX)
    shortening = np.where(velocity < -1, 0.0, (velocity + 1) ** 2)
    return np.where(velocity <= 0, shortening, stretched)


def passive_force(length: Floats) -> Floats:
    """The pull of a stretched muscle at rest."""
    b = (L_MAX + 1) / 2
    share = (length - 1) / (b - 1)
    beyond = 0.25 * FP_MAX * (1 + 3 * (length - b) / (b - 1))
    return np.where(length <= 1, 0.0, np.where(length <= b, 0.25 * FP_MAX * share**3, beyond))


def _bump(length: Floats, low: float, middle: float, high: float) -> Floats:
    """A smooth bump, 0 outside low..high and 1 at the middle, of four parabola pieces."""
    left, right = (low + middle) / 2, (middle + high) / 2
    rise = 0.5 * ((length - low) / (left - low)) ** 2
    up = 1 - 0.5 * ((middle - length) / (middle - left)) ** 2
    down = 1 - 0.5 * ((length - middle) / (right - middle)) ** 2
    fall = 0.5 * ((high - length) / (high - right)) ** 2
    inside = [length <= low, length >= high, length < left, length < middle, length < right]
    return np.select(inside, [np.zeros_like(length), np.zeros_like(length), rise, up, down], fall)


def _calibrated(model: mujoco.MjModel, actuators: Indices) -> tuple[NDArray[np.float64], Floats]:
    """VMAX (motors,), and FMAX (motors, 2): the muscle that turns backwards, then the other."""
    user = model.actuator_user
    if model.nuser_actuator < 3 or (user[actuators, :3] <= 0).any():
        raise MuscleError(
            "muscles need VMAX, FMAX- and FMAX+ of each motor as user data, all positive, and this model "
            'lacks them; use actuation = "motors" or add user="VMAX FMAX- FMAX+" to its actuators'
        )
    return user[actuators, 0].copy(), user[actuators, 1:3].copy()
