"""Which of the learners of its kind a process is, and which blocks are its own.

The blocks of a level may be shared among several processes of a kind. Each has an index and keeps its own
checkpoints; by the run's settings each block has exactly one of them (`RunSettings.learner_of`).
"""

import argparse
import fcntl
import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TextIO

from services.runtime.checkpoint import refuse_storage
from services.runtime.errors import CheckpointError
from services.runtime.models import ModelKind
from services.runtime.process import Context, Service
from services.runtime.settings import RunSettings, SettingsError

VARIABLE = "BABBLE_LEARNER_INDEX"
"""The environment variable with the index of a learner, for containers."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """The option `--index`."""
    parser.add_argument(
        "--index",
        type=_index,
        default=os.environ.get(VARIABLE) or 0,
        help=f"which learner of its kind this is, a number from 0 (default: ${VARIABLE}, else 0)",
    )


def numbered(build: Callable[[Context], Service]) -> Callable[[Context], Service]:
    """Builds the same service with the index of the command line."""
    return lambda context: build(replace(context, index=context.options.index))


def own_blocks(settings: RunSettings, kind: ModelKind, index: int) -> list[tuple[int, str]]:
    """(place among the run's blocks, name) of each block that this learner learns; perhaps none.

    Raises `SettingsError` for an index that the run has no learner of.
    """
    count = settings.learners.encoder if kind == "encoder" else settings.learners.policy
    if index >= count:
        there = "its only one has index 0" if count == 1 else f"their indices are 0 to {count - 1}"
        raise SettingsError(
            f"the run has no {kind} learner of index {index}: learners.{kind} is {count}, so {there}; "
            f"give --index (or ${VARIABLE}) one of those"
        )
    return [
        (place, block.name)
        for place, block in enumerate(settings.block)
        if settings.learner_of(block.name, kind) == index
    ]


def name_of(service: str, index: int) -> str:
    """What a learner's log, process and checkpoints are called: for the first of its kind as the service."""
    return f"{service}-{index}" if index else service


def claim(folder: Path) -> TextIO:
    """Hold a learner's folder for as long as the file returned is open, at most until the process ends.

    Raises `CheckpointError` while another one holds it, or both would write the same checkpoints and models,
    and `StorageError` if the disk refuses.
    """
    path = folder / "lock"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        file = path.open("a")
    except OSError as error:
        refuse_storage(path, error)
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        file.close()
        if not isinstance(error, BlockingIOError):
            refuse_storage(path, error)
        raise CheckpointError(
            f"another process is this learner already: it holds {path}; end it, or give this one an index of "
            f"its own by --index or ${VARIABLE}"
        ) from None
    return file


def _index(text: str) -> int:
    """What `--index` may be. Raises `argparse.ArgumentTypeError`."""
    if not (text.isascii() and text.isdecimal() and len(text) < 10):
        raise argparse.ArgumentTypeError(
            f"must be a whole number of at least 0, also where ${VARIABLE} gives it; got {text!r}"
        )
    return int(text)
