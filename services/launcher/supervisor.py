"""Keeps the processes of a run going (pure: time and processes are given).

A process that dies is started again after a growing delay. What a person must mend (exit code 2) ends
the run at once; what dies again and again ends it too, unless it is an actor and another one lives. What is
optional (the dashboard) is given up instead, and nobody waits for it.
"""

import signal
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

USER_ERROR = 2
"""The exit code of a process that has said in one sentence what a person must mend."""
TAIL_BYTES = 4096


@dataclass(frozen=True, kw_only=True)
class Part:
    """A process of the run: its name, what follows `python` on its command line, and its log."""

    name: str
    arguments: tuple[str, ...]
    log: Path
    expendable: bool = False
    """the run can do without it as long as there is another expendable one (actors)"""
    outlasts: bool = False
    """it does not end by itself, but is ended after all others (the router)"""
    leads: bool = False
    """the others learn from it that the run is done (the coordinator)"""
    optional: bool = False
    """the run goes on whatever happens to it (the dashboard)"""
    must_finish: bool = False
    """the run is completed only when it has ended in order after it (the recorder)"""


@dataclass(frozen=True, kw_only=True)
class Exit:
    """The end of a process; a negative code is a signal's number."""

    code: int
    cpu_secs: float


class Child(Protocol):
    """A started process."""

    def poll(self) -> Exit | None:
        """How it ended, once; None while it runs."""
        ...

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        ...


@dataclass(frozen=True, kw_only=True)
class Patience:
    """How often a process may die, and how long it then stays away."""

    most_deaths: int = 5
    within_secs: float = 60.0
    first_delay_secs: float = 0.25
    longest_delay_secs: float = 4.0

    def delay_secs(self, deaths: int) -> float | None:
        """The delay after so many deaths within the time, None to give up."""
        if deaths >= self.most_deaths:
            return None
        return min(self.first_delay_secs * 2.0 ** (deaths - 1), self.longest_delay_secs)

    def note_death(self, deaths_secs: list[float], now_secs: float) -> float | None:
        """Add a death to the list, less those too long ago; the delay as of `delay_secs`."""
        began_secs = now_secs - self.within_secs
        deaths_secs[:] = [secs for secs in deaths_secs if secs > began_secs] + [now_secs]
        return self.delay_secs(len(deaths_secs))


@dataclass
class _Place:
    part: Part
    child: Child | None = None
    due_secs: float | None = 0.0
    """when it is to be started; None if it is running or over"""
    deaths_secs: list[float] = field(default_factory=list)
    cpu_secs: float = 0.0
    has_finished: bool = False
    """it ended in order, after the run"""

    @property
    def over(self) -> bool:
        return self.child is None and self.due_secs is None


class Supervisor:
    """Starts the parts of a run at the first `poll`, and looks after them at each further one."""

    def __init__(
        self, parts: Sequence[Part], start: Callable[[Part], Child], patience: Patience | None = None
    ) -> None:
        self.fatal: str | None = None
        """Why the run cannot go on, in one sentence; None while it can."""
        self.fatal_code = 1
        """The exit code that goes with it."""
        self.given_up: set[str] = set()
        """The optional parts that the run goes on without."""
        self._places = [_Place(part) for part in parts]
        self._start = start
        self._patience = patience or Patience()
        self._stopping = False

    def poll(self, now_secs: float, *, done: bool) -> list[str]:
        """Start what is due and note what ended; returns what happened, one sentence each.

        `done` says that the run is done, so that an end in order is no death.
        """
        news: list[str] = []
        for place in self._places:
            if place.child is not None and (exit := place.child.poll()) is not None:
                place.child = None
                place.cpu_secs += exit.cpu_secs
                news += self._ended(place, exit, now_secs, done)
            elif place.due_secs is not None and place.due_secs <= now_secs and not self._stopping:
                place.child, place.due_secs = self._start(place.part), None
        return news

    def finished(self) -> bool:
        """True once nothing is left but what outlasts the others, and what is optional."""
        return all(place.over for place in self._places if not (place.part.outlasts or place.part.optional))

    def alone(self) -> bool:
        """True once nothing is left but what outlasts the others."""
        return all(place.over for place in self._places if not place.part.outlasts)

    def led(self) -> bool:
        """True while there is one from whom the others learn that the run is done."""
        return any(place.part.leads and not place.over for place in self._places)

    def unfinished(self) -> list[str]:
        """The parts that must finish and have not, by name."""
        return [p.part.name for p in self._places if p.part.must_finish and not p.has_finished]

    def ended(self) -> bool:
        """True once no process is left."""
        return all(place.child is None for place in self._places)

    def stop(self, number: signal.Signals, *, everything: bool = False) -> None:
        """Send a signal to all, or to all but what outlasts them; nothing is started any more."""
        self._stopping = True
        for place in self._places:
            place.due_secs = None
            if place.child is not None and (everything or not place.part.outlasts):
                place.child.send(number)

    def dismiss(self) -> None:
        """Kill what is optional, in whatever state it is."""
        for place in self._places:
            if place.part.optional and place.child is not None:
                place.child.send(signal.SIGKILL)

    def cpu_secs(self) -> dict[str, float]:
        """CPU seconds of the ended processes by name; those of all their lives."""
        return {place.part.name: place.cpu_secs for place in self._places}

    def _ended(self, place: _Place, exit: Exit, now_secs: float, done: bool) -> list[str]:
        part = place.part
        place.has_finished = done and exit.code == 0 and not self._stopping
        if self._stopping or place.has_finished:
            return []
        how = f"{part.name} {how_it_ended(exit.code)}"
        if exit.code == USER_ERROR and part.optional:
            return self._do_without(part, last_line(part.log) or f"{how}; see {part.log}")
        if exit.code == USER_ERROR:
            self._give_up(last_line(part.log) or f"{how}; see {part.log}", USER_ERROR)
            return []
        if done and not (part.leads or part.outlasts or part.must_finish):
            return [f"{how} after the run was done; see {part.log}"]
        delay_secs = self._patience.note_death(place.deaths_secs, now_secs)
        if delay_secs is not None:
            place.due_secs = now_secs + delay_secs
            if done:
                self._recall_leader(now_secs)
            return [f"{how}; it is started again in {delay_secs:g} s"]
        return self._abandoned(place, how)

    def _recall_leader(self, now_secs: float) -> None:
        """Who starts again after the run hears only from the leader that the run is done."""
        for place in self._places:
            if place.part.leads and place.over:
                place.due_secs = now_secs

    def _abandoned(self, place: _Place, how: str) -> list[str]:
        part = place.part
        often = f"for the {len(place.deaths_secs)}th time within {self._patience.within_secs:.0f} s"
        said = last_line(part.log)
        sentence = f"{how} {often}; see {part.log}" + (f", which ends with: {said}" if said else "")
        if part.optional:
            return self._do_without(part, sentence)
        if part.expendable and any(p.part.expendable and not p.over for p in self._places if p is not place):
            return [f"{sentence}; the run goes on without it"]
        self._give_up(sentence, 1)
        return []

    def _do_without(self, part: Part, sentence: str) -> list[str]:
        self.given_up.add(part.name)
        return [f"{sentence}; the run goes on without it"]

    def _give_up(self, sentence: str, code: int) -> None:
        if self.fatal is None:
            self.fatal, self.fatal_code = sentence, code


def last_line(log: Path) -> str:
    """The last line of a log that is not empty, or nothing."""
    try:
        with log.open("rb") as file:
            file.seek(max(0, log.stat().st_size - TAIL_BYTES))
            lines = file.read().decode(errors="replace").splitlines()
    except OSError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def how_it_ended(code: int) -> str:
    """What an exit code says, after a name: "was killed by SIGKILL"."""
    if code >= 0:
        return f"ended with code {code}" if code == 0 else f"failed with code {code}"
    try:
        return f"was killed by {signal.Signals(-code).name}"
    except ValueError:
        return f"was killed by signal {-code}"
