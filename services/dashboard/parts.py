"""The recording on disk: files of which the oldest go first; a disk that refuses ends only the recording."""

import contextlib
import logging
import re
from collections.abc import Callable
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.copying import CopiedFile, end

log = logging.getLogger(__name__)

PART_BYTES = 32_000_000
OVERSHOOT = 1.5
"""A part may end larger than it should by so much: it is measured at a flush, and its index comes last."""
LEAST_PARTS = 4
"""The bound holds so many parts at least: a small bound makes smaller parts."""
FLUSH_SECS = 20.0
"""A crash loses so much of the recording at most. Flushed more often, it would be mostly heads of chunks."""
FLUSH_DEADLINE_SECS = 2.0
NAME = re.compile(r"run-(\d{3,})\.rrd")


class Parts:
    """Opens, flushes, changes and deletes the files `run-001.rrd`, `run-002.rrd`... in a folder.

    They have an index at their end (write_footer): what Rerun holds in memory for it is that of one part.
    """

    def __init__(
        self,
        folder: Path,
        bound_bytes: int,
        *,
        new_stream: Callable[[], rr.RecordingStream],
        blueprint: rrb.Blueprint,
    ) -> None:
        self.stream: rr.RecordingStream | None = None
        """Where to log what goes to the file; None once the disk has refused."""
        self.opened = 0
        """parts begun by this process"""
        self.deleted = 0
        """parts deleted to keep within the bound"""
        self.errors = 0
        self.last_error = ""
        self._folder = folder
        self._bound_bytes = bound_bytes
        self._part_bytes = min(PART_BYTES, bound_bytes // LEAST_PARTS)
        self._new_stream, self._blueprint = new_stream, blueprint
        self._next_flush_secs = float("-inf")
        self._old_bytes = 0
        self._file: CopiedFile | None = None

    @property
    def bytes(self) -> int:
        """What the parts in the folder take."""
        return self._old_bytes + (0 if self._file is None else self._file.bytes)

    def open(self, now_secs: float) -> bool:
        """Begin a part; False if the disk refuses. Its stream has no times and no data yet."""
        self._next_flush_secs = now_secs + FLUSH_SECS
        try:
            self._folder.mkdir(parents=True, exist_ok=True)
            self._make_room()
            self._file = CopiedFile(self._folder / f"run-{self._last_number() + 1:03d}.rrd")
        except OSError as error:
            self._refuse(error.strerror or str(error))
            return False
        self.stream = self._new_stream()
        self.stream.set_sinks(self._file.sink(), default_blueprint=self._blueprint)
        self._file.opened()
        self.opened += 1
        return True

    def flush_if_due(self, now_secs: float) -> bool:
        """Write what is due; True if the part is full and another should be opened."""
        if self.stream is None or self._file is None:
            return False
        if self._file.error:
            self._refuse(self._file.error)
            return False
        if now_secs < self._next_flush_secs:
            return False
        self._next_flush_secs = now_secs + FLUSH_SECS
        self._flush()
        return self.stream is not None and self._file.bytes >= self._part_bytes

    def close(self) -> None:
        """Finish the part that is being written."""
        if self.stream is None or self._file is None:
            return
        self._flush()
        if self.stream is not None:
            end(self.stream, FLUSH_DEADLINE_SECS)
            self._file.wait(FLUSH_DEADLINE_SECS)
            self.stream = None
        if self._file.error and not self.last_error:
            self._refuse(self._file.error)

    def _flush(self) -> None:
        assert self.stream is not None
        try:
            self.stream.flush(timeout_sec=FLUSH_DEADLINE_SECS)
        except (RuntimeError, ValueError):
            self._refuse(f"the disk takes longer than {FLUSH_DEADLINE_SECS:.0f} s")

    def _make_room(self) -> None:
        """Delete the oldest parts until there is room for a new one within the bound."""
        parts = sorted(
            (number, path) for path in self._folder.iterdir() if (number := _number(path)) is not None
        )
        sizes = {path: _size(path) for _, path in parts}
        for _, path in parts:
            if sum(sizes.values()) + OVERSHOOT * self._part_bytes <= self._bound_bytes:
                break
            path.unlink(missing_ok=True)
            del sizes[path]
            self.deleted += 1
            log.info("deleted %s to keep the recording within %.0f MB", path, self._bound_bytes / 1e6)
        self._old_bytes = sum(sizes.values())

    def _last_number(self) -> int:
        return max(
            (number for path in self._folder.iterdir() if (number := _number(path)) is not None), default=0
        )

    def _refuse(self, reason: str) -> None:
        self.errors += 1
        self.last_error = (
            f"nothing more is recorded in {self._folder} ({reason.lower()}); what you see here goes on; "
            "make room there, and end the dashboard so that it is started again"
        )
        log.error("%s", self.last_error)
        stream, self.stream = self.stream, None
        if stream is not None:
            end(stream, FLUSH_DEADLINE_SECS)


def _number(path: Path) -> int | None:
    found = NAME.fullmatch(path.name)
    return int(found[1]) if found else None


def _size(path: Path) -> int:
    with contextlib.suppress(OSError):
        return path.stat().st_size
    return 0
