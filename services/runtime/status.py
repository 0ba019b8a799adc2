"""One process's health and progress, published each interval and at once when something changed."""

import os
import resource
from collections.abc import Callable, Mapping
from pathlib import Path
from time import process_time
from typing import Any

from protocol import keys
from protocol.codec import encode
from protocol.messages import ALL_BLOCKS, Phase, Status
from protocol.refusal import Reason
from services.runtime.bus import Bus

LONGEST_TEXT = 2000


class Heart:
    """Publishes the `Status` of a process; it also keeps the totals and refusals that a service gives it."""

    def __init__(
        self,
        bus: Bus,
        *,
        run: str,
        service: str,
        life: str,
        interval_secs: float,
        measure: Callable[[], Mapping[str, float]] | None = None,
    ) -> None:
        self.term = 0
        self.phase: Phase | None = None
        self.totals: dict[str, int] = {}
        """Totals of this life by name; the fields given at `poll` are laid over them."""
        self.refused: dict[str, int] = {}
        self.last_error = ""
        self._bus = bus
        self._key = keys.status(run, service, life)
        self._names = {"run": run, "service": service, "life": life, "block": ALL_BLOCKS}
        self._interval_secs = interval_secs
        self._measure = measure or process_metrics
        self._seq = 0
        self._published_secs = float("-inf")
        self._urgent = False

    def enter(self, term: int, phase: Phase | None) -> None:
        """A new term: said at once."""
        self.term, self.phase, self._urgent = term, phase, True

    def count(self, name: str, more: int = 1) -> None:
        """Add to a total."""
        self.totals[name] = self.totals.get(name, 0) + more

    def refuse(self, reason: Reason, sentence: str = "") -> None:
        """Count a refused frame."""
        self.refused[reason] = self.refused.get(reason, 0) + 1
        self.last_error = sentence or self.last_error

    def urge(self) -> None:
        """Publish at the next poll instead of at the next interval."""
        self._urgent = True

    def poll(self, now_secs: float, build: Callable[[], Mapping[str, Any]], *, urgent: bool = False) -> float:
        """Publish if it is time; returns the seconds until the next time.

        `build` gives the fields of `Status` that the service knows (any of them); it is called only
        when something is published.
        """
        due_secs = self._published_secs + self._interval_secs
        if now_secs < due_secs and not (urgent or self._urgent):
            return due_secs - now_secs
        self._published_secs, self._urgent = now_secs, False
        self._bus.publish("status", self._key, encode(self._status(dict(build()))))
        return self._interval_secs

    def _status(self, fields: dict[str, Any]) -> Status:
        fields["totals"] = {**self.totals, **fields.get("totals", {})}
        fields["refused"] = _sum(self.refused, fields.get("refused", {}))
        fields["metrics"] = {**self._measure(), **fields.get("metrics", {})}
        fields["last_error"] = (fields.get("last_error") or self.last_error)[:LONGEST_TEXT]
        fields["waiting_for"] = fields.get("waiting_for", "")[:LONGEST_TEXT]
        fields = {"term": self.term, "phase": self.phase, **fields, **self._names, "seq": self._seq}
        self._seq += 1
        return Status.model_validate(fields)


def process_metrics() -> dict[str, float]:
    """This process's CPU seconds and resident memory in MB (10^6 bytes; the peak where there is no /proc)."""
    try:
        resident_bytes = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        resident_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"cpu_secs": process_time(), "rss_mb": resident_bytes / 1e6}


def _sum(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {str(name): one.get(name, 0) + other.get(name, 0) for name in {**one, **other}}
