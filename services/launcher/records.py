"""Files of JSON lines that a run leaves, read a line at a time: they may be long, torn or still growing."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

Record = Mapping[str, Any]

LONGEST_LINE_BYTES = 1 << 20
"""What is longer is no record of ours, and is not held in memory."""
MOST = 2**53
MOST_SECS = 2.0**40
"""Times further from 1970 (35,000 years) are damaged."""


class Records:
    """The records of one file, in its order; none if there is no file. May be read again and again."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.skipped = 0
        """lines that were no records, in the last reading"""
        self.refusal = ""
        """why the file could not be read on, in the last reading; empty if it could"""

    def __iter__(self) -> Iterator[Record]:
        self.skipped, self.refusal = 0, ""
        try:
            with self.path.open("rb") as file:
                while line := file.readline(LONGEST_LINE_BYTES):
                    record = _record(line)
                    if record is not None:
                        yield record
                    elif line.endswith(b"\n") or len(line) == LONGEST_LINE_BYTES:
                        # A last line without its end is still being written, or was when the power went.
                        self.skipped += bool(line.strip())
        except FileNotFoundError:
            return
        except OSError as error:
            self.refusal = error.strerror or str(error)

    @property
    def trouble(self) -> str:
        """What the last reading had to leave out, as one sentence; empty if nothing."""
        if self.refusal:
            return f"`{self.path.name}` could not be read to its end ({self.refusal}); the rest is left out."
        if self.skipped:
            lines = "1 line" if self.skipped == 1 else f"{self.skipped:,} lines"
            return f"{lines} of `{self.path.name}` could not be read and were left out."
        return ""


def number(record: Record, name: str) -> float | None:
    """A number of a record; None where it is missing or something else."""
    value = record.get(name)
    if not isinstance(value, (int, float)) or isinstance(value, bool):
        return None
    try:
        return float(value)
    except OverflowError:
        return None


def moment(record: Record, name: str) -> float | None:
    """A time of a record; None where it is missing or none."""
    value = number(record, name)
    return value if value is not None and abs(value) < MOST_SECS else None


def count(record: Record, name: str) -> int | None:
    """A whole number of a record from 0 on; None where it is missing or something else."""
    value = record.get(name)
    is_count = isinstance(value, int) and not isinstance(value, bool) and 0 <= value <= MOST
    return value if is_count else None


def text(record: Record, name: str) -> str | None:
    """A line of text of a record; None where it is missing or something else."""
    value = record.get(name)
    return value if isinstance(value, str) and value.isprintable() else None


def table(record: Record, name: str) -> dict[str, float]:
    """The numbers of a record's table; empty where it is missing or something else."""
    found = record.get(name)
    if not isinstance(found, Mapping):
        return {}
    return {key: value for key in found if key.isprintable() and (value := number(found, key)) is not None}


def _record(line: bytes) -> Record | None:
    try:
        record = json.loads(line)
    except (ValueError, RecursionError):
        return None
    return record if isinstance(record, dict) else None
