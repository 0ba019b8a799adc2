"""A study as it lies on the disk, with numbers made by hand instead of runs."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from babble.coverage import Coverage
from services.launcher.run_folder import RunFolder
from services.launcher.study_folder import StudyFolder
from services.launcher.study_measurement import Measurement
from services.launcher.study_plan import Plan, parse_plan, runs_of
from services.runtime.settings import RunSettings, parse

NAMES = ("position/a", "position/b", "velocity/a", "velocity/b")


def plan_of(*ids: str, **changes: object) -> Plan:
    """A plan of conditions without changes, and what is said otherwise."""
    table: dict[str, object] = {"study": "play", "title": "A play", "base": "base.toml", "steps": 1000}
    table |= {"seeds": [0, 1], "condition": [{"id": each, "title": f"way {each}"} for each in ids]}
    return parse_plan({**table, **changes}, origin="here")


def base(**sections: object) -> RunSettings:
    """A scenario that records."""
    return parse({"scenario": "play", "recording": {"every_steps": 1}, **sections}, origin="here")


def coverage(rows: int = 1000, dims: int = 4, **numbers: float) -> Coverage:
    """Made up, with the numbers that matter."""
    made: dict[str, float] = {
        "diameter": 10.0,
        "bulk_diameter": 9.5,
        "projection_width": 9.0,
        "radius": 6.0,
        "box_diagonal": 14.0,
        "centre_first": 5.0,
        "centre_last": 1.0,
        "centre_sum": 200.0,
        "participation_ratio": 3.0,
        "bulk_participation_ratio": 3.1,
        "twonn": 2.5,
        "twonn_all": 2.4,
        "intrinsic_check": 2.6,
        "visited_cells_entropy": 4.0,
    }
    counts = {"rows": rows, "dims": dims, "seed": 0, "centres": 100, "neighbour_rows": 600, "duplicates": 0}
    listed = {"variances": tuple(float(dims - k) for k in range(dims)), "furthest_rows": (0, 1)}
    return Coverage.from_dict({**made, **numbers, **counts, **listed, "diameter_exact": False})


def measurement(found: Coverage | None = None, *, names: Sequence[str] = NAMES) -> Measurement:
    """Of a run whose coverage is known."""
    found = found or coverage(dims=len(names))
    ranks = (np.arange(400) + 0.5) / 400
    rng = np.random.default_rng(0)
    one, other = rng.normal(0, 0.3, (2, len(names)))
    return Measurement(
        run="play",
        scenario="play",
        seed=0,
        rows=found.rows,
        recorded_rows=found.rows + 20,
        duplicates=0,
        gaps=0,
        rows_by_phase={"babble": found.rows, "evaluate": 20},
        coverage=found,
        curve=(coverage(found.rows // 10, len(names), diameter=found.diameter / 2), found),
        log_ratios=tuple(map(float, -np.log(1 - ranks) / found.twonn)),
        ranks=tuple(map(float, ranks)),
        furthest=(tuple(map(float, one)), tuple(map(float, other))),
        state_names=tuple(names),
        trained_secs=120.0,
        cpu_secs=100.0,
        states_bytes=400_000,
        measured_secs=3.0,
    )


def lay(
    path: Path,
    plan: Plan,
    done: Mapping[str, Mapping[int, Measurement]],
    *,
    settings: RunSettings | None = None,
    steps: int = 1000,
) -> StudyFolder:
    """The folder of a study in which so many runs are done."""
    folder = StudyFolder(path)
    runs = runs_of(plan, settings or base(), steps=steps, seeds=plan.seeds)
    folder.prepare(plan, runs, steps)
    for run in runs:
        if (found := done.get(run.condition, {}).get(run.seed)) is not None:
            made = RunFolder.create(run.settings, folder.run_path(run), ["babble"])
            made.finish({"cpu_secs": {"actor": 1.0}})
            found.write(folder.run_path(run))
    return folder
