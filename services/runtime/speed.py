"""How fast a total grows, from what was heard of it now and then (pure)."""

from collections import deque

RATE_SECS = 5.0
"""Speeds are over so many of the last seconds, as far as they are known."""
MOST_HEARD = 64


class Speed:
    """How fast a total grows."""

    def __init__(self, rate_secs: float = RATE_SECS) -> None:
        """`rate_secs` is at least twice the time between two totals, or there would be no speed."""
        self._rate_secs = rate_secs
        self._heard: deque[tuple[float, float]] = deque(maxlen=MOST_HEARD)

    def hear(self, now_secs: float, total: float) -> None:
        """A total; one that is smaller than before is a new count."""
        if self._heard and total < self._heard[-1][1]:
            self._heard.clear()
        self._heard.append((now_secs, total))

    def per_sec(self, now_secs: float) -> float | None:
        """The mean of the last `rate_secs`; None while there is too little to tell."""
        recent = [(secs, total) for secs, total in self._heard if secs >= now_secs - self._rate_secs]
        if len(recent) < 2 or recent[-1][0] <= recent[0][0]:
            return None
        return (recent[-1][1] - recent[0][1]) / (recent[-1][0] - recent[0][0])
