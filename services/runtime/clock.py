"""Time as the services see it: real, or turned by hand in a simulation."""

import time
from typing import Protocol


class Clock(Protocol):
    """Tells the time; nothing else in a service does."""

    def now_secs(self) -> float:
        """Seconds of wall time (Unix epoch for the real clock)."""
        ...


class RealClock:
    """The machine's clock, monotonic within a process and anchored at its start to Unix time."""

    def __init__(self) -> None:
        self._offset_secs = time.time() - time.monotonic()

    def now_secs(self) -> float:
        """Seconds since the Unix epoch; never goes back within a process."""
        return self._offset_secs + time.monotonic()


class HandClock:
    """A clock that moves only when a test or simulation turns it."""

    def __init__(self, start_secs: float = 0.0) -> None:
        self._now_secs = start_secs

    def now_secs(self) -> float:
        """The time it was last turned to."""
        return self._now_secs

    def advance(self, secs: float) -> None:
        """Turn the clock forward."""
        if secs < 0:
            raise ValueError(f"a clock only goes forward; got {secs} s")
        self._now_secs += secs
