"""Killed, stopped, starved, broken or missing, the dashboard changes nothing for any other process."""

import json
import os
import re
import signal
import threading
import urllib.request
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

import psutil
import pytest

from services.coordinator.service import FAREWELL_SECS
from services.launcher.service import ONLOOKER_SECS
from tests.processes.distributed import RUN_SECS, WatchedRun
from tests.processes.owned import Owner, Process, wait_for

pytestmark = pytest.mark.processes

START_SECS = 60.0
SLACK_SECS = 2.0
"""What a busy machine may add to a wait."""
SCENARIO = """
scenario = "cuboid"
[phases]
babble_steps = 8192
ground_steps = 8192
walk_steps = 8192
practise_steps = 8192
iterations = 1
[encoder.encode]
updates = 200
[encoder.refine]
updates = 100
"""
FREE_PORTS = ("--dashboard-port", "0", "--dashboard-grpc-port", "0")
STARVED_SHARE = 0.02
STARVED_PERIOD_SECS = 0.5
WITHOUT_RERUN = """
import sys
if {condition}:
    sys.modules["rerun"] = None
"""

Up = Callable[..., Process]


@pytest.fixture
def up(owner: Owner, tmp_path: Path) -> Up:
    """Starts `babble up` of a short run into a folder of that name."""
    scenario = tmp_path / "cuboid.toml"
    scenario.write_text(SCENARIO)

    def start(name: str, *options: str, environment: dict[str, str] | None = None) -> Process:
        arguments = ("up", str(scenario), "--run-dir", str(tmp_path / name), *options)
        return owner.start("babble", "-m", "services.launcher", *arguments, environment=environment)

    return start


def dashboard_of(launcher: Process) -> psutil.Process | None:
    """The dashboard that a launcher started."""
    for child in psutil.Process(launcher.pid).children():
        try:
            if "services.dashboard" in child.cmdline():
                return child
        except psutil.Error:
            continue
    return None


def log_of(folder: Path, name: str) -> list[str]:
    path = folder / "logs" / f"{name}.log"
    return path.read_text().splitlines() if path.exists() else []


def wait_until_it_draws(folder: Path, lives: int = 1) -> None:
    ready: Callable[[], bool] = lambda: (  # noqa: E731
        sum("ready in run" in line for line in log_of(folder, "dashboard")) >= lives
    )
    wait_for(f"dashboard number {lives} to be ready", ready, START_SECS)


@contextmanager
def killed(launcher: Process, folder: Path) -> Iterator[None]:
    """kill -9; it comes back."""
    dashboard = dashboard_of(launcher)
    assert dashboard is not None
    dashboard.kill()
    launcher.expect("dashboard was killed by SIGKILL; it is started again", START_SECS)
    yield


@contextmanager
def stopped(launcher: Process, folder: Path) -> Iterator[None]:
    """Stopped as by a debugger, for the rest of the run."""
    dashboard = dashboard_of(launcher)
    assert dashboard is not None
    dashboard.suspend()
    yield
    assert not dashboard.is_running(), "it was left behind"


@contextmanager
def starved(launcher: Process, folder: Path) -> Iterator[None]:
    """Let run for a small share of the time only, as by `cpulimit`."""
    dashboard = dashboard_of(launcher)
    assert dashboard is not None
    over = threading.Event()

    def starve() -> None:
        running_secs = STARVED_SHARE * STARVED_PERIOD_SECS
        try:
            while not over.is_set():
                dashboard.suspend()
                over.wait(STARVED_PERIOD_SECS - running_secs)
                dashboard.resume()
                over.wait(running_secs)
        except psutil.NoSuchProcess:
            return

    starver = threading.Thread(target=starve)
    starver.start()
    try:
        yield
    finally:
        over.set()
        starver.join()


@pytest.mark.parametrize("harm", [killed, stopped, starved])
def test_whatever_happens_to_the_dashboard_the_others_do_not_notice(
    up: Up, tmp_path: Path, harm: Callable[[Process, Path], Iterator[None]]
) -> None:
    folder = tmp_path / "run"
    launcher = up("run", *FREE_PORTS)
    launcher.expect("dashboard  http://127.0.0.1:", START_SECS)
    wait_for("the folder", lambda: (folder / "run.json").exists() and (folder / "endpoint").exists())
    run = WatchedRun(
        json.loads((folder / "run.json").read_text())["run"],
        folder,
        (folder / "endpoint").read_text().strip(),
    )
    wait_until_it_draws(folder)
    with harm(launcher, folder):  # type: ignore[attr-defined]
        assert launcher.ended(RUN_SECS) == 0, launcher.report()
    run.close()
    assert len(run.scores()) == 4
    assert lost_members(folder) <= {"dashboard"}
    assert not [line for line in launcher.out if "started again" in line and "dashboard" not in line]
    run.assert_nothing_lost_or_counted_twice()
    assert all(status.lost == 0 for status in run.statuses().values())
    assert end_secs(folder) - done_secs(folder) < FAREWELL_SECS, "the coordinator waited for the dashboard"
    waited_secs = (folder / "result.json").stat().st_mtime - end_secs(folder)
    assert waited_secs < ONLOOKER_SECS + SLACK_SECS, "the launcher waited for the dashboard"


def milestones(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]


def done_secs(folder: Path) -> float:
    return next(float(event["secs"]) for event in milestones(folder) if event["text"].startswith("done"))


def lost_members(folder: Path) -> set[str]:
    """The services of those who went before the run was done."""
    lost = [event for event in milestones(folder) if event["what"] == "lost"]
    return {event["text"].rpartition("-")[0] for event in lost if event["secs"] < done_secs(folder)}


def end_secs(folder: Path) -> float:
    """When the coordinator, the last whom the run needs, had finished."""
    line = next(line for line in log_of(folder, "coordinator") if line.endswith(" finished"))
    return datetime.fromisoformat(line.split()[0]).timestamp()


def test_two_runs_at_once_both_have_a_dashboard(up: Up, tmp_path: Path) -> None:
    launchers = {name: up(name) for name in ("one", "two")}
    urls = {name: said_url(launcher) for name, launcher in launchers.items()}
    assert urls["one"] != urls["two"]
    for name, url in urls.items():
        run = json.loads((tmp_path / name / "run.json").read_text())["run"]
        wait_for(f"the page of {name}", lambda url=url, run=run: run in page(f"{url}/run"), START_SECS)
        assert (tmp_path / name / "dashboard").read_text().strip() == url
    for launcher in launchers.values():
        launcher.interrupt(signal.SIGINT)
    for launcher in launchers.values():
        assert launcher.ended() == 128 + signal.SIGINT, launcher.report()
        assert not any("goes on without it" in line for line in launcher.out), launcher.report()


def said_url(launcher: Process) -> str:
    found = re.search(r"http://[\d.]+:\d+", launcher.expect("dashboard  http://", START_SECS))
    assert found is not None
    return found[0]


def page(url: str) -> str:
    """What is served there, nothing as long as nothing is."""
    try:
        with urllib.request.urlopen(url, timeout=5.0) as answer:
            return str(answer.read().decode())
    except OSError:
        return ""


def test_where_rerun_is_not_installed_the_run_goes_on_without_a_dashboard(up: Up, tmp_path: Path) -> None:
    launcher = up("run", environment=without_rerun(tmp_path, "True"))
    said = launcher.expect("dashboard  ", START_SECS)
    assert "rerun-sdk is not installed" in said
    assert "babble doctor" in said
    launcher.expect("GROUND", RUN_SECS)
    launcher.interrupt(signal.SIGINT)
    assert launcher.ended() == 128 + signal.SIGINT, launcher.report()
    assert not (tmp_path / "run" / "dashboard").exists()
    assert not (tmp_path / "run" / "logs" / "dashboard.log").exists()


def test_a_dashboard_that_cannot_start_is_given_up_and_the_run_goes_on(up: Up, tmp_path: Path) -> None:
    broken = without_rerun(tmp_path, '"services.dashboard" in sys.orig_argv')
    launcher = up("run", *FREE_PORTS, environment=broken)
    launcher.expect("the run goes on without it", RUN_SECS)
    wait_for("the address to be gone", lambda: not (tmp_path / "run" / "dashboard").exists())
    launcher.interrupt(signal.SIGINT)
    assert launcher.ended() == 128 + signal.SIGINT, launcher.report()


def without_rerun(folder: Path, condition: str) -> dict[str, str]:
    """The environment of an interpreter in which, on a condition, the package is not there."""
    (folder / "sitecustomize.py").write_text(WITHOUT_RERUN.format(condition=condition))
    return {"PYTHONPATH": os.pathsep.join([str(folder), os.getcwd()])}
