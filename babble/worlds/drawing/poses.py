"""Putting what is fixed to bodies where the bodies are; quaternions have w first, as in MuJoCo."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Numbers = NDArray[Any]
"""Of any type of float."""


def turned(quaternion: Numbers, vector: Numbers) -> Array:
    """(n, 3) the vectors (n, 3), each turned by its unit quaternion (n, 4)."""
    w, axis = quaternion[:, :1], quaternion[:, 1:]
    across = 2 * np.cross(axis, vector)
    return np.asarray(vector + w * across + np.cross(axis, across))


def combined(first: Numbers, second: Numbers) -> Array:
    """(n, 4) the rotations that `second` (n, 4) is in the frames that `first` (n, 4) turned."""
    w, axis = first[:, :1], first[:, 1:]
    other_w, other_axis = second[:, :1], second[:, 1:]
    real = w * other_w - (axis * other_axis).sum(axis=1, keepdims=True)
    return np.concatenate([real, w * other_axis + other_w * axis + np.cross(axis, other_axis)], axis=1)
