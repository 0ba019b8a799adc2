"""A body that can do less (thesis 1.1): restricted joints and weak muscles, by patterns over names."""

from collections.abc import Mapping

import mujoco
import numpy as np

from babble.worlds.physics.patterns import matching, names_of


def restrict(model: mujoco.MjModel, mobility: Mapping[str, float]) -> None:
    """Leave each joint that a pattern matches only so great a share of its range, about its rest.

    The rest is where its spring pulls it, or the nearest limit. Raises ValueError for a share outside
    (0, 1] and `PatternError` for a pattern that matches no joint.
    """
    for pattern, share in mobility.items():
        _check_share("mobility", pattern, share)
        joints = matching(names_of(model, "joint"), [pattern], "joint")
        low, high = model.jnt_range[joints].T
        rest = np.clip(model.qpos_spring[model.jnt_qposadr[joints]], low, high)
        model.jnt_range[joints] = np.stack(
            [rest + share * (low - rest), rest + share * (high - rest)], axis=1
        )


def weaken(model: mujoco.MjModel, strength: Mapping[str, float]) -> None:
    """Leave each actuator that a pattern matches only so great a share of its force.

    Raises ValueError for a share outside (0, 1] and `PatternError` for a pattern that matches none.
    """
    for pattern, share in strength.items():
        _check_share("strength", pattern, share)
        actuators = matching(names_of(model, "actuator"), [pattern], "actuator")
        model.actuator_gear[actuators] *= share
        if model.nuser_actuator >= 3:
            model.actuator_user[actuators, 1:3] *= share


def _check_share(what: str, pattern: str, share: object) -> None:
    number = isinstance(share, int | float) and not isinstance(share, bool)
    if not number or not 0 < share <= 1:  # type: ignore[operator]
        raise ValueError(f"{what} of {pattern!r} must be a share in (0, 1], got {share!r}")
