"""`coverage.json` of a run: all that a study needs of it, so that its states may go."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from babble.coverage import Coverage
from services.runtime.checkpoint import write_atomically
from services.runtime.errors import UserError

FILE = "coverage.json"
FORMAT = 1


class MeasurementError(UserError, ValueError):
    """A `coverage.json` that cannot be used; the text is one sentence for a person."""


@dataclass(frozen=True, kw_only=True)
class Measurement:
    """What was measured of one run."""

    run: str
    scenario: str
    seed: int
    """of the run"""
    rows: int
    """that were measured: the first of the recording, evaluations left out"""
    recorded_rows: int
    """all that there are, evaluations too"""
    duplicates: int
    """rows of the recording that are there twice; more than 0 is never measured"""
    gaps: int
    """steps inside a stream that are missing"""
    rows_by_phase: Mapping[str, int]
    coverage: Coverage
    curve: tuple[Coverage, ...]
    """of growing first parts; the last is the whole"""
    log_ratios: tuple[float, ...]
    """log mu (eq. 23) at evenly spaced places of its distribution, rising"""
    ranks: tuple[float, ...]
    """the F_i (eq. 26) that belong to them"""
    furthest: tuple[tuple[float, ...], tuple[float, ...]]
    """the two states that lie furthest apart"""
    state_names: tuple[str, ...]
    trained_secs: float
    """that the run was running"""
    cpu_secs: float
    """of all its processes, in its last launch"""
    states_bytes: int
    """of its data set"""
    measured_secs: float
    """how long this took"""

    def write(self, folder: Path) -> None:
        """Into the run's folder. Raises `StorageError`."""
        table = {"format": FORMAT, **asdict(self)}
        write_atomically(folder / FILE, json.dumps(table).encode() + b"\n")


def read_measurement(folder: Path) -> Measurement | None:
    """Of a run's folder; None if it was not measured yet. Raises `MeasurementError`."""
    path = folder / FILE
    try:
        table = json.loads(path.read_bytes())
    except FileNotFoundError:
        return None
    except (OSError, ValueError) as error:
        raise MeasurementError(f"cannot read {path} ({error}); delete it to measure the run anew") from None
    try:
        return _measurement(table)
    except (KeyError, TypeError, ValueError) as error:
        raise MeasurementError(
            f"{path} is not of this version of babble ({error}); delete it to measure the run anew"
        ) from None


def _measurement(table: Any) -> Measurement:
    if table.pop("format") != FORMAT:
        raise ValueError(f"not of format {FORMAT}")
    one, other = table["furthest"]
    read = {
        "coverage": Coverage.from_dict(table["coverage"]),
        "curve": tuple(Coverage.from_dict(each) for each in table["curve"]),
        "log_ratios": tuple(table["log_ratios"]),
        "ranks": tuple(table["ranks"]),
        "furthest": (tuple(one), tuple(other)),
        "state_names": tuple(table["state_names"]),
    }
    return Measurement(**{**table, **read})
