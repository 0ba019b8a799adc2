"""Checkpoints that are there whole or not at all; what they hold is the learner's own bytes.

A file is one line of JSON (generation, names and sizes of the parts, SHA-256) and then the parts.
It is written beside its place, synced, renamed, and the folder synced: a kill at any point leaves
the previous checkpoint or the new one. Nothing is unpickled.
"""

import contextlib
import hashlib
import json
import logging
import os
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import BinaryIO, NoReturn, TypedDict

from services.runtime.errors import CheckpointError, StorageError

log = logging.getLogger(__name__)

Payload = bytes | dict[str, bytes]
SUFFIX = ".checkpoint"
DRAFT_SUFFIX = ".draft"
LONGEST_HEADER_BYTES = 1 << 20


class Checkpoints:
    """The newest `keep` checkpoints in a folder, one file per generation (1, 2, ...)."""

    def __init__(self, folder: Path, keep: int = 2) -> None:
        if keep < 1:
            raise ValueError(f"at least one checkpoint must be kept, got keep={keep}")
        self._folder = folder
        self._keep = keep
        self._unreadable: set[Path] = set()

    def save(self, generation: int, payload: bytes | Mapping[str, bytes]) -> None:
        """Write a checkpoint durably, then delete the oldest beyond `keep`. Raises `StorageError`.

        `generation` is one more than the one loaded or saved last, whatever else lies in the folder.
        """
        named = {"": payload} if isinstance(payload, bytes) else dict(payload)
        digest = hashlib.sha256()
        for part in named.values():
            digest.update(part)
        header = {
            "generation": generation,
            "single": isinstance(payload, bytes),
            "parts": [[name, len(part)] for name, part in named.items()],
            "sha256": digest.hexdigest(),
        }
        path = self._folder / f"{generation:08d}{SUFFIX}"
        write_atomically(path, [json.dumps(header).encode() + b"\n", *named.values()])
        self._unreadable.discard(path)
        self._prune()

    def newest(self) -> tuple[int, Payload] | None:
        """The generation and payload of the newest checkpoint that is whole; None if there is none.

        A damaged one is skipped with a logged sentence. Raises `CheckpointError` if all are damaged.
        """
        paths = self._paths()
        for path in reversed(paths):
            try:
                found = _read(path)
            except (OSError, ValueError) as error:
                self._unreadable.add(path)
                log.error("skipping the damaged checkpoint %s: %s", path, error)
                continue
            return found
        if not paths:
            return None
        raise CheckpointError(
            f"no checkpoint in {self._folder} can be read ({', '.join(path.name for path in paths)}); "
            "restore one from a backup, or start a new run"
        )

    def _paths(self) -> list[Path]:
        return sorted(path for path in self._folder.glob(f"*{SUFFIX}") if path.stem.isdecimal())

    def _prune(self) -> None:
        whole = [path for path in self._paths() if path not in self._unreadable]
        abandoned = self._folder.glob(f".*{SUFFIX}.*{DRAFT_SUFFIX}")
        for path in [*self._unreadable, *whole[: -self._keep], *abandoned]:
            path.unlink(missing_ok=True)
        self._unreadable.clear()


def write_atomically(path: Path, data: bytes | Iterable[bytes]) -> None:
    """Replace a file by new contents, durably: readers see the old or the new, never a part.

    Raises `StorageError` if the disk is full or refuses; the old file is then still there.
    """
    draft = path.with_name(f".{path.name}.{os.getpid()}{DRAFT_SUFFIX}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with draft.open("wb") as file:
            for part in [data] if isinstance(data, bytes) else data:
                file.write(part)
            file.flush()
            os.fsync(file.fileno())
        draft.replace(path)
        sync_folder(path.parent)
    except OSError as error:
        # Where a parent is a file, there is no draft, and looking for it fails as the writing did.
        with contextlib.suppress(OSError):
            draft.unlink()
        refuse_storage(path, error)


def sync_folder(folder: Path) -> None:
    """Make renames and new files in a folder durable. Raises OSError."""
    handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def refuse_storage(path: Path, error: OSError) -> NoReturn:
    """Raise the `StorageError` that tells a person about a failed write."""
    raise StorageError(
        f"cannot write {path}: {error.strerror or error}; nothing unwritten was acknowledged, "
        "so make room there (or repair it) and start the process again"
    ) from error


class _Header(TypedDict):
    generation: int
    single: bool
    parts: list[tuple[str, int]]
    sha256: str


def _read(path: Path) -> tuple[int, Payload]:
    with path.open("rb") as file:
        header = _read_header(file)
        parts: dict[str, bytes] = {}
        digest = hashlib.sha256()
        for name, size in header["parts"]:
            part = file.read(size)
            if len(part) != size:
                raise ValueError(f"it ends {size - len(part)} bytes early")
            digest.update(part)
            parts[name] = part
        if file.read(1):
            raise ValueError("it has bytes after its end")
    if digest.hexdigest() != header["sha256"]:
        raise ValueError("its bytes do not have the SHA-256 that it states")
    return header["generation"], parts[""] if header["single"] else parts


def _read_header(file: BinaryIO) -> _Header:
    line = file.readline(LONGEST_HEADER_BYTES)
    try:
        header = json.loads(line)
        return {
            "generation": int(header["generation"]),
            "single": bool(header["single"]),
            "parts": [(str(name), int(size)) for name, size in header["parts"]],
            "sha256": str(header["sha256"]),
        }
    except (ValueError, KeyError, TypeError):
        raise ValueError("its first line is not a checkpoint's header") from None
