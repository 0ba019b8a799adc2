"""Landmarks: postures that have a name, such as the open and the closed hand (thesis 4.2, 4.3)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Landmark:
    """A posture is at the landmark when each group's mean lies between `low` and `high`.

    A group is a set of components of the posture, such as the joints of one finger.
    """

    name: str
    groups: tuple[tuple[int, ...], ...]
    low: float
    high: float

    def at(self, posture: NDArray[np.floating]) -> NDArray[np.bool_]:
        """(..., p) -> (...): which postures are at the landmark."""
        means = np.stack([posture[..., list(group)].mean(axis=-1) for group in self.groups], axis=-1)
        return np.asarray(((means >= self.low) & (means <= self.high)).all(axis=-1))
