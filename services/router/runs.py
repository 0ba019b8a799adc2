"""The runs that are there now: what phase each is in, and the router's own status for each of them."""

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

from protocol import keys
from protocol.gate import Gate
from protocol.latest import LatestPhase
from protocol.messages import Phase, PhaseAnnounced
from services.runtime.bus import Frame, Inbox, Membership
from services.runtime.status import Heart

log = logging.getLogger(__name__)

SERVICE = "router"
NO_RUN = "none"
"""Named in the health file while there is no run."""
MOST_RUNS = 16
MOST_ARRIVALS = 1024
STATUS_SECS = 1.0


class Doorway(Protocol):
    """What is asked of a router; `zenoh_bus.Router` is one."""

    def hear(self, key_expr: str, inbox: Inbox) -> None:
        """See `Router.hear`."""
        ...

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """See `Router.watch`."""
        ...

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """See `Router.publish`."""
        ...

    def linked(self) -> bool:
        """See `Router.linked`."""
        ...


@dataclass
class _Run:
    heart: Heart
    latest: LatestPhase = field(default_factory=LatestPhase)
    coordinators: set[str] = field(default_factory=set)
    """keys of their tokens"""

    @property
    def done(self) -> bool:
        return self.latest.current is not None and self.latest.current.phase is Phase.DONE


class Runs:
    """Up to MOST_RUNS runs that have a coordinator; `attach` it to an open router first."""

    def __init__(self, life: str) -> None:
        self._life = life
        self._runs: dict[str, _Run] = {}
        self._done = False
        self._voice = _Voice()
        self._idle = Heart(
            _Mute(self._voice), run=NO_RUN, service=SERVICE, life=self._life, interval_secs=STATUS_SECS
        )
        self._inbox = Inbox(max_frames=MOST_ARRIVALS)

    def attach(self, doorway: Doorway) -> None:
        """Begin with a router that was just opened."""
        self._voice.doorway = doorway
        self._inbox = Inbox(max_frames=MOST_ARRIVALS)
        for run in self._runs.values():
            run.coordinators.clear()
        doorway.watch(keys.alive("*", "coordinator", "*"), self._inbox)
        doorway.hear(keys.phase("*"), self._inbox)

    def hear(self) -> None:
        """Take what has come."""
        arrivals = self._inbox.take_all()
        # Phases are urgent and may overtake the token of who says them.
        for arrival in arrivals:
            if isinstance(arrival, Membership):
                self._hear_coordinator(arrival.key, arrival.present)
        for arrival in arrivals:
            if isinstance(arrival, Frame):
                self._hear_phase(arrival)

    def publish(self, now_secs: float, build: Callable[[], Mapping[str, Any]]) -> None:
        """Say the router's status in each run, if it is time; `build` as for `Heart.poll`."""
        there = [run for run in self._runs.values() if run.coordinators]
        for run in there:
            run.heart.poll(now_secs, build)
        if not there:
            self._idle.poll(now_secs, build)

    def done(self) -> bool:
        """True once a run is done and no other has a coordinator."""
        return self._done and all(run.done for run in self._runs.values() if run.coordinators)

    def _hear_coordinator(self, key: str, present: bool) -> None:
        if not keys.is_member(key):
            return
        name = key.split("/")[1]
        run = self._runs.get(name)
        if run is None and present:
            run = self._meet(name)
        if run is None:
            return
        if present:
            if not run.coordinators:
                # A run that begins again under its old name begins with term 1.
                run.latest = LatestPhase()
            run.coordinators.add(key)
        else:
            run.coordinators.discard(key)

    def _meet(self, name: str) -> _Run | None:
        if len(self._runs) >= MOST_RUNS:
            over = next((old for old, run in self._runs.items() if not run.coordinators), None)
            if over is None:
                log.warning("run %s gets no status of the router, which already has %d", name, MOST_RUNS)
                return None
            del self._runs[over]
        self._runs[name] = _Run(
            Heart(self._voice, run=name, service=SERVICE, life=self._life, interval_secs=STATUS_SECS)
        )
        return self._runs[name]

    def _hear_phase(self, frame: Frame) -> None:
        name = frame.key.split("/")[1]
        run = self._runs.get(name)
        message = None if run is None else Gate(name, {"phase"}).admit(frame.key, frame.data)
        if run is None or not isinstance(message, PhaseAnnounced):
            return
        before = run.latest.current
        if run.latest.admit(message) and (before is None or message.term != before.term):
            run.heart.enter(message.term, message.phase)
        self._done = self._done or run.done


class _Voice:
    """A heart's voice, through whichever router is open now."""

    doorway: Doorway

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """See `Router.publish`."""
        self.doorway.publish(kind, key, frame)

    def linked(self) -> bool:
        """See `Router.linked`."""
        return self.doorway.linked()


class _Mute:
    """Says nothing; the heart still keeps the health file."""

    def __init__(self, voice: _Voice) -> None:
        self._voice = voice

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """Nobody is there to hear it."""

    def linked(self) -> bool:
        """See `Router.linked`."""
        return self._voice.linked()
