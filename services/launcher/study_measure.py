"""Measures one run into its `coverage.json`: `python -m services.launcher.study_measure RUN --rows N`.

A process of its own, of low priority, so that the study's memory stays small and its runs are not held up.
Ends with 2 and a sentence for what another try would not change.
"""

import os
import sys
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from babble.coverage import coverage_curve, neighbour_ratios, spread_rows
from babble.recording import Audit, Recording, RecordingError
from services.launcher.records import Records
from services.launcher.run_folder import RunFolder
from services.launcher.study_measurement import Measurement
from services.launcher.timeline import timeline_of
from services.runtime.errors import UserError
from services.runtime.parser import OneLineParser
from services.runtime.process import guarded

NICENESS = 10
SEED = 0
"""Of what is drawn at random in the metrics: the same for all runs."""
DRAWN = 400
"""So many points of a distribution are kept for its figure."""
STATES = "states"


def measure(run_dir: Path, *, rows: int, curve: Sequence[int]) -> Measurement:
    """What is to be known of a completed run.

    Raises `UserError` if it is not fit to be measured: no recording, too few rows, rows that are there twice.
    """
    began_secs = time.monotonic()
    folder = RunFolder.find(str(run_dir))
    audit, states, names = _read(folder, rows)
    try:
        measured = coverage_curve(states, curve, seed=SEED)
        log_ratios, ranks = drawn_ratios(states)
    except ValueError as error:
        raise UserError(f"the states of {folder.shown} cannot be measured: {error}") from None
    one, other = (tuple(map(float, states[row])) for row in measured[-1].furthest_rows)
    settings, result = folder.settings(), folder.result()
    return Measurement(
        run=folder.run,
        scenario=settings.scenario,
        seed=settings.seed,
        rows=rows,
        recorded_rows=audit.rows,
        duplicates=audit.duplicates,
        gaps=audit.gaps,
        rows_by_phase={str(phase): count for phase, count in audit.rows_by_phase.items()},
        coverage=measured[-1],
        curve=tuple(measured),
        log_ratios=log_ratios,
        ranks=ranks,
        furthest=(one, other),
        state_names=names,
        trained_secs=round(timeline_of(Records(folder.path / "events.jsonl")).end_secs, 1),
        cpu_secs=round(sum(result.get("cpu_secs", {}).values()), 1),
        states_bytes=sum(file.stat().st_size for file in (folder.path / STATES).rglob("*.parquet")),
        measured_secs=round(time.monotonic() - began_secs, 1),
    )


def _read(folder: RunFolder, rows: int) -> tuple[Audit, NDArray[np.float32], tuple[str, ...]]:
    """What there is, the first `rows` states, and their names. Raises `UserError`."""
    try:
        recording = Recording.open(folder.path)
        audit = recording.audit()
        if audit.duplicates:
            raise UserError(f"{folder.shown} has {audit.duplicates:,} rows twice, so it is not measured")
        states = recording.states(most_rows=rows)
    except RecordingError as error:
        raise UserError(str(error)) from None
    if len(states) < rows:
        raise UserError(f"{folder.shown} has {len(states):,} rows, and {rows:,} are to be measured")
    return audit, states, tuple(recording.state_names)


def drawn_ratios(
    states: NDArray[np.float32], *, neighbour_rows: int = 6000
) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """log mu (eq. 23) of the states that dimensions are estimated from, thinned out, and their F (eq. 26).

    Raises ValueError as `neighbour_ratios` does.
    """
    ratios = neighbour_ratios(states[spread_rows(len(states), neighbour_rows, SEED)])
    places = np.unique(np.linspace(0, len(ratios) - 1, DRAWN).round().astype(int))
    ranks = (places + 0.5) / len(ratios)
    return tuple(map(float, np.log(ratios[places]))), tuple(map(float, ranks))


def main(argv: Sequence[str] | None = None) -> int:
    """Measure and write; returns the exit code."""
    parser = OneLineParser(prog="python -m services.launcher.study_measure", description=__doc__)
    parser.add_argument("run", type=Path)
    parser.add_argument("--rows", type=int, required=True)
    parser.add_argument("--curve", type=int, nargs="*", default=[])
    arguments = parser.parse_args(argv)

    def work() -> None:
        os.nice(NICENESS)
        found = measure(arguments.run, rows=arguments.rows, curve=[*arguments.curve, arguments.rows])
        found.write(arguments.run)
        print(f"measured {found.rows:,} states in {found.measured_secs:.0f} s", flush=True)

    return guarded("measure", work)


if __name__ == "__main__":
    sys.exit(main())
