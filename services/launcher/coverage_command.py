"""`babble coverage RUN`: the metrics of one run; `babble coverage --table1`: the table of the study."""

import argparse
import json
from pathlib import Path

from babble.coverage import Coverage, coverage
from babble.recording import Recording, RecordingError
from services.launcher.config import at_least
from services.launcher.run_folder import RunFolder
from services.launcher.study_folder import STATES, StudyFolder
from services.launcher.study_measurement import Measurement, read_measurement
from services.launcher.study_table import METRICS, estimates_of, table_lines
from services.runtime.errors import UserError

STUDY = Path("runs") / "table1"
HEAD_WIDTH = 18


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble coverage`."""
    parser.add_argument("run", nargs="?", metavar="RUN", help="a run folder, or the name of one under runs/")
    parser.add_argument(
        "--steps",
        type=at_least(2),
        metavar="N",
        help="only of the first N environment steps, evaluations left out (default: of all)",
    )
    parser.add_argument(
        "--seed", type=at_least(0), default=0, metavar="S", help="of what is drawn at random (default: 0)"
    )
    parser.add_argument("--json", action="store_true", help="print it as JSON")
    parser.add_argument(
        "--table1", action="store_true", help="print the table of a study beside the thesis's"
    )
    parser.add_argument(
        "--folder", type=Path, metavar="D", help=f"the study's folder, with --table1 (default: {STUDY})"
    )


def run(arguments: argparse.Namespace) -> int:
    """Print what was asked for; returns 0. Raises `UserError`."""
    if arguments.table1:
        if arguments.run is not None:
            raise UserError("--table1 is of a study, not of a run; leave out RUN, or give --folder")
        return _table(StudyFolder.find(arguments.folder or STUDY), as_json=arguments.json)
    if arguments.run is None or arguments.folder is not None:
        raise UserError("give the run to measure, for example `babble coverage runs/RUN`, or --table1")
    folder = RunFolder.find(arguments.run)
    if not (folder.path / STATES).exists() and (kept := read_measurement(folder.path)) is not None:
        found = _kept(folder, kept, arguments.steps, arguments.seed)
        return _say(found, "as measured before its states went", arguments)
    found, every = measured(folder, steps=arguments.steps, seed=arguments.seed)
    return _say(found, "" if every == 1 else f"one of {every} environment steps", arguments)


def measured(folder: RunFolder, *, steps: int | None, seed: int) -> tuple[Coverage, int]:
    """The coverage of a run's recorded states, and the steps from one to the next. Raises `UserError`."""
    try:
        recording = Recording.open(folder.path)
        rows = None if steps is None else steps // recording.every_steps
        states = recording.states(most_rows=rows)
    except RecordingError as error:
        raise UserError(str(error)) from None
    if rows is not None and len(states) < rows:
        raise UserError(
            f"{folder.shown} has recorded {len(states) * recording.every_steps:,} environment steps outside "
            f"evaluations, fewer than --steps {steps:,}"
        )
    try:
        return coverage(states, seed=seed), recording.every_steps
    except ValueError as error:
        raise UserError(f"the states of {folder.shown} cannot be measured: {error}") from None


def _kept(folder: RunFolder, kept: Measurement, steps: int | None, seed: int) -> Coverage:
    """What a study measured of so many steps. Raises `UserError` if it did not."""
    if seed != kept.coverage.seed:
        raise UserError(f"the states of {folder.shown} are gone, so no other --seed can be had")
    every = folder.settings().recording.every_steps
    by_steps = {each.rows * every: each for each in kept.curve}
    wanted = max(by_steps) if steps is None else steps
    if wanted not in by_steps:
        known = ", ".join(f"{each:,}" for each in by_steps)
        raise UserError(f"the states of {folder.shown} are gone; it was measured after {known} steps only")
    return by_steps[wanted]


def _say(found: Coverage, remark: str, arguments: argparse.Namespace) -> int:
    if arguments.json:
        print(json.dumps(found.as_dict(), indent=2))
        return 0
    about = f"{found.rows:,} states of {found.dims} numbers"
    lines = [f"{arguments.run}: {', '.join(filter(None, (about, remark)))}", ""]
    for metric in METRICS:
        value = f"{getattr(found, metric.name):,.{metric.digits}f}"
        lines.append(f"{metric.head:<{HEAD_WIDTH}}{value:>10}  {metric.words}")
    lines += [
        "",
        "Distances are in the states' own units (of joints: rad and rad/s mixed). Dimensions are estimated "
        f"from {found.neighbour_rows:,} states.",
        "docs/coverage.md defines each metric and says what it cannot tell.",
    ]
    print("\n".join(lines))
    return 0


def _table(folder: StudyFolder, *, as_json: bool) -> int:
    plan, steps, _ = folder.plan()
    measurements, missing = folder.measurements(), folder.missing()
    estimates = estimates_of(measurements)
    if as_json:
        table = {
            condition: {
                name: {"mean": one.mean, "deviation": one.deviation, "seeds": dict(one.values)}
                for name, one in metrics.items()
            }
            for condition, metrics in estimates.items()
        }
        print(json.dumps({"steps": steps, "conditions": table, "missing": missing}, indent=2))
        return 0
    print(f"{plan.title}\n{steps:,} environment steps; mean ± standard deviation over the seeds\n")
    print("\n".join(table_lines(plan, estimates)))
    done = sum(map(len, measurements.values()))
    print(f"\n{done} of {done + len(missing)} runs are done")
    if missing:
        print(f"missing: {', '.join(missing)}")
    return 0
