"""The sender's side of one stream: what was sent and is not yet known to be held safely.

Pure: time arrives as an argument. With the consumer's `Ledger` it makes delivery at-least-once on
the wire and exactly-once in the book.
"""

from collections import deque

MAX_HELD_BYTES = 256 << 20


class SendWindow:
    """At most `size` unacknowledged frames of one (consumer, block), sent again after `resend_secs`.

    Sends nothing new while it holds `max_bytes` or more, so it holds less than that and one frame.
    """

    def __init__(self, size: int, resend_secs: float, *, max_bytes: int = MAX_HELD_BYTES) -> None:
        if size < 1 or not resend_secs > 0 or max_bytes < 1:
            raise ValueError(
                "a window must have size >= 1, resend_secs > 0 and max_bytes >= 1, "
                f"not {size}, {resend_secs} and {max_bytes}"
            )
        self._size = size
        self._resend_secs = resend_secs
        self._max_bytes = max_bytes
        self._frames: deque[bytes] = deque()
        self._since_secs: deque[float] = deque()
        self._base = 0
        self.held_bytes = 0
        """Bytes of the unacknowledged frames."""
        self.resent = 0
        """Frames sent again, each time counted."""
        self.ignored_acks = 0
        """Acknowledgements that went back, or spoke of what was never sent."""

    @property
    def next_seq(self) -> int:
        """The number of the next new frame."""
        return self._base + len(self._frames)

    @property
    def sent_total(self) -> int:
        """Different frames sent so far."""
        return self.next_seq

    @property
    def acked_total(self) -> int:
        """Frames known to be held safely: all below this number."""
        return self._base

    @property
    def unacknowledged(self) -> int:
        """Frames sent and not yet acknowledged."""
        return len(self._frames)

    def may_send(self, granted: int) -> bool:
        """True if a new frame may go out now, the consumer having granted all seq below `granted`."""
        return (
            self.next_seq < granted and len(self._frames) < self._size and self.held_bytes < self._max_bytes
        )

    def sent(self, seq: int, frame: bytes, now_secs: float) -> None:
        """Hold the frame that goes out now.

        Raises ValueError if `seq` is not the next number or the window is full.
        """
        if seq != self.next_seq:
            raise ValueError(f"the next segment to send is {self.next_seq}, not {seq}")
        if not self.may_send(seq + 1):
            raise ValueError(f"the window is full with {len(self._frames)} frames; wait for an ack")
        self._frames.append(frame)
        self._since_secs.append(now_secs)
        self.held_bytes += len(frame)

    def acked(self, upto: int) -> int:
        """Let go of all frames below `upto`; returns how many those were.

        An acknowledgement that goes back, or lies beyond what was sent, is counted and ignored.
        """
        if not self._base <= upto <= self.next_seq:
            self.ignored_acks += 1
            return 0
        released = upto - self._base
        for _ in range(released):
            self.held_bytes -= len(self._frames.popleft())
            self._since_secs.popleft()
        self._base = upto
        return released

    def due(self, now_secs: float) -> list[tuple[int, bytes]]:
        """What to send again now: every (seq, frame) held, in order, once the oldest waits too long.

        They count as sent again at `now_secs`.
        """
        wait_secs = self.secs_until_due(now_secs)
        if wait_secs is None or wait_secs > 0:
            return []
        self._since_secs = deque([now_secs] * len(self._frames))
        self.resent += len(self._frames)
        return list(enumerate(self._frames, start=self._base))

    def secs_until_due(self, now_secs: float) -> float | None:
        """Seconds until `due` has something, 0 if it has; None if nothing is unacknowledged."""
        if not self._since_secs:
            return None
        return max(0.0, self._resend_secs - (now_secs - self._since_secs[0]))
