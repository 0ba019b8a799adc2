"""Proprioception: the angles and speeds of joints, their limits, torques, and what the muscles do.

The parts are separate senses, so that an encoder can weigh angles (rad) and speeds (rad/s) alike.
"""

from collections.abc import Sequence
from typing import Literal

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.physics.actuation import Actuation
from babble.worlds.physics.names import labels
from babble.worlds.senses.sense import Copies, Floats

Indices = NDArray[np.intp]
Unit = Literal["range", "radians"]
LIMIT_MARGIN_RAD = 0.035
"""So near its limit (2 degrees) a joint begins to feel it, as in MIMo."""


class Position:
    """Joint positions: shares of the range from -1 to 1 ("range"), or radians (metres for a slide)."""

    name = "position"

    def __init__(self, model: mujoco.MjModel, joints: Indices, unit: Unit = "range") -> None:
        if unit not in ("range", "radians"):
            raise ValueError(f'the unit of positions is "range" or "radians", got {unit!r}')
        self.shape = (len(joints),)
        self.components = labels(model, "joint", joints)
        self._qpos = compact(model.jnt_qposadr[joints])
        self._scaling = centre_and_half_range(model, joints) if unit == "range" else None

    def read(self, copies: Copies) -> Floats:
        """(E, joints)"""
        position = np.empty((len(copies), *self.shape), np.float32)
        for row, data in zip(position, copies, strict=True):
            row[:] = data.qpos[self._qpos]
        if self._scaling is None:
            return position
        centre, half = self._scaling
        return ((position - centre) / half).astype(np.float32)


class Velocity:
    """Joint velocities in rad/s (m/s for a slide)."""

    name = "velocity"

    def __init__(self, model: mujoco.MjModel, joints: Indices) -> None:
        self.shape = (len(joints),)
        self.components = labels(model, "joint", joints)
        self._dof = compact(model.jnt_dofadr[joints])

    def read(self, copies: Copies) -> Floats:
        """(E, joints)"""
        velocity = np.empty((len(copies), *self.shape), np.float32)
        for row, data in zip(velocity, copies, strict=True):
            row[:] = data.qvel[self._dof]
        return velocity


class Limits:
    """How hard each joint is at a limit: 0 inside, 1 at the limit, more beyond; MIMo's rule."""

    name = "limits"

    def __init__(self, model: mujoco.MjModel, joints: Indices) -> None:
        self.shape = (len(joints),)
        self.components = labels(model, "joint", joints)
        self._qpos = compact(model.jnt_qposadr[joints])
        low, high = model.jnt_range[joints].T
        limited = model.jnt_limited[joints].astype(bool)
        self._low, self._high = np.where(limited, low, -np.inf), np.where(limited, high, np.inf)

    def read(self, copies: Copies) -> Floats:
        """(E, joints)"""
        position = np.array([data.qpos[self._qpos] for data in copies])
        room = np.minimum(position - self._low, self._high - position)
        return np.maximum(1 - room / LIMIT_MARGIN_RAD, 0).astype(np.float32)


class Actuated:
    """What each actuator was asked for and what came of it; see `Actuation.efforts`."""

    name = "actuation"

    def __init__(self, model: mujoco.MjModel, actuation: Actuation) -> None:
        self.shape = (2 * actuation.size,)
        self.components = 2 * labels(model, "actuator", actuation.actuators)
        self._actuation = actuation

    def read(self, copies: Copies) -> Floats:
        """(E, 2a); the copies must be those that the actuation moves."""
        return self._actuation.efforts().astype(np.float32)


class Sensors:
    """Sensors of the model: torques at the joints (N m), accelerations, or whatever a model defines."""

    def __init__(
        self, model: mujoco.MjModel, sensors: Sequence[int] | Indices, name: str = "sensors"
    ) -> None:
        self.name = name
        starts, sizes = model.sensor_adr[sensors], model.sensor_dim[sensors]
        values = np.concatenate(
            [np.arange(start, start + size) for start, size in zip(starts, sizes, strict=True)]
        )
        self.shape = (len(values),)
        self.components = tuple(np.repeat(labels(model, "sensor", sensors), sizes).tolist())
        self._values = compact(values)

    def read(self, copies: Copies) -> Floats:
        """(E, values), in the units of MuJoCo's sensors"""
        sensed = np.empty((len(copies), *self.shape), np.float32)
        for row, data in zip(sensed, copies, strict=True):
            row[:] = data.sensordata[self._values]
        return sensed


def compact(indices: Indices) -> Indices | slice:
    """The same places as a slice where they follow one another: reading by a slice is much cheaper."""
    start = int(indices[0])
    consecutive = np.array_equal(indices, np.arange(start, start + len(indices)))
    return slice(start, start + len(indices)) if consecutive else indices


def centre_and_half_range(
    model: mujoco.MjModel, joints: Indices
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The middle and half of each joint's range; 0 and pi for a joint without limits."""
    limited = model.jnt_limited[joints].astype(bool)
    low, high = model.jnt_range[joints].T
    return np.where(limited, (low + high) / 2, 0.0), np.where(limited, (high - low) / 2, np.pi)
