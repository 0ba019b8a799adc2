"""What each client did lately, held against the limits (pure: time is given)."""

from collections import deque
from dataclasses import dataclass, field

from services.router.config import Limits

WINDOW_SECS = 5.0
"""Rates are means over so long, so that a short burst is no offence."""
GARBAGE_SECS = 10.0


class Sliding:
    """A sum over the last `secs` seconds."""

    def __init__(self, secs: float) -> None:
        self.secs = secs
        self._added: deque[tuple[float, float]] = deque()
        self._sum = 0.0

    def add(self, now_secs: float, amount: float) -> None:
        """Add an amount; times do not go back."""
        if amount:
            self._added.append((now_secs, amount))
            self._sum += amount

    def sum(self, now_secs: float) -> float:
        """What was added since `secs` seconds ago."""
        while self._added and self._added[0][0] <= now_secs - self.secs:
            self._sum -= self._added.popleft()[1]
        return self._sum if self._added else 0.0


@dataclass
class Conduct:
    """What one identity did lately."""

    received: Sliding = field(default_factory=lambda: Sliding(WINDOW_SECS))
    """bytes on its connections"""
    messages: Sliding = field(default_factory=lambda: Sliding(WINDOW_SECS))
    garbage: Sliding = field(default_factory=lambda: Sliding(GARBAGE_SECS))
    last_garbage: str = ""
    """why the last of it could not be used"""
    lives: set[str] = field(default_factory=set)
    """the keys of its tokens; one more than the limit at most"""
    connections: int = 0

    def live(self, key: str, present: bool, now_secs: float, limits: Limits) -> None:
        """One of its processes came or went."""
        self.messages.add(now_secs, 1)
        if not present:
            self.lives.discard(key)
        elif len(self.lives) <= limits.lives:
            self.lives.add(key)

    def excess(self, now_secs: float, limits: Limits) -> str | None:
        """What is over a limit, how much and which, for a person; None if nothing is."""
        mb_per_sec = self.received.sum(now_secs) / WINDOW_SECS / 1e6
        if mb_per_sec > limits.mb_per_sec:
            return f"{mb_per_sec:,.1f} MB/s over {WINDOW_SECS:.0f} s (limit {limits.mb_per_sec:g})"
        per_sec = self.messages.sum(now_secs) / WINDOW_SECS
        if per_sec > limits.messages_per_sec:
            return f"{per_sec:,.0f} messages/s over {WINDOW_SECS:.0f} s (limit {limits.messages_per_sec:g})"
        garbage = self.garbage.sum(now_secs)
        if garbage > limits.garbage:
            what = f"{garbage:,.0f} frames of garbage in {GARBAGE_SECS:.0f} s (limit {limits.garbage})"
            return f"{what}, the last: {self.last_garbage}"
        if len(self.lives) > limits.lives:
            return f"more than {limits.lives} processes at once (the limit)"
        if self.connections > limits.connections:
            return f"{self.connections:,} connections at once (limit {limits.connections})"
        return None
