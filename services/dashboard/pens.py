"""Points, strips, arrows and names in 2-D or 3-D alike, with sizes in pixels of the page."""

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from services.dashboard.canvas import colours
from services.dashboard.colours import Colour, darker, faded

Floats = NDArray[np.float32]
MOST_NAMES = 3
"""of actors that are close together are written; the others are counted"""


class Pen:
    """Makes Rerun's archetypes; a negative radius there means pixels."""

    def __init__(self, *, solid: bool) -> None:
        self._solid = solid

    def points(
        self, positions: Floats, shades: Sequence[Colour], *, radius_px: float, order: float
    ) -> rr.AsComponents:
        """Dots at positions (n, 2 or 3)."""
        if self._solid:
            return rr.Points3D(positions, radii=[-radius_px], colors=colours(shades))
        return rr.Points2D(positions, radii=[-radius_px], colors=colours(shades), draw_order=order)

    def names(self, positions: Floats, texts: Sequence[str], shades: Sequence[Colour]) -> rr.AsComponents:
        """Texts at positions (n, 2 or 3), on dots that are too small to be seen."""
        kind = rr.Points3D if self._solid else rr.Points2D
        return kind(positions, radii=[-0.1], colors=colours(shades), labels=list(texts), show_labels=True)

    def strips(
        self,
        strips: Sequence[Floats] | Floats,
        shades: Sequence[Colour],
        *,
        width_px: float,
        order: float = 0,
    ) -> rr.AsComponents:
        """Lines through positions, each (k, 2 or 3); those of fewer than two points are left out."""
        size = 3 if self._solid else 2
        kept = [index for index, strip in enumerate(strips) if len(strip) >= 2]
        lines = [np.asarray(strips[index], np.float32).reshape(-1, size) for index in kept]
        shaded = [shades[index] for index in kept] if len(shades) == len(strips) else list(shades)
        radius = [-width_px / 2]
        if self._solid:
            return rr.LineStrips3D(lines, radii=radius, colors=colours(shaded))
        return rr.LineStrips2D(lines, radii=radius, colors=colours(shaded), draw_order=order)

    def arrows(self, origins: Floats, vectors: Floats, shades: Sequence[Colour]) -> rr.AsComponents:
        """Arrows from origins (n, 2 or 3)."""
        if self._solid:
            return rr.Arrows3D(origins=origins, vectors=vectors, radii=[-1.0], colors=colours(shades))
        return rr.Arrows2D(
            origins=origins, vectors=vectors, radii=[-1.0], colors=colours(shades), draw_order=5
        )

    def halos(self, positions: Floats, shades: Sequence[Colour], shares: Sequence[float]) -> rr.AsComponents:
        """Rings of light, larger for larger shares (0..1); cages in 3-D, where light cannot shine through."""
        if self._solid:
            sizes = np.array([[0.06 + 0.08 * share] * 3 for share in shares], np.float32).reshape(-1, 3)
            return rr.Ellipsoids3D(
                centers=positions, half_sizes=sizes, colors=colours(shades), line_radii=[-0.5]
            )
        radii = [-(13.0 + 14.0 * share) for share in shares]
        glow = colours([faded(colour, 70) for colour in shades])
        return rr.Points2D(positions, radii=radii, colors=glow, draw_order=3)

    def dimmed(self, colour: Colour) -> Colour:
        """For what lies in the background."""
        return darker(colour, 0.55) if self._solid else faded(colour, 130)

    def faint(self, colour: Colour) -> Colour:
        """For ways, which cross each other."""
        return darker(colour, 0.8) if self._solid else faded(colour, 170)


def grouped(positions: Floats, names: Sequence[str], near: float) -> tuple[list[int], list[str]]:
    """(which positions carry a text, the texts): those nearer than `near` to one before share its text."""
    heads: list[int] = []
    members: list[list[str]] = []
    for index, position in enumerate(positions):
        for place, head in enumerate(heads):
            if near > 0 and float(np.linalg.norm(position - positions[head])) < near:
                members[place].append(names[index])
                break
        else:
            heads.append(index)
            members.append([names[index]])
    return heads, [_joined(group) for group in members]


def _joined(names: Sequence[str]) -> str:
    left = len(names) - MOST_NAMES
    return " ".join(names[:MOST_NAMES]) + (f" +{left}" if left > 0 else "")
