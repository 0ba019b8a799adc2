"""Worse senses on purpose (thesis 1.1): less sensitive, noisy, late, or partly gone.

What is degraded is what the brain gets; the physics is untouched. Blurred and dimmed eyes are in
babble.worlds.senses.eyesight, restricted joints in babble.worlds.physics.impairment.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from babble.worlds.checks import check_count, check_number

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
MAX_DELAY_STEPS = 100
MOST = 1e6


@dataclass(frozen=True, kw_only=True)
class Degradation:
    """How one sense is degraded, in this order."""

    threshold: float = 0.0
    """values smaller than this in size are not felt (they become 0)"""
    gain: float = 1.0
    """what is felt is so many times as strong; under 1 is reduced sensitivity"""
    lost_share: float = 0.0
    """this share of the components is dead for the whole run, the same for all copies"""
    noise_std: float = 0.0
    """standard deviation of Gaussian noise added to each component at each step"""
    delay_steps: int = 0
    """everything comes so many environment steps late"""

    def __post_init__(self) -> None:
        for name in ("threshold", "gain", "noise_std"):
            check_number(f"degradation: {name}", getattr(self, name), least=0, most=MOST)
        check_number("degradation: lost_share", self.lost_share, least=0, most=0.99)
        check_count("degradation: delay_steps", self.delay_steps, least=0, most=MAX_DELAY_STEPS)


class Degraded:
    """Applies a `Degradation` to what E copies sense, each with its own past."""

    def __init__(
        self, how: Degradation, shape: tuple[int, ...], columns: int, rng: np.random.Generator
    ) -> None:
        self._how = how
        self._rng = rng
        self._image = len(shape) > 1
        self._alive: Flags = np.random.default_rng(0).random(shape) >= how.lost_share
        self._late = np.zeros((how.delay_steps + 1, columns, *shape), np.float32)
        self._now = 0

    def once(self, value: Floats) -> Floats:
        """(E, *shape) degraded, but not late: for observations outside the course of time."""
        how = self._how
        felt = np.where(np.abs(value) < how.threshold, 0, value) * (how.gain * self._alive)
        if how.noise_std:
            felt = felt + self._rng.normal(0, how.noise_std, felt.shape)
        return (np.clip(np.rint(felt), 0, 255) if self._image else felt).astype(np.float32)

    def begin(self, value: Floats, columns: Flags) -> Floats:
        """What the copies sense where the flagged ones (E,) begin: their past is as their present.

        The others keep what they last sensed.
        """
        self._late[:, columns] = self.once(value)[columns]
        return self._late[(self._now + 1) % len(self._late)]

    def next(self, value: Floats) -> Floats:
        """(E, *shape) what is sensed after one more step."""
        self._now = (self._now + 1) % len(self._late)
        self._late[self._now] = self.once(value)
        return self._late[(self._now + 1) % len(self._late)]
