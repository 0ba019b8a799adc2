"""An open loop by `babble up`: its processes are killed, and no row is lost or doubled."""

import signal
from pathlib import Path

import pytest

from babble.recording import Recording
from services.launcher.run_folder import RunFolder
from tests.processes.owned import Owner, Process, wait_for
from tests.processes.test_up import START_SECS, STOP_SECS, services

pytestmark = pytest.mark.processes

SCENARIO = """
scenario = "loop"
[actors]
count = 2
segment_steps = 32
[phases]
open_loop = true
babble_steps = {steps}
[recording]
every_steps = 1
group_rows = 8192
"""
RUN_SECS = 120.0


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return tmp_path / "run"


def up(owner: Owner, folder: Path, steps: int) -> Process:
    scenario = folder.parent / "loop.toml"
    scenario.write_text(SCENARIO.format(steps=steps))
    options = ("--run-dir", str(folder), "--no-dashboard")
    return owner.start("up", "-m", "services.launcher", "up", str(scenario), *options)


def was_told(run: Process, name: str) -> bool:
    return any(
        f"  {name}" in line and "was killed by SIGKILL; it is started again" in line for line in run.out
    )


def parts(folder: Path) -> int:
    return len(list(folder.glob("states/*/part-*.parquet")))


def check(folder: Path, steps: int) -> None:
    audit = Recording.open(folder).audit()
    assert (audit.duplicates, audit.gaps) == (0, 0)
    assert steps <= audit.rows <= steps + 2048
    assert RunFolder.find(str(folder)).result()


def test_whoever_is_killed_an_open_loop_goes_on_to_its_end_with_every_row_once(
    owner: Owner, folder: Path
) -> None:
    steps = 600_000
    run = up(owner, folder, steps)
    run.expect("BABBLE", START_SECS)
    for count, name in ((2, "recorder"), (6, "coordinator"), (10, "actor")):
        wait_for(f"{count} files", lambda count=count: parts(folder) >= count, RUN_SECS)  # type: ignore[misc]
        services(run)[name][0].kill()
        wait_for(f"word of the killed {name}", lambda name=name: was_told(run, name), START_SECS)  # type: ignore[misc]
    assert run.ended(RUN_SECS) == 0, run.report()
    check(folder, steps)
    said = " ".join(run.out)
    assert "nothing is learned in an open loop" in said
    assert "babble coverage" in said
    assert not services_named(folder, "learner"), "nobody was there to learn"


def test_an_open_loop_that_is_stopped_goes_on_where_it_was(owner: Owner, folder: Path) -> None:
    steps = 400_000
    run = up(owner, folder, steps)
    wait_for("3 files", lambda: parts(folder) >= 3, RUN_SECS)
    run.interrupt()
    assert run.ended(STOP_SECS + 10.0) == 128 + signal.SIGTERM, run.report()
    assert not RunFolder.find(str(folder)).result()
    again = owner.start("again", "-m", "services.launcher", "up", "--resume", str(folder), "--no-dashboard")
    assert again.ended(RUN_SECS) == 0, again.report()
    check(folder, steps)


def services_named(folder: Path, what: str) -> list[str]:
    return [path.stem for path in (folder / "logs").glob("*.log") if what in path.stem]
