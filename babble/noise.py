"""Action noise for babbling: one step of all columns at a time, seeded, with a stationary deviation.

Every kind starts in its stationary distribution, so `scale` is the standard deviation from the first
step on. Nothing is clipped here; the world clips actions to their bounds.

| kind | one component over time | its own settings |
|---|---|---|
| white | independent draws | |
| pink | 1/f from step to step without blocks, flat below one cycle in 4,096 steps | |
| ou | u <- correlation * u + fresh: flat, and 1/f^2 above its corner | `correlation` |
| held | a draw kept for `hold_steps` steps | `hold_steps` |
| coloured | 1/f^beta, in blocks of `block_steps`; see `Coloured` | `exponents`, `block_steps` |

The noises of thesis 4.5: C5 white, scale 1; C6 pink, coloured with exponents (1.0, 1.0); C7 baby, coloured
with (0.7, 0.9); C8 Ornstein-Uhlenbeck, du = -theta u dt + sigma dW with theta .15, sigma .2 and dt 1, which
is ou with correlation 1 - theta = 0.85 and scale sigma / sqrt(1 - 0.85^2) = 0.3797. The thesis gives no
numbers for them. Those of baby noise (beta from 0.7 to 0.9 over the training, blocks of 10,000 steps shaped
by FFT) are of Lopez, Ernst, Cruz, Hoffmann and Triesch, "Infant Spontaneous Movement Noise Improves
Exploration in Deep RL" (arXiv 2606.16590), known to us from a secondary summary only; those of OU noise are
the ones with which the thesis's participation ratio is met best.
"""

from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Kind = Literal["white", "pink", "ou", "held", "coloured"]

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
    exponents: tuple[float, float] = (0.7, 0.9),
    block_steps: int = 10_000,
) -> Noise:
    """Noise of standard deviation `scale`; the table above says which kind uses which other setting.

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
        case "coloured":
            return Coloured(exponents, block_steps, scale, shape, rng)
        case _:
            raise ValueError(f"there is no noise {kind!r}; the kinds are white, pink, ou, held, coloured")


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


class Coloured:
    """Gaussian noise with the power spectrum 1/f^beta, made in blocks by shaping white noise (FFT).

    A block is `block_steps` steps of one column: independent complex normal numbers at the frequencies
    k / block_steps, k >= 1, with amplitude k^(-beta/2), scaled to the variance `scale`^2 in expectation.
    Frequency 0, at which 1/f^beta has no value, gets none, so each block sums to 0: what is slower than a
    block is not in the noise. When a column has used its block up it draws another, independent one, and
    its values jump. The columns begin at random places of their first blocks: were they to begin together,
    all would jump, and all would have to be drawn, in the same step.

    beta goes linearly from the first exponent to the last with `progress`; a block has that of the moment at
    which it is drawn, the first ones that of the first `sample`. Holds columns x size x block_steps float32.
    """

    def __init__(
        self,
        exponents: tuple[float, float],
        block_steps: int,
        scale: float,
        shape: tuple[int, int],
        rng: np.random.Generator,
    ) -> None:
        """Raises ValueError for exponents that are no numbers from 0 on, or a block of fewer than 2 steps."""
        if block_steps < 2 or not all(0 <= beta < np.inf for beta in exponents):
            raise ValueError(
                "coloured noise needs two exponents from 0 on and block_steps >= 2, "
                f"got {tuple(exponents)} and {block_steps}"
            )
        self._exponents = exponents
        self._scale = scale
        self._rng = rng
        self._progress = 0.0
        self._blocks = np.empty((shape[0], block_steps, shape[1]), np.float32)
        self._columns = np.arange(shape[0])
        self._next = np.full(shape[0], block_steps)
        self._begin = rng.integers(0, block_steps, shape[0])
        """where each column begins in its next block"""

    @property
    def progress(self) -> float:
        """The share of the phase that is over, set by whoever knows. Raises ValueError outside [0, 1]."""
        return self._progress

    @progress.setter
    def progress(self, share: float) -> None:
        if not 0 <= share <= 1:
            raise ValueError(f"the progress of a phase lies in [0, 1], got {share}")
        self._progress = share

    @property
    def beta(self) -> float:
        """The exponent of a block that is drawn now."""
        first, last = self._exponents
        return first + self._progress * (last - first)

    def sample(self) -> Floats:
        """The next (columns, size) values."""
        for column in np.flatnonzero(self._next == self._blocks.shape[1]):
            self._blocks[column] = self._block().T
            self._next[column], self._begin[column] = self._begin[column], 0
        now = self._blocks[self._columns, self._next]
        self._next += 1
        return now

    def _block(self) -> Floats:
        """(size, block_steps) values."""
        _, block_steps, size = self._blocks.shape
        amplitude = _amplitudes(self.beta, block_steps)
        white = self._rng.standard_normal((size, len(amplitude), 2), dtype=np.float32)
        spectrum = np.zeros((size, len(amplitude) + 1), np.complex64)
        spectrum[:, 1:] = white.view(np.complex64)[..., 0] * (self._scale * amplitude).astype(np.float32)
        return np.asarray(np.fft.irfft(spectrum, block_steps, axis=1), np.float32)


def _amplitudes(beta: float, steps: int) -> NDArray[np.float64]:
    """Of the frequencies k / steps, k >= 1, so that what NumPy's irfft makes has the variance 1."""
    amplitude = np.arange(1, steps // 2 + 1) ** (-beta / 2)
    share = np.full(len(amplitude), 4.0)
    if steps % 2 == 0:
        # The highest frequency has no imaginary part and stands for itself alone.
        amplitude[-1] *= np.sqrt(2)
        share[-1] = 1.0
    return np.asarray(amplitude * steps / np.sqrt((share * amplitude**2).sum()))
