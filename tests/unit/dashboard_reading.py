"""Reads recordings back: entities, rows, times and values, as a program of somebody else would."""

import subprocess
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pyarrow as pa
from rerun.chunk import RrdReader

from services.dashboard.viewer_files import quiet_environment, rerun_program

VERIFY_SECS = 60.0


@dataclass(frozen=True)
class Row:
    """One row of an entity."""

    entity: str
    run_secs: float | None
    """None for static rows"""
    env_steps: int | None
    values: dict[str, Any]
    """by component, such as "Scalars:scalars"; only those that the row has"""


def rows_of(paths: Iterable[Path], entity: str = "") -> list[Row]:
    """All rows, or those of one entity, in the order of the files and their times."""
    found = [row for path in paths for row in _rows(path) if entity in ("", row.entity)]
    return sorted(found, key=lambda row: -1.0 if row.run_secs is None else row.run_secs)


def scalars(paths: Iterable[Path], entity: str) -> list[float]:
    """The numbers of a line."""
    rows = rows_of(paths, entity)
    return [row.values["Scalars:scalars"][0] for row in rows if "Scalars:scalars" in row.values]


def states(paths: Iterable[Path], entity: str) -> list[str]:
    """The states of a lane, repeats left out."""
    said: list[str] = []
    for row in rows_of(paths, entity):
        state = row.values.get("StateChange:state")
        if state and said[-1:] != [state[0]]:
            said.append(state[0])
    return said


def documents(paths: Iterable[Path], entity: str) -> list[str]:
    """The texts of a document."""
    return [
        row.values["TextDocument:text"][0]
        for row in rows_of(paths, entity)
        if "TextDocument:text" in row.values
    ]


def parts_of(run_dir: Path) -> list[Path]:
    """The files of a run's recording, in order."""
    return sorted((run_dir / "recording").glob("*.rrd"))


def verified(path: Path, home: Path) -> bool:
    """Whether rerun finds nothing wrong with a file; it writes nothing but into `home`."""
    home.mkdir(exist_ok=True)
    found = subprocess.run(
        [rerun_program(), "rrd", "verify", path],
        env=quiet_environment(home),
        capture_output=True,
        timeout=VERIFY_SECS,
        check=False,
    )
    return found.returncode == 0


def _rows(path: Path) -> Iterable[Row]:
    for chunk in RrdReader(str(path)).stream().to_chunks():
        batch = chunk.to_record_batch()
        columns = {name: batch.column(name) for name in batch.schema.names if ":" in name}
        times = _numbers(batch, "run_time"), _numbers(batch, "env_steps")
        for index in range(batch.num_rows):
            values = {name: column[index].as_py() for name, column in columns.items()}
            present = {name: value for name, value in values.items() if value is not None}
            nanos, steps = (None if numbers is None else numbers[index] for numbers in times)
            yield Row(str(chunk.entity_path), None if nanos is None else nanos / 1e9, steps, present)


def _numbers(batch: pa.RecordBatch, name: str) -> list[int] | None:
    """A timeline as integers (nanoseconds, steps); None if the rows are not on it."""
    return batch.column(name).cast(pa.int64()).to_pylist() if name in batch.schema.names else None
