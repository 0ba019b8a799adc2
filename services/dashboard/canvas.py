"""What panels log to: the live stream, the file, or both; and lines with their names."""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import rerun as rr

from services.dashboard.colours import Colour

OTHER_SIGNS = "●○✓✖▲→‖"
"""Beyond Latin letters, these are used here and in the viewer's font."""


class Canvas:
    """Two streams of one recording, each of which may be missing; their times are set already."""

    def __init__(
        self, live: rr.RecordingStream | None = None, file: rr.RecordingStream | None = None
    ) -> None:
        self._live = live
        self._file = file
        self.rows = 0
        """rows logged, to either"""

    def log(self, path: str, *archetypes: rr.AsComponents, static: bool = False, thin: bool = True) -> None:
        """Log one row at an entity; `thin=False` keeps it out of the file this time."""
        for stream in (self._live, self._file if thin or static else None):
            if stream is not None:
                stream.log(path, *archetypes, static=static)
                self.rows += 1


class Panel(Protocol):
    """A part of the picture."""

    def begin(self, canvas: Canvas) -> None:
        """Log what never changes and what still holds; called at the start of each stream and file."""

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log what is new; called about ten times a second, and decides itself what is due."""


class Due:
    """Says when something that happens each `secs` is due."""

    def __init__(self, secs: float) -> None:
        self._secs = secs
        self._next_secs = float("-inf")

    def __call__(self, now_secs: float) -> bool:
        """True at most once each interval, and then counted as done."""
        if now_secs < self._next_secs:
            return False
        self._next_secs = now_secs + self._secs
        return True


class Lines:
    """Lines of a plot: entity -> one number at a time, its name and colour said once per stream."""

    def __init__(self) -> None:
        self._styles: dict[str, tuple[rr.AsComponents, ...]] = {}

    def __contains__(self, path: str) -> bool:
        return path in self._styles

    def begin(self, canvas: Canvas) -> None:
        """Say the names and colours of the lines so far."""
        for path, style in self._styles.items():
            canvas.log(path, *style, static=True)

    def name(
        self,
        canvas: Canvas,
        path: str,
        name: str,
        colour: Colour,
        width: float = 1.5,
        dots: bool = False,
    ) -> None:
        """Name a line, with dots where its numbers are if they are few; the first name holds."""
        if path in self._styles:
            return
        shade = colours([colour])
        style = [rr.SeriesLines(names=[name], colors=shade, widths=[width])]
        if dots:
            style.append(rr.SeriesPoints(names=[name], colors=shade, markers=["circle"], marker_sizes=[4.0]))
        self._styles[path] = tuple(style)
        canvas.log(path, *style, static=True)

    def add(self, canvas: Canvas, path: str, value: float | None, *, thin: bool = True) -> None:
        """Add a number; one that is missing, NaN or infinite leaves a gap."""
        if value is not None and math.isfinite(value):
            canvas.log(path, rr.Scalars(float(value)), thin=thin)


def colours(values: Sequence[Colour]) -> np.ndarray:
    """Colours as Rerun takes them without doubt: 0xRRGGBBAA, (n,) uint32."""
    return np.asarray(values, np.uint32)


def page(markdown: str) -> rr.TextDocument:
    """A text as a document."""
    return rr.TextDocument(plain(markdown), media_type=rr.MediaType.MARKDOWN)


def plain(text: str) -> str:
    """The text with "?" for what the viewer's font lacks: its headless form ends at the first such sign."""
    return "".join(sign if _is_drawn(sign) else "?" for sign in text)


def _is_drawn(sign: str) -> bool:
    return sign == "\n" or (sign.isprintable() and sign < "\u0180") or sign in OTHER_SIGNS
