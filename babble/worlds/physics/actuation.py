"""From an action in [-1, 1] to forces in the simulation: motors as the model has them, or muscles."""

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Actions = NDArray[np.float32] | Floats
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Copies = Sequence[mujoco.MjData]


class Actuation(Protocol):
    """How actions (E, a) in [-1, 1] move E copies of a model."""

    @property
    def size(self) -> int:
        """a, the length of an action."""
        ...

    @property
    def actuators(self) -> Indices:
        """(a,) the model's actuator that each component of an action drives."""
        ...

    def begin(self, columns: Flags) -> None:
        """Forget the past of the flagged copies (E,), which start anew."""
        ...

    def advance(self, copies: Copies, action: Actions, physics_steps: int) -> None:
        """Do so many physics steps of each copy under the action (E, a), clipped to [-1, 1]."""
        ...

    def efforts(self) -> Floats:
        """(E, 2a) what the last action asked for and the torque or force that came of it."""
        ...


def balance(model: mujoco.MjModel, actuators: Indices) -> None:
    """Never ask a motor for more than its weaker direction can give, so that both are equally strong.

    Narrows the control ranges of motors whose force is limited differently in the two directions.
    Raises ValueError for an actuator that is no plain motor.
    """
    for actuator in actuators:
        if not plain_motor(model, actuator):
            name = model.actuator(actuator).name
            raise ValueError(f"balanced needs motors, and actuator {name!r} is none; leave balanced out")
        low, high = model.actuator_forcerange[actuator]
        if not model.actuator_forcelimited[actuator] or not low < 0 < high or low == -high:
            continue
        weaker = min(-low, high)
        if model.actuator_ctrllimited[actuator]:
            weaker = min(weaker, *np.abs(model.actuator_ctrlrange[actuator]))
        model.actuator_ctrlrange[actuator] = -weaker, weaker
        model.actuator_ctrllimited[actuator] = 1


def plain_motor(model: mujoco.MjModel, actuator: int) -> bool:
    """Whether an actuator's force is its control: MuJoCo's `motor`, at a joint."""
    return bool(
        model.actuator_trntype[actuator] == mujoco.mjtTrn.mjTRN_JOINT
        and model.actuator_dyntype[actuator] == mujoco.mjtDyn.mjDYN_NONE
        and model.actuator_gaintype[actuator] == mujoco.mjtGain.mjGAIN_FIXED
        and model.actuator_gainprm[actuator, 0] == 1
        and model.actuator_biastype[actuator] == mujoco.mjtBias.mjBIAS_NONE
    )


class Motors:
    """Each component drives one actuator over its control range: -1 its lower end, 1 its upper.

    For MIMo these are torque motors with a range of [-1, 1], whose weaker direction MuJoCo limits
    (spring-damper actuation: springs and dampers belong to the joints). An actuator without a control
    range takes the component as it is.
    """

    def __init__(self, model: mujoco.MjModel, actuators: Indices, columns: int) -> None:
        self.size = len(actuators)
        self.actuators = actuators
        self._model = model
        limited = model.actuator_ctrllimited[actuators].astype(bool)
        low, high = model.actuator_ctrlrange[actuators].T
        self._centre = np.where(limited, (low + high) / 2, 0.0)
        self._half = np.where(limited, (high - low) / 2, 1.0)
        self._as_it_is = bool((self._centre == 0).all() and (self._half == 1).all() and limited.all())
        self._all = self.size == model.nu
        self._asked: Actions = np.zeros((columns, self.size))
        self._copies: Copies = ()

    def begin(self, columns: Flags) -> None:
        """The flagged copies have asked for nothing yet."""
        self._asked = np.where(columns[:, None], 0.0, self._asked)

    def advance(self, copies: Copies, action: Actions, physics_steps: int) -> None:
        """Set the controls, once, and step; MuJoCo itself keeps controls within their ranges."""
        self._asked, self._copies = action, copies
        controls = action if self._as_it_is else self._centre + self._half * np.clip(action, -1, 1)
        for data, control in zip(copies, controls, strict=True):
            if self._all:
                data.ctrl[:] = control
            else:
                data.ctrl[self.actuators] = control
            mujoco.mj_step(self._model, data, physics_steps)

    def efforts(self) -> Floats:
        """(E, 2a): the action, and each actuator's force times its gear, N m for a hinge."""
        asked = np.clip(self._asked, -1, 1)
        if not self._copies:
            return np.concatenate([asked, np.zeros_like(asked)], axis=1)
        gear = self._model.actuator_gear[self.actuators, 0]
        force = np.array([data.actuator_force for data in self._copies])[:, self.actuators] * gear
        return np.concatenate([asked, force], axis=1)
