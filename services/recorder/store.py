"""The rows on their way into files, and the checkpoint that knows which files there are.

The order that neither loses nor doubles a row, whatever is killed when: what is held lies in the spool; write
the files; save the checkpoint (the book, the number of files); then rotate the spool. A start deletes the
files beyond the checkpoint, and their rows come from the spool again.
"""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from protocol.messages import RECORDER, Phase, Segment
from services.recorder.columns import schema_of, table_of
from services.recorder.config import RecorderConfig
from services.recorder.files import PartFiles
from services.runtime.checkpoint import Checkpoints
from services.runtime.errors import CheckpointError
from services.runtime.sharing import claim
from services.runtime.spool import Spool

LONGEST_SPOOL_BYTES = 256 << 20
"""A spool this long becomes files before its time; about what is held in memory."""


class Store:
    """One run's data set, of one process at a time.

    Raises `CheckpointError` while another one holds it, `SpoolError` if the spool is damaged, and
    `StorageError` if the disk refuses.
    """

    def __init__(self, run_dir: Path, config: RecorderConfig) -> None:
        self._folder = run_dir / "checkpoints" / RECORDER
        self._claim = self._claimed()
        self._config, self._schema = config, schema_of(config)
        self._files = PartFiles(run_dir, self._schema)
        self._checkpoints = Checkpoints(self._folder)
        self.spool = Spool(self._folder)
        """Everything that is held has been appended to it and synced."""
        self._held: dict[Phase, list[Segment]] = {}
        self.held_rows = 0
        """rows that are in no file yet"""
        self.generation, self.files, self.size_bytes = 0, 0, 0
        """of the newest checkpoint; files written, and what they take"""

    @property
    def full(self) -> bool:
        """True if it is time to write."""
        return self.held_rows >= self._config.group_rows or self.spool.size_bytes > LONGEST_SPOOL_BYTES

    def hold(self, segment: Segment) -> None:
        """Keep the rows of a segment for the next file of its phase."""
        self._held.setdefault(segment.phase, []).append(segment)
        self.held_rows += segment.steps * segment.columns

    def write(self, book: Mapping[str, Any]) -> None:
        """Make files of all that is held, one for each phase, and a checkpoint that knows them and the book.

        The book is plain JSON-able data, of just the segments held so far. Raises `StorageError`.
        """
        for phase, segments in self._held.items():
            self.size_bytes += self._files.write(
                self.files, phase, table_of(segments, self._config, self._schema)
            )
            self.files += 1
        self._held, self.held_rows = {}, 0
        whole = {"book": book, "files": self.files, "bytes": self.size_bytes}
        self.generation += 1
        self._checkpoints.save(self.generation, {"recorder": json.dumps(whole).encode()})
        self.spool.rotate(self.generation)

    def resume(self) -> Mapping[str, Any] | None:
        """The book of the newest checkpoint, whose files alone are there afterwards; None at the first start.

        Raises `CheckpointError` for files that are damaged or of another run.
        """
        found = self._checkpoints.newest()
        if found is None:
            self._files.recover(None)
            return None
        self.generation, payload = found
        try:
            if isinstance(payload, bytes):
                raise TypeError("it has one part without a name")
            whole = json.loads(payload["recorder"])
            book: Mapping[str, Any] = whole["book"]
            self.files, self.size_bytes = int(whole["files"]), int(whole["bytes"])
        except (KeyError, TypeError, ValueError) as error:
            raise self.unreadable() from error
        self._files.recover(self.files)
        return book

    def unreadable(self) -> CheckpointError:
        """What to raise for a checkpoint whose bytes are whole and mean nothing here."""
        return CheckpointError(
            f"the checkpoint {self.generation} in {self._folder} was written by another version of Babble; "
            "go on with that one, or start a new run"
        )

    def _claimed(self) -> Any:
        try:
            return claim(self._folder)
        except CheckpointError:
            raise CheckpointError(
                f"another recorder is at work in {self._folder}; a run has one, so leave this one out"
            ) from None
