"""The senses of a body, chosen by name."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

import mujoco
import numpy as np

from babble.patterns import matching
from babble.worlds.checks import check_table, check_texts, shown
from babble.worlds.physics.actuation import Actuation, Indices
from babble.worlds.physics.names import names_of
from babble.worlds.senses.eyesight import Eyesight
from babble.worlds.senses.joints import Actuated, Limits, Position, Sensors, Unit, Velocity
from babble.worlds.senses.sense import Sense
from babble.worlds.senses.touch import Touch
from babble.worlds.senses.vision import Vision

SENSES = (
    "position",
    "velocity",
    "limits",
    "torque",
    "actuation",
    "vestibular",
    "sensors",
    "touch",
    "vision",
)
_OF_TYPE = {
    "torque": ("torque sensor", (mujoco.mjtSensor.mjSENS_TORQUE,)),
    "vestibular": (
        "accelerometer and gyroscope",
        (mujoco.mjtSensor.mjSENS_ACCELEROMETER, mujoco.mjtSensor.mjSENS_GYRO),
    ),
}
TOUCH_OPTIONS = ("bodies", "resolution", "components")
VISION_OPTIONS = ("cameras", "resolution", "shadows", *(given.name for given in fields(Eyesight)))


def make_senses(
    model: mujoco.MjModel,
    names: Sequence[str],
    actuation: Actuation,
    rng: np.random.Generator | None = None,
    *,
    joints: Indices,
    angles: Unit = "range",
    sensors: Sequence[str] = (),
    touch: Mapping[str, Any] | None = None,
    vision: Mapping[str, Any] | None = None,
) -> list[Sense]:
    """The named senses, in the given order.

    `joints` are those felt by position, velocity and limits; `sensors` are patterns for the sense of
    that name; `touch` and `vision` are options of `Touch` and `Vision`, `rng` is for the noise of
    eyes. Raises ValueError, in one sentence, for an unknown name or option and for a sense that the
    model lacks.
    """
    made: list[Sense] = []
    for name in names:
        match name:
            case "position":
                made.append(Position(model, joints, angles))
            case "velocity":
                made.append(Velocity(model, joints))
            case "limits":
                made.append(Limits(model, joints))
            case "actuation":
                made.append(Actuated(model, actuation))
            case "sensors":
                made.append(Sensors(model, matching(names_of(model, "sensor"), sensors, "sensor")))
            case "touch":
                made.append(Touch(model, **_known("touch", touch, TOUCH_OPTIONS)))
            case "vision":
                made.append(Vision(model, **_known("vision", vision, VISION_OPTIONS), rng=rng))
            case _:
                made.append(_of_type(model, name))
    return made


def check_names(names: Sequence[str]) -> None:
    """Raises ValueError unless `names` is a list of distinct names of `SENSES`."""
    check_texts("senses", names)
    if not names or len(set(names)) != len(names):
        raise ValueError(
            f"senses must be a list of distinct names out of {', '.join(SENSES)}; got {shown(names)}"
        )
    if unknown := [name for name in names if name not in SENSES]:
        raise ValueError(f"there is no sense {unknown[0]!r}; the senses are {', '.join(SENSES)}")


def _known(name: str, options: Mapping[str, Any] | None, known: Sequence[str]) -> Mapping[str, Any]:
    given = options or {}
    check_table(name, given, known)
    return given


def _of_type(model: mujoco.MjModel, name: str) -> Sense:
    what, kinds = _OF_TYPE[name]
    found = np.flatnonzero(np.isin(model.sensor_type, [int(kind) for kind in kinds]))
    if not found.size:
        raise ValueError(f"the model has no {what}, which the sense {name!r} reads; leave it out of senses")
    return Sensors(model, found, name)
