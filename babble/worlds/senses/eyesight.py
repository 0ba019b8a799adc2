"""How well eyes see: blurred, dim, pale, noisily or not at all, each eye by itself (thesis 1.1).

Fewer pixels are the resolution of babble.worlds.senses.vision; late or missing images are the
delay of babble.worlds.senses.degradation.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields
from numbers import Real

import numpy as np
from numpy.typing import NDArray

from babble.worlds.checks import check_texts

Floats = NDArray[np.float32]
Images = NDArray[np.uint8] | Floats
PerEye = float | Sequence[float]
"""One number for all eyes, or one for each in the order of the images."""

REACH_SIGMAS = 4.0
SIGMA_CYCLES = 1 / (2 * math.sqrt(2 * math.log(2)))
NEGLIGIBLE_PX = 0.1
BRIGHTEST = 255.0
MOST = 10_000.0


@dataclass(frozen=True, kw_only=True)
class Eyesight:
    """How eyes see; applied in this order. The defaults change nothing.

    Raises ValueError for a value out of its range.
    """

    acuity_cpd: PerEye = math.inf
    """the finest grating that can be seen, in cycles per degree: 0.7 in newborns (Brown & Yamamoto 1986)"""
    blur_sigma_px: PerEye = 0.0
    """standard deviation of a Gaussian blur, in pixels; adds to that of the acuity"""
    brightness: PerEye = 1.0
    """all light is so many times as strong; what exceeds white is white"""
    contrast: PerEye = 1.0
    """differences from the image's mean colour are so many times as large; 0 is a grey fog"""
    noise_std: PerEye = 0.0
    """standard deviation of Gaussian noise on every value, in steps of 0..255"""
    closed_eyes: Sequence[str] = ()
    """patterns over the names of the eyes that are closed: they see black, without noise"""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            if field.name == "closed_eyes":
                check_texts("eyesight: closed_eyes", value)
                continue
            if not all(_fits(field.name, number) for number in _listed(value)) or not _listed(value):
                bounds = "above 0" if field.name == "acuity_cpd" else f"from 0 to {MOST:.0f}"
                raise ValueError(
                    f"eyesight: {field.name} must be a number {bounds}, or a list with one for each eye,"
                    f" got {value!r}"
                )


class Sight:
    """Applies an `Eyesight` to the images of a body's eyes."""

    def __init__(
        self,
        how: Eyesight,
        *,
        is_open: Sequence[bool],
        height: int,
        width: int,
        fovy_deg: Sequence[float],
        rng: np.random.Generator,
    ) -> None:
        """`is_open` and `fovy_deg`, the vertical field of view, have one entry for each eye.

        Raises ValueError for a list whose length is not the number of eyes.
        """
        eyes = len(is_open)
        acuity = _per_eye(how, "acuity_cpd", eyes)
        blur = _per_eye(how, "blur_sigma_px", eyes)
        sigmas_px = [
            math.hypot(blur[eye], acuity_sigma_px(acuity[eye], fovy_deg[eye], height)) for eye in range(eyes)
        ]
        self._blurs = {
            eye: (blur_matrix(height, sigma_px), blur_matrix(width, sigma_px))
            for eye, sigma_px in enumerate(sigmas_px)
            if sigma_px > NEGLIGIBLE_PX and is_open[eye]
        }
        self._brightness = _column(_per_eye(how, "brightness", eyes))
        self._contrast = _column(_per_eye(how, "contrast", eyes))
        self._noise_std = _column(_per_eye(how, "noise_std", eyes))
        self._is_open = _column(is_open)
        self._rng = rng

    def __call__(self, images: Images) -> Floats:
        """(E, eyes, H, W, 3) of 0..255 as these eyes see them: whole numbers 0..255 as float32."""
        seen = images.astype(np.float32)
        for eye, (down, across) in self._blurs.items():
            seen[:, eye] = _blurred(seen[:, eye], down, across)
        if (self._brightness != 1).any():
            seen *= self._brightness
        if (self._contrast != 1).any():
            fog = (1 - self._contrast) * seen.mean(axis=(2, 3), keepdims=True)
            seen *= self._contrast
            seen += fog
        if self._noise_std.any():
            seen += self._noise_std * self._rng.standard_normal(seen.shape, dtype=np.float32)
        seen *= self._is_open
        return np.clip(np.rint(seen, out=seen), 0, BRIGHTEST, out=seen)


def acuity_sigma_px(acuity_cpd: float, fovy_deg: float, height_px: int) -> float:
    """The Gaussian blur, in pixels of the image's centre, that leaves an acuity in cycles per degree.

    One cycle of the finest grating is the blur's full width at half its height; of that grating's
    contrast exp(-pi^2 / (4 ln 2)) = 2.8 % are left, as in Caves & Johnsen 2018 (AcuityView).
    """
    radius_px = height_px / 2 / math.tan(math.radians(fovy_deg / 2))
    return SIGMA_CYCLES / acuity_cpd * radius_px * math.radians(1)


def blur_matrix(length_px: int, sigma_px: float) -> Floats:
    """(n, n) that blurs a line of n pixels; light that would leave at an end is mirrored back in.

    Rows and columns sum to 1: even light stays even, and no light is lost.
    """
    sigma_px = min(sigma_px, 2 * length_px)  # by then the light is even
    reach_px = math.ceil(REACH_SIGMAS * sigma_px)
    offset = np.arange(-reach_px, reach_px + 1)
    weight = np.exp(-0.5 * (offset / sigma_px) ** 2)
    row = np.arange(length_px)[:, None]
    column = (row + offset) % (2 * length_px)
    column = np.minimum(column, 2 * length_px - 1 - column)
    matrix = np.zeros((length_px, length_px))
    np.add.at(matrix, (row, column), weight / weight.sum())
    return matrix.astype(np.float32)


def _blurred(image: Floats, down: Floats, across: Floats) -> Floats:
    copies, height, width, colours = image.shape
    image = (down @ image.reshape(copies, height, width * colours)).reshape(image.shape)
    turned = image.swapaxes(1, 2).reshape(copies, width, height * colours)
    return np.asarray((across @ turned).reshape(copies, width, height, colours).swapaxes(1, 2))


def _fits(name: str, number: object) -> bool:
    if isinstance(number, bool) or not isinstance(number, Real):
        return False
    return float(number) > 0 if name == "acuity_cpd" else 0 <= float(number) <= MOST


def _listed(value: object) -> list[object]:
    return list(value) if isinstance(value, Sequence | np.ndarray) else [value]


def _per_eye(how: Eyesight, name: str, eyes: int) -> list[float]:
    numbers = _listed(getattr(how, name))
    if len(numbers) not in (1, eyes):
        raise ValueError(
            f"eyesight: {name} has {len(numbers)} numbers for {eyes} eyes; give one, or one for each eye"
        )
    each = numbers if len(numbers) == eyes else numbers * eyes
    return [float(number) for number in each]  # type: ignore[arg-type]


def _column(values: Sequence[float]) -> Floats:
    return np.array(values, np.float32)[:, None, None, None]
