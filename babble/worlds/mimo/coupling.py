"""A soft mechanical coupling of two joints, as between the fingers of a hand (thesis 4.2)."""

from collections.abc import Sequence
from itertools import pairwise

import mujoco
import numpy as np

from babble.patterns import nearest


def couple(
    spec: mujoco.MjSpec, a: str, b: str, stiffness_n_m: float, damping: float = 0.0
) -> mujoco.MjsTendon:
    """A spring on the difference of how far two hinges are bent.

    With f = (angle - low) / (high - low) the fraction of a joint's range, the spring's energy is
    stiffness / 2 * (f_a - f_b)^2: it is at rest when both are bent alike. It is a fixed tendon of length
    q_a / range_a - q_b / range_b.

    stiffness_n_m: N m per unit of the fraction (squared, as energy); damping: N m s likewise.
    Raises ValueError for a joint that the model lacks or that has no range.
    """
    if not (np.isfinite(stiffness_n_m) and stiffness_n_m >= 0 and np.isfinite(damping) and damping >= 0):
        raise ValueError(
            f"the coupling of {a} and {b} needs a stiffness and a damping of at least 0,"
            f" got {stiffness_n_m} and {damping}"
        )
    (low_a, span_a), (low_b, span_b) = _range(spec, a), _range(spec, b)
    rest = low_a / span_a - low_b / span_b
    tendon = spec.add_tendon(name=f"coupling:{a}:{b}", springlength=(rest, rest))
    tendon.stiffness[0] = stiffness_n_m
    tendon.damping[0] = damping
    tendon.wrap_joint(a, 1 / span_a)
    tendon.wrap_joint(b, -1 / span_b)
    return tendon


def couple_neighbours(spec: mujoco.MjSpec, joints: Sequence[str], stiffness_n_m: float) -> None:
    """Couple each joint with the next one; nothing for a stiffness of 0."""
    if stiffness_n_m:
        for one, other in pairwise(joints):
            couple(spec, one, other, stiffness_n_m)


def _range(spec: mujoco.MjSpec, name: str) -> tuple[float, float]:
    """The lowest angle and the size of the range, in radians."""
    joint = spec.joint(name)
    if joint is None:
        known = nearest([joint.name for joint in spec.joints], name, "joint")
        raise ValueError(f"the model has no joint {name!r} to couple; {known}")
    low, high = np.radians(joint.range) if spec.compiler.degree else joint.range
    if not low < high:
        raise ValueError(f"joint {name!r} has no range of motion, so it cannot be coupled")
    return float(low), float(high - low)
