"""One process's health and progress, published each interval and at once when something changed."""

import json
import logging
import os
import resource
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from protocol import keys
from protocol.codec import encode
from protocol.messages import ALL_BLOCKS, Phase, Status
from protocol.refusal import Reason
from services.runtime.health import VARIABLE

log = logging.getLogger(__name__)

LONGEST_TEXT = 2000
HEALTH_SECS = 1.0
"""The health file is written so often at most."""


class Voice(Protocol):
    """What a heart asks of a bus."""

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """See `Bus.publish`."""
        ...

    def linked(self) -> bool:
        """See `Bus.linked`."""
        ...


class Heart:
    """Publishes the `Status` of a process; it also keeps the totals and refusals that a service gives it.

    Where the environment has `BABBLE_HEALTH=FILE` it keeps there what `health.py` tells.
    """

    def __init__(
        self,
        bus: Voice,
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
        path = os.environ.get(VARIABLE)
        self._health = _HealthFile(Path(path), interval_secs) if path else None

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
        status = self._status(dict(build()))
        self._bus.publish("status", self._key, encode(status))
        if self._health is not None:
            self._health.note(status, linked=self._bus.linked())
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


class _HealthFile:
    """What was published last, for `health.py`; a disk that refuses is told once and harms nothing."""

    def __init__(self, path: Path, interval_secs: float) -> None:
        self._path = path
        # Several processes may be given one file, and each writes it whole.
        self._draft = path.parent / f".{path.name}.{os.getpid()}.draft"
        self._interval_secs = interval_secs
        self._written_secs = float("-inf")
        self._unlinked_secs: float | None = None
        self._refused = False

    def note(self, status: Status, *, linked: bool) -> None:
        """Write it, if it is time. Times are the machine's monotonic clock, which no other process sets."""
        now_secs = time.monotonic()
        self._unlinked_secs = None if linked else self._unlinked_secs or now_secs
        if now_secs < self._written_secs + HEALTH_SECS:
            return
        self._written_secs = now_secs
        record = status.model_dump(
            mode="json", include={"run", "service", "life", "phase", "waiting_for", "last_error"}
        )
        times = {"published_secs": now_secs, "unlinked_secs": self._unlinked_secs}
        record |= {**times, "interval_secs": self._interval_secs}
        try:
            self._draft.write_text(json.dumps(record), encoding="utf-8")
            self._draft.replace(self._path)
        except OSError as error:
            with suppress(OSError):
                self._draft.unlink(missing_ok=True)
            if not self._refused:
                log.warning(
                    "cannot write %s (%s), so that nobody can tell from it whether this process is well",
                    self._path,
                    error.strerror,
                )
            self._refused = True


def process_metrics() -> dict[str, float]:
    """This process's CPU seconds and resident memory in MB (10^6 bytes; the peak where there is no /proc)."""
    try:
        resident_bytes = int(Path("/proc/self/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    except OSError:
        resident_bytes = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return {"cpu_secs": time.process_time(), "rss_mb": resident_bytes / 1e6}


def _sum(one: Mapping[str, int], other: Mapping[str, int]) -> dict[str, int]:
    return {str(name): one.get(name, 0) + other.get(name, 0) for name in {**one, **other}}
