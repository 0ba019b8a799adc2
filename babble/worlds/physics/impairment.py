"""A body that can do less (thesis 1.1): restricted joints and weak muscles, by patterns over names."""

from collections.abc import Mapping

import mujoco
import numpy as np

from babble.patterns import matching
from babble.worlds.checks import check_number
from babble.worlds.physics.actuation import plain_motor
from babble.worlds.physics.names import names_of

LEAST_SHARE = 0.01


def restrict(model: mujoco.MjModel, mobility: Mapping[str, float]) -> None:
    """Leave each joint that a pattern matches only so great a share of its range, about its rest.

    The rest is where its spring pulls it, or the nearest limit. Raises ValueError for a share outside
    [0.01, 1] or a joint without limits, and `PatternError` for a pattern that matches no joint.
    """
    for pattern, share in mobility.items():
        check_number(f"mobility of {pattern!r}", share, least=LEAST_SHARE, most=1)
        joints = matching(names_of(model, "joint"), [pattern], "joint")
        if not model.jnt_limited[joints].all():
            raise ValueError(f"mobility of {pattern!r}: a joint without limits has no range to restrict")
        low, high = model.jnt_range[joints].T
        rest = np.clip(model.qpos_spring[model.jnt_qposadr[joints]], low, high)
        model.jnt_range[joints] = np.stack(
            [rest + share * (low - rest), rest + share * (high - rest)], axis=1
        )


def weaken(model: mujoco.MjModel, strength: Mapping[str, float]) -> None:
    """Leave each actuator that a pattern matches only so great a share of its force.

    Raises ValueError for a share outside [0.01, 1] and `PatternError` for a pattern that matches none.
    """
    for pattern, share in strength.items():
        check_number(f"strength of {pattern!r}", share, least=LEAST_SHARE, most=1)
        actuators = matching(names_of(model, "actuator"), [pattern], "actuator")
        for actuator in actuators:
            if plain_motor(model, actuator):
                model.actuator_gear[actuator] *= share
            else:
                # The gear of a servo is also its scale of length: a weak servo aims at the same place.
                model.actuator_gainprm[actuator] *= share
                model.actuator_biasprm[actuator] *= share
                model.actuator_forcerange[actuator] *= share
        if model.nuser_actuator >= 3:
            model.actuator_user[actuators, 1:3] *= share
