"""When a run was in which phase, waited, and was started again: read from `events.jsonl`.

Times are seconds that the run was running since it was first announced: the time while it was stopped, before
somebody resumed it, is left out and kept beside it.
"""

import re
from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from protocol.messages import Phase
from services.launcher.records import Record, moment, text

RESUMED_SECS = 10.0
"""A coordinator that its launcher starts again is back sooner; after a longer silence the run was resumed."""
ENCODER, POLICY, ACTOR, RECORDER = "encoder_learner", "policy_learner", "actor", "recorder"
NEEDED: Mapping[Phase, frozenset[str]] = {
    Phase.BABBLE: frozenset({ENCODER, ACTOR}),
    Phase.ENCODE: frozenset({ENCODER}),
    Phase.GROUND: frozenset({POLICY, ACTOR}),
    Phase.WALK: frozenset({ENCODER, ACTOR}),
    Phase.REFINE: frozenset({ENCODER}),
    Phase.PRACTISE: frozenset({POLICY, ACTOR}),
    Phase.EVALUATE: frozenset({POLICY, ACTOR}),
    Phase.DONE: frozenset(),
}
"""Without one of each of these a phase waits; services/coordinator/table.py has the same as duties."""
OPEN_LOOP: Mapping[Phase, frozenset[str]] = {**NEEDED, Phase.BABBLE: frozenset({RECORDER, ACTOR})}
"""The same where nothing is learned."""
ANNOUNCED = re.compile(r"(\w+)(?: of (\w+))? \(level (\d{1,9}), iteration (\d{1,9}), term (\d{1,9})\)")
MEMBER = re.compile(r"(\S+) \((\w+)\)")


@dataclass(frozen=True, kw_only=True)
class Term:
    """What the coordinator announced."""

    phase: Phase
    evaluates: Phase | None = None
    """for EVALUATE: the phase whose result is measured"""
    level: int = 0
    iteration: int = 0
    term: int


@dataclass(frozen=True, kw_only=True)
class Span:
    """From one announcement to the next."""

    announced: Term
    begin_secs: float
    end_secs: float

    @property
    def secs(self) -> float:
        """How long it was."""
        return self.end_secs - self.begin_secs


@dataclass(frozen=True, kw_only=True)
class Restart:
    """The coordinator began again."""

    at_secs: float
    stopped_secs: float
    """so long nothing had run; 0 where only the coordinator was started again"""


@dataclass
class Timeline:
    """The spans of a run, in their order, without overlaps."""

    start_secs: float = 0.0
    """of the first announcement, since 1970"""
    spans: list[Span] = field(default_factory=list)
    restarts: list[Restart] = field(default_factory=list)
    waits: list[tuple[float, float]] = field(default_factory=list)
    """(begin, end) while somebody whom the phase needs was missing"""
    actors: list[tuple[float, int]] = field(default_factory=list)
    """(since, how many) were there"""
    stalls: list[float] = field(default_factory=list)
    """when the coordinator said that nothing goes on"""
    newest: str = ""
    """the last announcement, in the coordinator's words; empty before the first"""
    done: bool = False
    terms: dict[int, Term] = field(default_factory=dict)
    """all that was announced"""
    _stops: list[tuple[float, float]] = field(default_factory=list)
    """(when the run went on, seconds stopped until then in all)"""

    def running(self, secs: float) -> float:
        """Seconds since 1970 -> seconds that the run had been running."""
        index = bisect_right(self._stops, (secs, float("inf")))
        stopped_secs = self._stops[index - 1][1] if index else 0.0
        return max(0.0, secs - self.start_secs - stopped_secs)

    def wall(self, running_secs: float) -> float:
        """Seconds that the run had been running -> seconds since its start, stops included."""
        stopped_secs = 0.0
        for until_secs, total_secs in self._stops:
            if until_secs - self.start_secs - total_secs < running_secs:
                stopped_secs = total_secs
        return running_secs + stopped_secs

    def stop(self, until_secs: float, secs: float) -> None:
        """Until then nothing had run for so long."""
        before = self._stops[-1][1] if self._stops else 0.0
        self._stops.append((until_secs, before + secs))

    @property
    def end_secs(self) -> float:
        """Where the last span ends."""
        return self.spans[-1].end_secs if self.spans else 0.0


def timeline_of(
    events: Iterable[Record], alive_secs: Sequence[float] = (), *, open_loop: bool = False
) -> Timeline:
    """The timeline of the records of `events.jsonl`.

    `alive_secs` are other times, ascending, at which the run was known to be running. In an `open_loop`
    nothing is learned, so that it waits for a recorder instead of learners.
    """
    reader = _Reader(alive_secs, OPEN_LOOP if open_loop else NEEDED)
    for event in events:
        secs, what, words = moment(event, "secs"), text(event, "what"), text(event, "text")
        if secs is not None and what is not None and words is not None:
            reader.hear(secs, what, words)
    return reader.finish()


class _Reader:
    def __init__(self, alive_secs: Sequence[float], needed: Mapping[Phase, frozenset[str]]) -> None:
        self._alive_secs, self._needed = alive_secs, needed
        self._timeline = Timeline()
        self._announced: Term | None = None
        self._since = self._last_secs = 0.0
        self._ended = False
        self._members: dict[str, str] = {}
        self._waiting_since: float | None = None

    def hear(self, secs: float, what: str, words: str) -> None:
        """Take an event. A clock that was set back is held."""
        secs = max(secs, self._last_secs)
        if what == "phase" and (announced := _announced(words)) is not None:
            self._enter(secs, announced, words)
        elif what == "end":
            self._close(secs)
            self._ended = True
        elif what == "stalled":
            self._timeline.stalls.append(self._timeline.running(secs))
        elif what in ("joined", "lost") and (member := MEMBER.match(words)) is not None:
            life, service = member.groups()
            if what == "joined":
                self._members[life] = service
            else:
                self._members.pop(life, None)
            self._count(secs)
        self._last_secs = secs
        self._look(secs)

    def finish(self) -> Timeline:
        """The timeline; what goes on ends at the last sign of life."""
        if not self._ended:
            self._close(max(self._last_secs, *self._alive_secs[-1:], 0.0))
        return self._timeline

    def _enter(self, secs: float, announced: Term, words: str) -> None:
        timeline, before = self._timeline, self._announced
        if not timeline.newest:
            timeline.start_secs = secs
        if before is not None and announced.term == before.term:
            self._start_again(secs)
        elif not self._ended:
            self._close(secs)
        self._announced, self._since, self._ended = announced, timeline.running(secs), False
        timeline.newest, timeline.done = words, announced.phase is Phase.DONE
        timeline.terms[announced.term] = announced

    def _start_again(self, secs: float) -> None:
        """The same term is announced once more: by another process, which knows nobody yet."""
        if self._announced is not None and self._announced.phase is Phase.DONE:
            return
        index = bisect_right(self._alive_secs, secs)
        seen_secs = max([self._last_secs, *self._alive_secs[max(0, index - 1) : index]])
        silent_secs = secs - min(seen_secs, secs)
        was_stopped = self._ended or silent_secs > RESUMED_SECS
        if not self._ended:
            self._close(seen_secs if was_stopped else secs)
        if was_stopped:
            self._timeline.stop(secs, silent_secs)
        at_secs = self._timeline.running(secs)
        self._timeline.restarts.append(
            Restart(at_secs=at_secs, stopped_secs=silent_secs if was_stopped else 0.0)
        )
        self._members.clear()
        self._count(secs)

    def _close(self, secs: float) -> None:
        """End the span that goes on, and the waiting in it."""
        end_secs = self._timeline.running(secs)
        self._wait_until(end_secs)
        if self._announced is not None and self._announced.phase is not Phase.DONE and end_secs > self._since:
            span = Span(announced=self._announced, begin_secs=self._since, end_secs=end_secs)
            self._timeline.spans.append(span)
        self._since = end_secs

    def _look(self, secs: float) -> None:
        """Is anybody missing?"""
        if self._announced is None or self._ended:
            return
        missing = self._needed[self._announced.phase] - set(self._members.values())
        now_secs = self._timeline.running(secs)
        if missing and self._waiting_since is None:
            self._waiting_since = now_secs
        elif not missing:
            self._wait_until(now_secs)

    def _wait_until(self, now_secs: float) -> None:
        if self._waiting_since is not None and now_secs > self._waiting_since:
            self._timeline.waits.append((self._waiting_since, now_secs))
        self._waiting_since = None

    def _count(self, secs: float) -> None:
        count = sum(service == ACTOR for service in self._members.values())
        actors = self._timeline.actors
        if not actors or actors[-1][1] != count:
            actors.append((self._timeline.running(secs), count))


def _announced(said: str) -> Term | None:
    """What the coordinator said, such as "evaluate of practise (level 0, iteration 2, term 12)"."""
    words = ANNOUNCED.match(said)
    if words is None:
        return None
    phase, evaluates, level, iteration, term = words.groups()
    try:
        return Term(
            phase=Phase(phase),
            evaluates=None if evaluates is None else Phase(evaluates),
            level=int(level),
            iteration=int(iteration),
            term=int(term),
        )
    except ValueError:
        return None
