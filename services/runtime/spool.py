"""Accepted frames since the last checkpoints, on disk: a killed learner loses nothing it acknowledged.

The order that makes it so: `append` each accepted frame, `sync`, only then acknowledge; save the
checkpoint, then `rotate`. A file `<generation>-<part>.spool` holds what was accepted after the
checkpoint of that generation. Files are kept for as many checkpoints as `Checkpoints` keeps, so
falling back to the previous checkpoint replays everything since that one.

A record is length, CRC-32 of the frame, CRC-32 of these eight bytes, and the frame.
"""

import logging
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from services.runtime.checkpoint import refuse_storage, sync_folder
from services.runtime.errors import SpoolError

log = logging.getLogger(__name__)

SUFFIX = ".spool"
_LENGTH_AND_CRC = struct.Struct("<II")
_HEAD_CRC = struct.Struct("<I")
_HEAD_BYTES = _LENGTH_AND_CRC.size + _HEAD_CRC.size


class Spool:
    """Append-only files in a folder, of one learner at a time."""

    def __init__(self, folder: Path, keep: int = 2) -> None:
        """Opens the newest file and cuts off a record that a kill left incomplete.

        Raises `StorageError` if the folder cannot be written, `SpoolError` if the file is damaged.
        """
        self._folder = folder
        self._keep = keep
        self._handle = -1
        self._unsynced = False
        self.size_bytes = 0
        """Bytes in the file being written, about what a restart replays; a reason to checkpoint early."""
        try:
            folder.mkdir(parents=True, exist_ok=True)
            paths = self._paths()
            if paths:
                _cut_torn_tail(paths[-1])
            self._open(paths[-1] if paths else self._path(0, 0))
        except OSError as error:
            refuse_storage(folder, error)

    def append(self, frame: bytes) -> None:
        """Write a frame; it is safe only after `sync`. Raises `StorageError`; then nothing was written."""
        head = _LENGTH_AND_CRC.pack(len(frame), zlib.crc32(frame))
        record = head + _HEAD_CRC.pack(zlib.crc32(head)) + frame
        self._unsynced = True
        try:
            written = 0
            while written < len(record):
                written += os.write(self._handle, memoryview(record)[written:])
        except OSError as error:
            os.ftruncate(self._handle, self.size_bytes)
            refuse_storage(self._current, error)
        self.size_bytes += len(record)

    def sync(self) -> None:
        """Make all appended frames safe. Raises `StorageError`; nothing appended may then be acknowledged."""
        if not self._unsynced:
            return
        try:
            os.fsync(self._handle)
        except OSError as error:
            refuse_storage(self._current, error)
        self._unsynced = False

    def replay(self, from_generation: int = 0) -> Iterator[bytes]:
        """The frames appended since the checkpoint of this generation, in order.

        Call it once after loading a checkpoint and before appending. Raises `SpoolError` on reaching
        a damaged record.
        """
        paths = [path for path in self._paths() if _generation(path) >= from_generation]
        if not paths:
            self._start_file(from_generation)
        elif _generation(paths[0]) > from_generation:
            missing = self._path(from_generation, 0)
            log.error("%s is missing: what was accepted after that checkpoint is lost", missing)
        return (frame for path in paths for frame in _frames(path))

    def rotate(self, generation: int) -> None:
        """Start the file of this generation and delete what no kept checkpoint needs.

        Call it once the checkpoint of this generation is durable; that must hold the effect of every
        frame appended so far. Raises `StorageError`.
        """
        older = max(0, generation - 1)
        try:
            for path in self._paths():
                if _generation(path) >= generation > 0:
                    path.rename(self._path(older, self._next_part(older)))
            self._start_file(generation)
            for path in self._paths():
                if _generation(path) <= generation - self._keep:
                    path.unlink()
        except OSError as error:
            refuse_storage(self._folder, error)

    def close(self) -> None:
        """Close the file; idempotent."""
        if self._handle >= 0:
            os.close(self._handle)
            self._handle = -1

    def _start_file(self, generation: int) -> None:
        self.close()
        self._open(self._path(generation, self._next_part(generation)))

    def _open(self, path: Path) -> None:
        self._current = path
        self._handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self.size_bytes = os.fstat(self._handle).st_size
        self._unsynced = False
        sync_folder(self._folder)

    def _paths(self) -> list[Path]:
        return sorted(self._folder.glob(f"{'[0-9]' * 8}-{'[0-9]' * 4}{SUFFIX}"))

    def _path(self, generation: int, part: int) -> Path:
        return self._folder / f"{generation:08d}-{part:04d}{SUFFIX}"

    def _next_part(self, generation: int) -> int:
        parts = [int(path.stem.split("-")[1]) for path in self._paths() if _generation(path) == generation]
        return max(parts, default=-1) + 1


def _generation(path: Path) -> int:
    return int(path.stem.split("-")[0])


def _cut_torn_tail(path: Path) -> None:
    whole_bytes = sum(_HEAD_BYTES + len(frame) for frame in _frames(path))
    torn_bytes = path.stat().st_size - whole_bytes
    if torn_bytes:
        log.warning("%s ended in %d bytes of a frame that was never acknowledged; cut off", path, torn_bytes)
        os.truncate(path, whole_bytes)


def _frames(path: Path) -> Iterator[bytes]:
    """The whole records of a file; a torn last one (or, after a power cut, zeros) is left out.

    Raises `SpoolError`.
    """
    with path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        place = 0
        while (frame := _next_frame(file, place, size, path)) is not None:
            place += _HEAD_BYTES + len(frame)
            yield frame


def _next_frame(file: BinaryIO, place: int, size: int, path: Path) -> bytes | None:
    head = file.read(_HEAD_BYTES)
    if len(head) < _HEAD_BYTES:
        return None
    length, crc = _LENGTH_AND_CRC.unpack_from(head)
    (head_crc,) = _HEAD_CRC.unpack_from(head, _LENGTH_AND_CRC.size)
    if zlib.crc32(head[: _LENGTH_AND_CRC.size]) == head_crc:
        frame = file.read(length)
        if zlib.crc32(frame) == crc and len(frame) == length:
            return frame
        if place + _HEAD_BYTES + length >= size:
            return None
    elif not any(head) and not any(file.read()):
        return None
    raise SpoolError(
        f"{path} is damaged at byte {place} of {size}, so acknowledged segments after it cannot be read; "
        "restore the file from a backup, or delete it and restart all actors to go on without them"
    )
