"""Where a study is shown: a line per change, and in a terminal a last line that is kept up to date."""

import os
import sys
from contextlib import AbstractContextManager, ExitStack
from types import TracebackType
from typing import Any, Protocol, Self, TextIO

from services.launcher.lines import clock_words
from services.launcher.study_queue import Queue
from services.launcher.study_words import left_words, progress_words, task_words

PLAIN_SECS = 30.0
"""So often the plain view says how far all is."""
LIVE_SECS = 0.5


class StudyDisplay(AbstractContextManager["StudyDisplay"], Protocol):
    """Shows a study while it is open."""

    def say(self, sentence: str, now_secs: float) -> None:
        """Something happened."""
        ...

    def show(self, queue: Queue, now_secs: float) -> None:
        """How far it is; may be called as often as one likes."""
        ...


class PlainStudyDisplay:
    """Lines that begin with the time since the start."""

    def __init__(self, out: TextIO, began_secs: float) -> None:
        self._out, self._began_secs = out, began_secs
        self._said_secs = began_secs

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._out.flush()

    def say(self, sentence: str, now_secs: float) -> None:
        """See `StudyDisplay`."""
        print(f"{clock_words(now_secs - self._began_secs):>8}  {sentence}", file=self._out, flush=True)

    def show(self, queue: Queue, now_secs: float) -> None:
        """See `StudyDisplay`."""
        if now_secs - self._said_secs >= PLAIN_SECS and not queue.over():
            self._said_secs = now_secs
            self.say(progress_words(queue, now_secs), now_secs)


class LiveStudyDisplay:
    """The same lines, with bars below them that are drawn anew in place."""

    def __init__(self, began_secs: float) -> None:
        from rich.progress import BarColumn, Progress, TextColumn

        self._began_secs, self._drawn_secs = began_secs, float("-inf")
        columns = (TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[words]}"))
        self._progress = Progress(*columns, auto_refresh=False, transient=True)
        self._bars: dict[str, Any] = {}
        self._stack = ExitStack()

    def __enter__(self) -> Self:
        self._stack.enter_context(self._progress)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def say(self, sentence: str, now_secs: float) -> None:
        """See `StudyDisplay`."""
        text = f"{clock_words(now_secs - self._began_secs):>8}  {sentence}"
        self._progress.console.print(text, highlight=False, markup=False)

    def show(self, queue: Queue, now_secs: float) -> None:
        """See `StudyDisplay`."""
        if now_secs - self._drawn_secs < LIVE_SECS:
            return
        self._drawn_secs = now_secs
        worked_at = {task.name: task for task in queue.worked_at()}
        for name in self._bars.keys() - worked_at.keys() - {""}:
            self._progress.remove_task(self._bars.pop(name))
        for name, task in worked_at.items():
            self._bar(name, task.share, task_words(task))
        share = sum(task.share for task in queue.tasks) / len(queue.tasks)
        self._bar("", share, left_words(queue.left_secs(now_secs)))
        self._progress.refresh()

    def _bar(self, name: str, share: float, words: str) -> None:
        if name not in self._bars:
            self._bars[name] = self._progress.add_task(name or "all", total=1.0, words="")
        self._progress.update(self._bars[name], completed=share, words=words)


def study_display_for(out: TextIO, began_secs: float) -> StudyDisplay:
    """Bars in a terminal that can redraw, lines alone elsewhere."""
    if out is sys.stdout and out.isatty() and os.environ.get("TERM", "dumb") not in ("dumb", "unknown"):
        return LiveStudyDisplay(began_secs)
    return PlainStudyDisplay(out, began_secs)
