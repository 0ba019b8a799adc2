"""Vision: what the body's eyes see, drawn off screen; better or worse eyes are `Eyesight`."""

import math
from collections.abc import Sequence
from typing import Any

import mujoco
import numpy as np

from babble.patterns import matching
from babble.worlds.physics.names import names_of
from babble.worlds.senses.eyesight import Eyesight, Sight
from babble.worlds.senses.rendering import Quality, Renderer, check_size, fixed_camera
from babble.worlds.senses.sense import Copies, Floats

SHADOW_PX = 1024
FACETS = (8, 28)
"""The fewest, and as many as MuJoCo gives round things by itself."""


class Vision:
    """Images (eyes, H, W, 3) of the model's cameras; all copies are drawn by one renderer.

    Drawn quickly (measured in bench/vision.py): shadows only when asked for, no
    mirrors, endless floors in coarse cells, round things with no more facets than the pixels show.
    """

    name = "vision"

    def __init__(
        self,
        model: mujoco.MjModel,
        *,
        cameras: Sequence[str] = ("eye_left", "eye_right"),
        resolution: int | Sequence[int] = 64,
        shadows: bool = False,
        rng: np.random.Generator | None = None,
        **eyesight: Any,
    ) -> None:
        """Needs no OpenGL yet.

        model: must outlive the sense unchanged in its looks.
        cameras: patterns over the names of cameras; the eyes come in the model's order.
        resolution: pixels of a square image, or (height, width).
        shadows: whether lights that cast shadows do.
        rng: for the noise of the eyes.
        eyesight: the fields of `Eyesight`, each for all eyes or one by one.
        Raises ValueError for a camera that the model lacks and for a bad value.
        """
        eyes = matching(names_of(model, "camera"), cameras, "camera")
        names = [names_of(model, "camera")[eye] for eye in eyes]
        how = _eyesight(eyesight)
        closed = set(matching(names, how.closed_eyes, "eye")) if how.closed_eyes else set()
        if not isinstance(shadows, bool):
            raise ValueError(f"vision: shadows must be true or false, got {shadows!r}")
        height, width = _size(resolution)
        self.shape = (len(eyes), height, width, 3)
        self.components = tuple(eye for eye in names for _ in range(height * width * 3))
        self._open = [eye for eye in range(len(eyes)) if eye not in closed]
        self._cameras = [fixed_camera(int(eyes[eye])) for eye in self._open]
        self._sight = Sight(
            how,
            is_open=[eye in self._open for eye in range(len(eyes))],
            height=height,
            width=width,
            fovy_deg=model.cam_fovy[eyes],
            rng=rng or np.random.default_rng(0),
        )
        quality = Quality(shadow_px=SHADOW_PX if shadows else 0, facets=_facets(max(height, width)))
        self._renderer = Renderer(model, height=height, width=width, quality=quality)

    def read(self, copies: Copies) -> Floats:
        """(E, eyes, H, W, 3), the top row first, as of the last mj_forward or the last step's begin.

        Raises `RendererError` where no picture can be drawn.
        """
        images = np.zeros((len(copies), *self.shape), np.uint8)
        if self._open:
            images[:, self._open] = self._renderer.images(copies, self._cameras)
        return self._sight(images)

    def close(self) -> None:
        """Give back what OpenGL holds; the next image takes it again."""
        self._renderer.close()


def _eyesight(options: dict[str, Any]) -> Eyesight:
    known = list(Eyesight.__dataclass_fields__)
    if unknown := sorted(set(options) - set(known)):
        others = ", ".join(("cameras", "resolution", "shadows", *known))
        raise ValueError(f"vision has no option {unknown[0]!r}; its options are {others}")
    return Eyesight(**options)


def _size(resolution: int | Sequence[int]) -> tuple[int, int]:
    sides = [resolution, resolution] if isinstance(resolution, int) else resolution
    if isinstance(sides, str) or not isinstance(sides, Sequence) or len(sides) != 2:
        raise ValueError(
            f"vision: resolution is the pixels of a side, or [height, width], got {resolution!r}"
        )
    check_size(sides[0], sides[1])
    return sides[0], sides[1]


def _facets(side_px: int) -> int:
    """So many facets that the rim of a disc as wide as the image is never off by more than half a pixel."""
    fewest, most = FACETS
    return min(max(fewest, math.ceil(math.pi / math.acos(1 - 1 / side_px))), most)
