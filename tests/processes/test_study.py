"""A small study as a person runs it: killed twice, stopped once, and every step there once in the end."""

import json
import signal
from pathlib import Path

import psutil
import pytest

from babble.recording import Recording
from services.launcher.study_folder import StudyFolder
from tests.processes.owned import Owner, Process, wait_for

pytestmark = [pytest.mark.processes, pytest.mark.slow, pytest.mark.timeout(1500)]

STEPS = 20_000
BASE = """
scenario = "tiny"
[world]
id = "Cuboid"
[actors]
count = 1
[phases]
babble_steps = 4096
ground_steps = 6144
walk_steps = 2048
practise_steps = 4096
iterations = 1
[encoder.encode]
updates = 30
[encoder.refine]
updates = 20
[evaluation]
columns = 8
legs = 3
leg_steps = 20
[recording]
every_steps = 1
group_rows = 1024
"""
STUDY = f"""
study = "small"
title = "A small study"
base = "base.toml"
steps = {STEPS}
seeds = [0, 1]
curve = [5000]
[[condition]]
id = "L"
title = "learns"
[[condition]]
id = "N"
title = "noise"
change = {{ phases = {{ open_loop = true }}, babbling = {{ kind = "white", scale = 1.0 }} }}
"""
RUNS = ("N-seed0", "L-seed0", "N-seed1", "L-seed1")
RUN_SECS = 400.0
STOP_SECS = 40.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Where the runs will be; the study lies beside it."""
    (tmp_path / "base.toml").write_text(BASE)
    (tmp_path / "small.toml").write_text(STUDY)
    return tmp_path / "out"


def start(owner: Owner, folder: Path) -> Process:
    """The one command."""
    plan = folder.parent / "small.toml"
    arguments = ("study", str(plan), "--folder", str(folder), "--jobs", "2")
    return owner.start("study", "-m", "services.launcher", *arguments)


def files(folder: Path, run: str, phase: str) -> int:
    """So many files of a phase's data are there."""
    return len(list((folder / run / "states" / f"phase={phase}").glob("part-*.parquet")))


def kill_all(study: Process) -> None:
    """kill -9 of the study; all that it started goes with it."""
    started = psutil.Process(study.pid).children(recursive=True)
    study.kill()
    _, left = psutil.wait_procs(started, timeout=20)
    assert not left


def is_halfway(folder: Path, run: str, phase: str, least: int) -> bool:
    """So many files of a phase are there, and the run is not completed."""
    return files(folder, run, phase) >= least and not (folder / run / "result.json").exists()


def test_killed_and_stopped_in_the_middle_a_study_goes_on_and_no_step_is_there_twice(
    owner: Owner, folder: Path
) -> None:
    first = start(owner, folder)
    wait_for("a noise halfway", lambda: is_halfway(folder, "N-seed0", "babble", 3), RUN_SECS)
    kill_all(first)
    assert not (folder / "N-seed0" / "coverage.json").exists()

    second = start(owner, folder)
    wait_for("a learner in practice", lambda: is_halfway(folder, "L-seed0", "ground", 2), RUN_SECS)
    kill_all(second)

    third = start(owner, folder)
    wait_for("a run that is measured", (folder / "N-seed0" / "coverage.json").exists, RUN_SECS)
    measured_at = (folder / "N-seed0" / "coverage.json").stat().st_mtime_ns
    third.interrupt(signal.SIGTERM)
    assert third.ended(STOP_SECS) == 128 + signal.SIGTERM
    assert any("go on with: babble study" in line for line in third.out)

    last = start(owner, folder)
    assert last.ended(RUN_SECS * 2) == 0, last.report()
    assert (folder / "N-seed0" / "coverage.json").stat().st_mtime_ns == measured_at
    for run in RUNS:
        audit = Recording.open(folder / run).audit()
        assert audit.duplicates == 0
        assert audit.gaps == 0
        assert audit.rows - audit.rows_by_phase.get("evaluate", 0) >= STEPS
        table = json.loads((folder / run / "coverage.json").read_text())
        assert (table["rows"], table["duplicates"]) == (STEPS, 0)
        assert [each["rows"] for each in table["curve"]] == [5000, STEPS]
    # The kills fell into the middle of runs: more than one life has recorded.
    assert any(len(Recording.open(folder / run).audit().actors) > 1 for run in RUNS)
    report = (folder / "report" / "report.md").read_text()
    assert "4 of 4 runs are done" in report
    assert StudyFolder(folder).missing() == []
