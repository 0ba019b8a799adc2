"""Action noise for babbling: one step of all columns at a time, seeded, with a stationary deviation.

Every kind starts in its stationary distribution, so `scale` is the standard deviation from the first
step on. Nothing is clipped here; the world clips actions to their bounds.
"""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Kind = Literal["white", "pink", "ou", "held"]

PINK_OCTAVES = 12
"""Pink noise is 1/f down to about one cycle in 2**PINK_OCTAVES steps, and flat below."""


class Noise(Protocol):
    """A source of actions."""

    def sample(self) -> Floats:
        """The next (columns, size) values."""
        ...


def make_noise(
    kind: Kind,
    *,
    scale: float,
    columns: int,
    size: int,
    rng: np.random.Generator,
    correlation: float = 0.9,
    hold_steps: int = 10,
) -> Noise:
    """Noise of standard deviation `scale`; `correlation` is used by "ou" and `hold_steps` by "held".

    Raises ValueError for an unknown kind or a parameter out of range.
    """
    if scale <= 0 or columns < 1 or size < 1:
        raise ValueError(
            f"noise needs scale > 0, columns >= 1 and size >= 1, got {scale}, {columns} and {size}"
        )
    shape = (columns, size)
    match kind:
        case "white":
            return _Sum(np.array([0.0]), scale, shape, rng)
        case "pink":
            # Octave-spaced first-order processes of equal variance add up to a 1/f spectrum.
            return _Sum(np.exp(-(2.0 ** (1 - np.arange(PINK_OCTAVES)))), scale, shape, rng)
        case "ou":
            if not 0 <= correlation < 1:
                raise ValueError(f"the correlation of OU noise must lie in [0, 1), got {correlation}")
            return _Sum(np.array([correlation]), scale, shape, rng)
        case "held":
            if hold_steps < 1:
                raise ValueError(f"held noise needs hold_steps >= 1, got {hold_steps}")
            return _Held(hold_steps, scale, shape, rng)
        case _:
            raise ValueError(f"there is no noise {kind!r}; the kinds are white, pink, ou, held")


class _Sum:
    """A sum of K processes u <- c u + sqrt(1 - c^2) N(0, s^2) with correlations c and equal variance."""

    def __init__(
        self,
        correlations: NDArray[np.float64],
        scale: float,
        shape: tuple[int, int],
        rng: np.random.Generator,
    ) -> None:
        part = scale / np.sqrt(len(correlations))
        self._rng = rng
        self._keep = correlations.reshape(-1, 1, 1)
        self._fresh = part * np.sqrt(1 - self._keep**2)
        self._state = part * rng.standard_normal((len(correlations), *shape))

    def sample(self) -> Floats:
        now = self._state.sum(axis=0).astype(np.float32)
        self._state = self._keep * self._state + self._fresh * self._rng.standard_normal(self._state.shape)
        return now


class _Held:
    """A normal draw kept for `hold_steps` steps; the columns change at different times."""

    def __init__(
        self, hold_steps: int, scale: float, shape: tuple[int, int], rng: np.random.Generator
    ) -> None:
        self._rng = rng
        self._scale = scale
        self._hold_steps = hold_steps
        self._left = rng.integers(1, hold_steps + 1, shape[0])
        self._value = scale * rng.standard_normal(shape)

    def sample(self) -> Floats:
        now = self._value.astype(np.float32)
        self._left -= 1
        due = self._left == 0
        self._left[due] = self._hold_steps
        self._value[due] = self._scale * self._rng.standard_normal((int(due.sum()), self._value.shape[1]))
        return now
