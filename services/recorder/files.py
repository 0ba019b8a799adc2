"""The files of the data set: numbered, there whole or not at all, and never more than the checkpoint says."""

import logging
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from babble.recording import METADATA_KEY, STATES
from protocol.messages import Phase
from services.runtime.checkpoint import DRAFT_SUFFIX, refuse_storage, sync_folder, write_atomically
from services.runtime.errors import CheckpointError

log = logging.getLogger(__name__)

ROW_GROUP_ROWS = 65_536
"""Readers hold one row group at a time."""
PLACES = ("actor", "column", "term", "level", "iteration", "episode", "step")
MOST_UNFINISHED = 16
"""After a crash there are files of two checkpoints at most that the one gone on from knows nothing of."""
_NUMBERED = re.compile(r"part-(\d{6,})\.parquet")


class PartFiles:
    """`<run>/states/phase=<phase>/part-<number>.parquet`, written by one recorder at a time."""

    def __init__(self, run_dir: Path, schema: pa.Schema) -> None:
        self._folder = run_dir / STATES
        self._schema = schema

    def recover(self, files: int | None) -> None:
        """Delete what was written after the checkpoint, which knows the first `files`; None without one.

        Raises `CheckpointError` where a file is missing or of another run, and `StorageError`.
        """
        known = files or 0
        try:
            found = self._numbered()
            unknown = {number: path for number, path in found.items() if number >= known}
            self._check(found, known, len(unknown), 0 if files is None else MOST_UNFINISHED)
            for path in [*unknown.values(), *self._folder.glob(f"phase=*/.part-*{DRAFT_SUFFIX}")]:
                path.unlink()
        except OSError as error:
            refuse_storage(self._folder, error)
        if unknown:
            log.info(
                "deleted %d files that no checkpoint knows; their rows come from the spool", len(unknown)
            )

    def write(self, number: int, phase: Phase, table: pa.Table) -> int:
        """Write a file durably; returns its bytes. Raises `StorageError`; then it is not there."""
        sink = pa.BufferOutputStream()
        pq.write_table(
            table,
            sink,
            row_group_size=ROW_GROUP_ROWS,
            compression="zstd",
            compression_level=1,
            use_dictionary=list(PLACES),
            use_byte_stream_split=[name for name in self._schema.names if name not in PLACES],
            write_statistics=list(PLACES),
        )
        data = sink.getvalue()
        path = self._folder / f"phase={phase}" / f"part-{number:06d}.parquet"
        self._make(path.parent)
        write_atomically(path, [data])
        return int(data.size)

    def _make(self, folder: Path) -> None:
        if folder.is_dir():
            return
        try:
            folder.mkdir(parents=True, exist_ok=True)
            for above in (self._folder, self._folder.parent):
                sync_folder(above)
        except OSError as error:
            refuse_storage(folder, error)

    def _numbered(self) -> dict[int, Path]:
        paths = self._folder.glob("phase=*/part-*.parquet")
        return {int(match[1]): path for path in paths if (match := _NUMBERED.fullmatch(path.name))}

    def _check(self, found: dict[int, Path], files: int, unknown: int, most_unknown: int) -> None:
        missing = next((number for number in range(files) if number not in found), None)
        if missing is not None:
            raise CheckpointError(
                f"part-{missing:06d}.parquet, one of {files} files recorded so far, is missing in "
                f"{self._folder}; restore it from a backup, or start a new run"
            )
        if unknown > most_unknown:
            raise CheckpointError(
                f"{self._folder} holds {unknown} files that no checkpoint of this run's recorder knows; move "
                "the folder away, or restore the checkpoints that belong to it"
            )
        if files:
            self._check_schema(found[files - 1])

    def _check_schema(self, path: Path) -> None:
        try:
            schema = pq.read_schema(path)
        except (pa.ArrowException, OSError) as error:
            why = str(error).splitlines()[0]
            raise CheckpointError(f"{path} cannot be read ({why}); restore it, or start a new run") from None
        if (
            not schema.equals(self._schema)
            or schema.metadata.get(METADATA_KEY) != self._schema.metadata[METADATA_KEY]
        ):
            raise CheckpointError(
                f"{path} is of another run, or of other settings; go on with those, or start a new run"
            )
