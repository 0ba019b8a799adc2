"""What the router hears of actors: all of it counted by host, and some of it kept to be looked at."""

import re
import threading
from collections import deque
from dataclasses import dataclass, field

from protocol import keys
from protocol.gate import Gate
from protocol.refusal import Reason
from services.router.hosts import MOST_HOSTS
from services.runtime.bus import Arrival, Frame, Inbox, Membership
from services.runtime.credentials import HOST_PATTERN

MOST_FRAMES = 32
"""Of each host so many frames wait to be looked at; a new one takes the place of the oldest."""
MOST_BYTES_OF_ONE = 8 << 20
"""Likewise, unless a single frame is larger."""
MOST_BYTES = 96 << 20
"""of all frames that wait"""

_LIFE = re.compile(rf"actor-({HOST_PATTERN})-[^/]*\Z")


def host_of(key: str) -> str | None:
    """The host in the life that ends a key; None if it is not that of an actor with a host."""
    found = _LIFE.fullmatch(key, key.rfind("/") + 1)
    return None if found is None else found[1]


@dataclass
class _Queue:
    """The frames of one host that wait."""

    frames: deque[Frame] = field(default_factory=deque)
    bytes: int = 0

    def put(self, frame: Frame) -> None:
        self.frames.append(frame)
        self.bytes += len(frame.data)

    def take(self) -> Frame:
        frame = self.frames.popleft()
        self.bytes -= len(frame.data)
        return frame

    @property
    def overfull(self) -> bool:
        return len(self.frames) > MOST_FRAMES or (len(self.frames) > 1 and self.bytes > MOST_BYTES_OF_ONE)


class Samples(Inbox):
    """An inbox for frames of actors; no host can crowd out another's, or make it grow."""

    def __init__(self) -> None:
        super().__init__()
        self._guard = threading.Lock()
        self._counts: dict[str, int] = {}
        self._waiting: dict[str, _Queue] = {}
        self._waiting_bytes = 0

    def put(self, arrival: Arrival) -> None:
        """Count a frame and keep it for a while (called on the transport's threads)."""
        host = host_of(arrival.key) if isinstance(arrival, Frame) else None
        if not isinstance(arrival, Frame) or host is None:
            return
        with self._guard:
            if host not in self._waiting and len(self._waiting) >= MOST_HOSTS:
                self.dropped += 1
                return
            self._counts[host] = self._counts.get(host, 0) + 1
            queue = self._waiting.setdefault(host, _Queue())
            queue.put(arrival)
            self._waiting_bytes += len(arrival.data)
            while queue.overfull or (queue.frames and self._waiting_bytes > MOST_BYTES):
                self._waiting_bytes -= len(queue.take().data)
                self.dropped += 1

    def counts(self) -> dict[str, int]:
        """Host -> frames heard since the last call."""
        with self._guard:
            counts, self._counts = self._counts, {}
        return counts

    def next_frame(self) -> tuple[str, Frame] | None:
        """A frame to look at, of each host in turn, and its host; None if none waits."""
        with self._guard:
            for host in list(self._waiting):
                queue = self._waiting.pop(host)
                if queue.frames:
                    self._waiting[host] = queue
                    frame = queue.take()
                    self._waiting_bytes -= len(frame.data)
                    return host, frame
        return None

    def forget(self, host: str) -> None:
        """Drop what waits of a host."""
        with self._guard:
            queue = self._waiting.pop(host, _Queue())
            self._waiting_bytes -= queue.bytes
            self.dropped += len(queue.frames)
            self._counts.pop(host, None)


def fault(frame: Frame) -> tuple[str, str] | None:
    """Why nobody could use a frame, as a reason and a sentence; None if it is in order.

    Its key must be one of kind segment or status.
    """
    _, run, kind, *_ = frame.key.split("/")
    gate = Gate(run, {kind})
    if gate.admit(frame.key, frame.data) is not None:
        return None
    return next(iter(gate.refused)), gate.last_refusal


def misnamed(token: Membership) -> tuple[str, str] | None:
    """Likewise of a token, which no process of a run can have."""
    try:
        keys.member(token.key)
    except ValueError as error:
        return Reason.WRONG_KEY, str(error)
    return None
