"""The coordinator's memory on disk: the events that changed its state, one line of JSON each.

An event is written before its orders are carried out. The first line names the run and its plan.
A last line without its end was never acted upon, so it is dropped and overwritten; a damaged line
anywhere else is an error for a person.
"""

import fcntl
import json
import os
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from services.coordinator.machine import decide
from services.coordinator.state import Plan, State
from services.coordinator.words import (
    Event,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    Started,
    StatusReported,
    StopRequested,
    Ticked,
)
from services.runtime.checkpoint import refuse_storage, sync_folder
from services.runtime.errors import UserError

FORMAT = 1
"""Of the journal file; raised when an old reader would misread a new line."""

_EVENTS: dict[str, TypeAdapter[Event]] = {
    event.__name__: TypeAdapter(event)
    for event in (Started, Ticked, StatusReported, MemberAppeared, MemberVanished, LinkChanged, StopRequested)
}


class JournalError(UserError):
    """The journal is damaged, or of another run; nothing was changed."""


class Journal:
    """An open journal file, positioned behind its last whole line.

    `events` are those of earlier processes. Raises `JournalError` if the file is damaged, belongs to
    another run or plan, or is held by another coordinator, and `StorageError` if the disk refuses.
    """

    def __init__(self, path: Path, run: str, plan: Plan) -> None:
        self._path = path
        try:
            self._file = path.open("ab+", buffering=0)
            self._lock()
            self.events = self._open(run, plan)
        except OSError as error:
            refuse_storage(path, error)
        except JournalError:
            self._file.close()
            raise

    def append(self, event: Event) -> None:
        """Write an event so that it survives a power cut. Raises `StorageError` if the disk refuses."""
        try:
            self._write({"event": type(event).__name__, "said": asdict(event)})
        except OSError as error:
            refuse_storage(self._path, error)

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()

    def _lock(self) -> None:
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise JournalError(
                f"another coordinator is writing {self._path}; end that one, or give this one another run"
            ) from None

    def _open(self, run: str, plan: Plan) -> tuple[Event, ...]:
        self._file.seek(0)
        whole, end, _torn = self._file.read().rpartition(b"\n")
        if whole:
            events = tuple(_read(self._path, whole.split(b"\n"), run, plan))
            self._file.truncate(len(whole) + len(end))
            return events
        self._file.truncate(0)
        self._write(_header(run, plan))
        sync_folder(self._path.parent)
        return ()

    def _write(self, record: dict[str, Any]) -> None:
        line = json.dumps(record, separators=(",", ":"), allow_nan=False).encode() + b"\n"
        written = self._file.write(line)
        if written != len(line):
            raise OSError(None, "the disk took only a part of the line")
        os.fsync(self._file.fileno())


def replay(plan: Plan, events: Iterable[Event]) -> State:
    """The state to which the events lead."""
    state = State()
    for event in events:
        state, _ = decide(plan, state, event)
    return state


def parse(line: bytes) -> Event:
    """The event of one line. Raises ValueError or pydantic's ValidationError (a ValueError)."""
    record = json.loads(line)
    if not isinstance(record, dict) or set(record) != {"event", "said"} or record["event"] not in _EVENTS:
        raise ValueError("not an event of the coordinator")
    return _EVENTS[record["event"]].validate_python(record["said"])


def _read(path: Path, lines: list[bytes], run: str, plan: Plan) -> Iterable[Event]:
    _check_header(path, lines[0], run, plan)
    for number, line in enumerate(lines[1:], start=2):
        try:
            yield parse(line)
        except (ValueError, RecursionError) as error:
            what = "not a known event" if isinstance(error, ValidationError) else str(error)
            raise _damaged(path, number, what) from None


def _header(run: str, plan: Plan) -> dict[str, Any]:
    levels = [list(level) for level in plan.levels]
    header = {"journal": FORMAT, "run": run, "levels": levels, "iterations": list(plan.iterations)}
    return header | ({"open_loop": True} if plan.open_loop else {})


def _check_header(path: Path, line: bytes, run: str, plan: Plan) -> None:
    try:
        found = json.loads(line)
    except (ValueError, RecursionError):
        found = None
    wanted = {"open_loop": False, **_header(run, plan)}
    if isinstance(found, dict) and found:
        found.setdefault("open_loop", False)  # said only where it is true, and of old not at all
    if not isinstance(found, dict) or set(found) != set(wanted):
        raise _damaged(path, 1, "not a journal's header")
    if isinstance(found["iterations"], int):  # as it was written while all levels had the same number
        found["iterations"] = [found["iterations"]] * len(plan.levels)
    for name, value in wanted.items():
        if found[name] != value:
            raise JournalError(
                f"{path} was begun with {name} = {found[name]!r}, and now it is {value!r}; "
                "resume it with its own settings or start a new run"
            )


def _damaged(path: Path, number: int, what: str) -> JournalError:
    return JournalError(
        f"line {number} of {path} is damaged ({what}); put back a copy of the journal or start a new run"
    )
