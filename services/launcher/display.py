"""Where a run is shown: live in a terminal, or as plain lines on changes."""

import os
import sys
from contextlib import AbstractContextManager
from types import TracebackType
from typing import Protocol, Self, TextIO

from services.launcher.frame import frame
from services.launcher.lines import ASCII, Signs, progress_line, score_words
from services.launcher.members import Picture

LIVE_SECS = 0.5
"""The live view is drawn anew so often."""
PLAIN_SECS = 10.0
"""The plain view says how far it is so often, at first."""
LONG_PLAIN_SECS = 60.0
"""Of a long run so often: whoever reads the log of a day has other things to read."""
SHARE = 0.05
"""Of the time so far, in between."""


class Display(AbstractContextManager["Display"], Protocol):
    """Shows a picture while it is open."""

    def show(self, picture: Picture, now_secs: float) -> None:
        """Show what is new; may be called as often as one likes."""
        ...


class PlainDisplay:
    """One line per change, and one now and then; each begins with the seconds since the start."""

    def __init__(self, out: TextIO | None = None) -> None:
        self._out = out or sys.stdout
        self._scores = 0
        self._said_secs: float | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._out.flush()

    def show(self, picture: Picture, now_secs: float) -> None:
        """Print what is new."""
        while picture.news:
            self._say(picture, now_secs, picture.news.popleft())
        for row in picture.scores[self._scores :]:
            self._say(picture, now_secs, score_words(row))
        self._scores = len(picture.scores)
        if self._said_secs is None:
            self._said_secs = now_secs
        elif now_secs - self._said_secs >= _pause_secs(now_secs - picture.began_secs) and not picture.done:
            self._said_secs = now_secs
            self._say(picture, now_secs, progress_line(picture, now_secs))

    def _say(self, picture: Picture, now_secs: float, text: str) -> None:
        print(f"{now_secs - picture.began_secs:7.1f} s  {text}", file=self._out, flush=True)


def _pause_secs(since_secs: float) -> float:
    """How long the plain view is silent if nothing happens."""
    return min(max(PLAIN_SECS, SHARE * since_secs), LONG_PLAIN_SECS)


class LiveDisplay:
    """A view that redraws itself in place."""

    def __init__(self) -> None:
        from rich.console import Console
        from rich.live import Live

        self._console = Console(highlight=False)
        # Transient: what remains is the summary, which is printed below as plain text.
        self._live = Live(console=self._console, auto_refresh=False, transient=True)
        self._signs = Signs() if "utf" in self._console.encoding.lower() else ASCII
        self._drawn_secs = float("-inf")

    def __enter__(self) -> Self:
        self._live.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._live.stop()

    def show(self, picture: Picture, now_secs: float) -> None:
        """Draw the picture, if it is time."""
        from rich.text import Text

        picture.news.clear()
        if now_secs - self._drawn_secs < LIVE_SECS:
            return
        self._drawn_secs = now_secs
        width, height = self._console.size
        rows = frame(picture, now_secs, width, height - 1, self._signs)
        text = Text("\n").join(Text.assemble(*row, no_wrap=True, overflow="crop") for row in rows)
        self._live.update(text, refresh=True)


def display_for(out: TextIO) -> Display:
    """The live view in a terminal that can redraw, plain lines elsewhere."""
    if out.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown"):
        return LiveDisplay()
    return PlainDisplay(out)
