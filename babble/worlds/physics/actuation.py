"""From an action in [-1, 1] to forces in the simulation: motors as the model has them, or muscles."""

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Indices = NDArray[np.intp]
Copies = Sequence[mujoco.MjData]


class Actuation(Protocol):
    """How actions (E, a) in [-1, 1] move E copies of a model."""

    @property
    def size(self) -> int:
        """a, the length of an action."""
        ...

    def begin(self, columns: Flags) -> None:
        """Forget the past of the flagged copies (E,), which start anew."""
        ...

    def advance(self, copies: Copies, action: Floats, physics_steps: int) -> None:
        """Do so many physics steps of each copy under the action (E, a)."""
        ...

    def efforts(self) -> Floats:
        """(E, 2a) what the last action asked for and the torque or force that came of it."""
        ...


def balance(model: mujoco.MjModel, actuators: Indices) -> None:
    """Never ask a motor for more than its weaker direction can give, so that both are equally strong.

    Changes the control ranges of motors whose force is limited differently in the two directions.
    """
    low, high = model.actuator_forcerange[actuators].T
    lopsided = model.actuator_forcelimited[actuators].astype(bool) & (low < 0) & (high > 0) & (low != -high)
    weaker = np.minimum(-low, high)[lopsided]
    model.actuator_ctrlrange[actuators[lopsided]] = np.stack([-weaker, weaker], axis=1)
    model.actuator_ctrllimited[actuators[lopsided]] = 1


class Motors:
    """Each component drives one actuator over its control range: -1 its lower end, 1 its upper.

    For MIMo these are torque motors with a range of [-1, 1], whose weaker direction MuJoCo limits
    (spring-damper actuation: springs and dampers belong to the joints). An actuator without a control
    range takes the component as it is.
    """

    def __init__(self, model: mujoco.MjModel, actuators: Indices, columns: int) -> None:
        self.size = len(actuators)
        self._model = model
        self._actuators = actuators
        limited = model.actuator_ctrllimited[actuators].astype(bool)
        low, high = model.actuator_ctrlrange[actuators].T
        self._centre = np.where(limited, (low + high) / 2, 0.0)
        self._half = np.where(limited, (high - low) / 2, 1.0)
        self._as_it_is = bool((self._centre == 0).all() and (self._half == 1).all())
        self._all = self.size == model.nu
        self._asked = np.zeros((columns, self.size))
        self._copies: Copies = ()

    def begin(self, columns: Flags) -> None:
        """The flagged copies have asked for nothing yet."""
        self._asked[columns] = 0.0

    def advance(self, copies: Copies, action: Floats, physics_steps: int) -> None:
        """Set the controls, once, and step."""
        self._asked, self._copies = action, copies
        controls = action if self._as_it_is else self._centre + self._half * action
        for data, control in zip(copies, controls, strict=True):
            if self._all:
                data.ctrl[:] = control
            else:
                data.ctrl[self._actuators] = control
            mujoco.mj_step(self._model, data, physics_steps)

    def efforts(self) -> Floats:
        """(E, 2a): the action, and each actuator's force times its gear, N m for a hinge."""
        if not self._copies:
            return np.concatenate([self._asked, np.zeros_like(self._asked)], axis=1)
        gear = self._model.actuator_gear[self._actuators, 0]
        force = np.array([data.actuator_force for data in self._copies])[:, self._actuators] * gear
        return np.concatenate([self._asked, force], axis=1)
