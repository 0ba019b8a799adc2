"""The Bus: the few things a service asks of a transport, and the inbox that callbacks fill.

Two implementations: `zenoh_bus.ZenohBus` between processes, `memory_bus.MemoryBus` within one.
A callback of the transport only ever puts an arrival into an `Inbox`; decoding, training and
publishing happen on the service's own thread.
"""

import threading
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

from protocol.keys import MAX_FRAME_BYTES
from protocol.refusal import Reason, Refused


@dataclass(frozen=True)
class Frame:
    """A frame heard on a key."""

    key: str
    data: bytes


@dataclass(frozen=True)
class Membership:
    """A process appeared or went (liveliness); `key` is its `alive` key."""

    key: str
    present: bool


@dataclass(frozen=True)
class Link:
    """This process's own link to the router came up or went down."""

    up: bool


@dataclass(frozen=True)
class Question:
    """A command that waits for `reply`; call it once, from any thread."""

    key: str
    data: bytes
    reply: Callable[[bytes], None] = field(compare=False)


Arrival = Frame | Membership | Link | Question


class Wakeup:
    """What a service's loop sleeps on; every inbox of the process rings it."""

    def __init__(self) -> None:
        self._event = threading.Event()

    def ring(self) -> None:
        """Wake the loop, now or at its next wait."""
        self._event.set()

    def wait(self, timeout_secs: float) -> bool:
        """Sleep until rung or until the deadline; True if rung."""
        rung = self._event.wait(timeout_secs)
        self._event.clear()
        return rung


class Inbox:
    """A bounded queue of arrivals: `put` never blocks; beyond the bounds the oldest is dropped, counted."""

    def __init__(
        self, wakeup: Wakeup | None = None, *, max_frames: int = 1024, max_bytes: int = 256 << 20
    ) -> None:
        self._wakeup = wakeup or Wakeup()
        self._lock = threading.Lock()
        self._arrivals: deque[Arrival] = deque()
        self._bytes = 0
        self._max_frames = max_frames
        self._max_bytes = max_bytes
        self.dropped = 0
        """Arrivals dropped because the inbox was full."""

    def __len__(self) -> int:
        return len(self._arrivals)

    def put(self, arrival: Arrival) -> None:
        """Add an arrival (called on the transport's thread)."""
        with self._lock:
            self._arrivals.append(arrival)
            self._bytes += _size(arrival)
            while len(self._arrivals) > self._max_frames or (
                self._bytes > self._max_bytes and len(self._arrivals) > 1
            ):
                self._bytes -= _size(self._arrivals.popleft())
                self.dropped += 1
        self._wakeup.ring()

    def take(self) -> Arrival | None:
        """The oldest arrival, or None."""
        with self._lock:
            if not self._arrivals:
                return None
            arrival = self._arrivals.popleft()
            self._bytes -= _size(arrival)
            return arrival

    def take_all(self) -> list[Arrival]:
        """All arrivals so far, oldest first."""
        with self._lock:
            arrivals = list(self._arrivals)
            self._arrivals.clear()
            self._bytes = 0
            return arrivals


class Bus(Protocol):
    """Publish, subscribe, be alive, ask.

    Keys come from protocol.keys; `kind` names a row of its DELIVERY table.
    """

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """Send a frame as the delivery table says for its kind.

        A "latest-wins" kind is retained: whoever subscribes later, or reconnects, hears the newest.
        Raises `protocol.codec.Refused` for a frame over the size limit.
        """
        ...

    def subscribe(self, kind: str, key_expr: str, inbox: Inbox) -> None:
        """Put each `Frame` that matches the key expression into the inbox."""
        ...

    def announce(self, key: str) -> None:
        """Declare a liveliness token; it goes when this process closes or dies."""
        ...

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """Put a `Membership` into the inbox for each token present now, and for each change."""
        ...

    def watch_link(self, inbox: Inbox) -> None:
        """Put a `Link` into the inbox each time this process's own link to the router changes."""
        ...

    def linked(self) -> bool:
        """True while this process is connected to a router."""
        ...

    def answer(self, key: str, inbox: Inbox) -> None:
        """Put each `Question` asked on this key into the inbox."""
        ...

    def ask(self, key: str, frame: bytes, timeout_secs: float) -> bytes | None:
        """Ask a question; None if nobody answered before the deadline."""
        ...

    def close(self) -> None:
        """Undeclare everything and leave; idempotent."""
        ...


def refuse_oversized(key: str, frame: bytes) -> None:
    """Raise `Refused` for a frame that the transport would drop without a word."""
    if len(frame) > MAX_FRAME_BYTES:
        sentence = f"a frame of {len(frame)} bytes for {key} is over the limit of {MAX_FRAME_BYTES}"
        raise Refused(Reason.OVERSIZED, sentence)


def _size(arrival: Arrival) -> int:
    match arrival:
        case Frame(data=data) | Question(data=data):
            return len(data)
        case _:
            return 0
