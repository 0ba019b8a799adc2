"""`babble up` as a person uses it: real processes, the shipped command line."""

import json
import os
import re
import signal
import socket
import time
from collections.abc import Callable
from pathlib import Path

import psutil
import pytest

from tests.processes.owned import Owner, Process, wait_for
from tests.unit.analytic_run import good, write_run

pytestmark = pytest.mark.processes

TINY = """
scenario = "tiny"
[phases]
babble_steps = 2048
ground_steps = 2048
walk_steps = 2048
practise_steps = 2048
iterations = 1
[encoder.encode]
updates = 30
[encoder.refine]
updates = 20
[evaluation]
columns = 8
legs = 3
leg_steps = 20
"""
RUN_SECS = 150.0
STOP_SECS = 5.0
START_SECS = 30.0
FREE_PORTS = ("--dashboard-port", "0", "--dashboard-grpc-port", "0")

Babble = Callable[..., Process]


@pytest.fixture
def babble(owner: Owner) -> Babble:
    """Starts `babble <arguments>`."""

    def start(*arguments: str | Path) -> Process:
        return owner.start("babble", "-m", "services.launcher", *map(str, arguments))

    return start


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """A scenario of a few seconds."""
    path = tmp_path / "tiny.toml"
    path.write_text(TINY)
    return path


def services(launcher: Process) -> dict[str, list[psutil.Process]]:
    """The running services of a launcher, by name."""
    found: dict[str, list[psutil.Process]] = {}
    for child in psutil.Process(launcher.pid).children():
        if child.status() != psutil.STATUS_ZOMBIE and (
            name := re.search(r"services\.(\w+)", " ".join(child.cmdline()))
        ):
            found.setdefault(name[1], []).append(child)
    return found


def table(lines: list[str]) -> list[list[str]]:
    """The last table of scores that was printed."""
    start = max(index for index, line in enumerate(lines) if line.split()[:2] == ["iter", "policy"])
    return [line.split() for line in lines[start + 1 :] if line.split()[1:2] in (["mean"], ["sampled"])]


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        (None, r"there is no scenario .*nosuch.*; give .* cuboid, .*dumbbell, ellipsoid"),
        ('scenario = "x"\nspeeed = 1\n', r"speeed: is not a known key"),
        ('scenario = "x"\n[[block]]\nlatent_dim = 1\n', r"latent_dim: .* greater than or equal to 2, got 1"),
        ('scenario = "x"\n[world]\nid = "Torus"\n', r"no world 'Torus'; the worlds are Cuboid"),
        ('scenario = "x"\n[world]\nparameters = { speed = -1.0 }\n', r"speed must be a positive number"),
        ("scenario", r"is not valid TOML"),
    ],
)
def test_a_wrong_scenario_is_one_sentence_and_code_2(
    babble: Babble, tmp_path: Path, text: str | None, sentence: str
) -> None:
    path = tmp_path / "nosuch.toml"
    if text is not None:
        path.write_text(text)
    refused(babble("up", path, "--run-dir", tmp_path / "run"), sentence)
    assert not (tmp_path / "run").exists()


def test_wrong_arguments_are_one_sentence_and_code_2(babble: Babble, tiny: Path, tmp_path: Path) -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = str(holder.getsockname()[1])
        busy = f"tcp/127.0.0.1:{port}"
        started = {
            r"--actors: must be a whole number of at least 1, got '0'": babble("up", tiny, "--actors", "0"),
            r"cannot listen at tcp/127\.0\.0\.1:\d+ .*in use": babble("up", tiny, "--listen", busy),
            r"cannot write .*tiny\.toml/run": babble("up", tiny, "--run-dir", tiny / "run"),
            r"is not the folder of a run": babble("up", "--resume", tmp_path),
            r"give a scenario": babble("up"),
            r"--dashboard-port \d+: cannot listen at .*in use.*choose another port": babble(
                "up", tiny, "--dashboard-port", port, "--run-dir", tmp_path / "run"
            ),
            r"--dashboard-port: must be a whole number from 0 to 65535": babble(
                "up", tiny, "--dashboard-port", "65536"
            ),
            r"--no-dashboard leaves no dashboard": babble(
                "up", tiny, "--no-dashboard", "--dashboard-grpc-port", "0"
            ),
            r"not a run's name|is not the folder of a run": babble("status", tmp_path),
            r"no router answered at": babble("status", "some-run", "--connect", "tcp/127.0.0.1:1"),
        }
        for sentence, process in started.items():
            refused(process, sentence)
    assert not (tmp_path / "run").exists(), "a port is refused before there is a folder"


def test_a_run_survives_a_killed_actor_tells_its_status_and_dashboard_and_shows_its_scores(
    babble: Babble, tiny: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run = babble("up", tiny, "--actors", "3", "--run-dir", folder, *FREE_PORTS)
    url = run.expect("dashboard  http://127.0.0.1:", START_SECS).split()[1]
    run.expect("BABBLE", START_SECS)
    services(run)["actor"][0].kill()
    status = babble("status", folder)
    assert status.ended(START_SECS) == 0, status.report()
    assert status.out[0].startswith("run tiny-")
    assert status.out[1] == f"dashboard {url}"
    assert sum(bool(re.match(r"actor-[0-9a-f]{8} .* s ", line)) for line in status.out) >= 2, status.report()
    assert any("sent again" in line for line in status.out)
    second = babble("up", "--resume", folder)
    refused(second, "is going on in another process")
    assert run.ended(RUN_SECS) == 0, run.report()
    assert any("was killed by SIGKILL; it is started again" in line for line in run.out)
    assert [row[:2] for row in table(run.out)] == [
        ["0", "mean"],
        ["0", "sampled"],
        ["1", "mean"],
        ["1", "sampled"],
    ]
    assert any(line.startswith("best of body: ") for line in run.out)
    result = json.loads((folder / "result.json").read_text())
    assert set(result["cpu_secs"]) == {
        *("router", "coordinator", "encoder_learner", "policy_learner", "dashboard", "launcher"),
        *("actor-0", "actor-1", "actor-2"),
    }
    assert (folder / "report.md").stat().st_size > 0
    assert list((folder / "recording").glob("*.rrd")), "the dashboard recorded nothing"
    assert run.out[-1] == f"see it again with: babble view {folder}"
    assert not (folder / "dashboard").exists(), "it tells an address where nobody is"
    assert not (folder / "endpoint").exists(), "it tells an address where nobody is"
    again = babble("up", "--resume", folder)
    assert again.ended(START_SECS) == 0
    assert "is completed already" in again.out[0]
    assert table(again.out) == table(run.out)


def test_ctrl_c_ends_everything_within_5_s_leaves_a_report_and_resume_completes(
    babble: Babble, tiny: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    run = babble("up", tiny, "--run-dir", folder, *FREE_PORTS)
    run.expect("GROUND", RUN_SECS)
    started = [process for group in services(run).values() for process in group]
    assert len(started) == 7
    asked_secs = time.monotonic()
    run.interrupt(signal.SIGINT)
    run.expect(f"stopped; go on with: babble up --resume {folder}", STOP_SECS)
    assert time.monotonic() - asked_secs < STOP_SECS
    assert all(gone(process) for process in started)
    assert run.ended(START_SECS) == 128 + signal.SIGINT
    assert "**This run is unfinished**" in (folder / "report.md").read_text()
    assert not (folder / "result.json").exists()
    resumed = babble("up", "--resume", folder, "--no-dashboard")
    assert resumed.ended(RUN_SECS) == 0, resumed.report()
    assert not (folder / "dashboard").exists(), "it tells an address where nobody is"
    assert not any(line.endswith(" BABBLE") for line in resumed.out), "it began anew"
    assert len(table(resumed.out)) == 4


def test_sigterm_is_code_143_and_a_killed_launcher_takes_its_processes_with_it(
    babble: Babble, tiny: Path, tmp_path: Path
) -> None:
    ended = babble("up", tiny, "--run-dir", tmp_path / "ended", "--no-dashboard")
    ended.expect("BABBLE", START_SECS)
    ended.interrupt(signal.SIGTERM)
    assert ended.ended(STOP_SECS) == 128 + signal.SIGTERM
    killed = babble("up", tiny, "--run-dir", tmp_path / "killed", *FREE_PORTS)
    killed.expect("BABBLE", START_SECS)
    started = [process for group in services(killed).values() for process in group]
    assert len(started) == 7
    os.kill(killed.pid, signal.SIGKILL)
    wait_for("all processes to be gone", lambda: all(gone(process) for process in started), STOP_SECS)


def test_what_a_service_finds_wrong_is_told_and_ends_the_run(
    babble: Babble, tiny: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    first = babble("up", tiny, "--run-dir", folder, "--no-dashboard")
    first.expect("BABBLE", START_SECS)
    first.interrupt()
    first.ended(STOP_SECS)
    journal = folder / "journal.jsonl"
    journal.write_text("rubbish\n" + journal.read_text())
    refused(
        babble("up", "--resume", folder, "--no-dashboard"),
        r"coordinator: line 1 of .*journal\.jsonl is damaged",
        START_SECS,
    )
    assert "This run is unfinished" in (folder / "report.md").read_text()


INTERRUPTED = """
import os, signal, sys
from pathlib import Path

class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Interrupter())
from services.launcher.run_folder import RunFolder
from services.launcher.up import _report_so_far
_report_so_far(RunFolder.find(sys.argv[2]), 130)
print("went on")
"""


@pytest.mark.parametrize(
    "where",
    ["numpy.random", "matplotlib", "matplotlib.ft2font", "matplotlib.backends.backend_agg", "pyarrow"],
)
def test_ctrl_c_during_the_report_is_one_sentence_wherever_it_hits(
    owner: Owner, tmp_path: Path, where: str
) -> None:
    folder = write_run(tmp_path / "run", [good()])
    process = owner.start_code("report", INTERRUPTED, where, str(folder))
    assert process.ended(START_SECS) == 128 + signal.SIGINT, process.report()
    assert process.err == []
    assert process.out[-1] == f"the report was not written; babble report {folder} does it later"
    assert not list(folder.rglob("*.draft"))


def refused(process: Process, sentence: str, within_secs: float = START_SECS) -> None:
    """It ended with code 2, having said one sentence and no traceback."""
    assert process.ended(within_secs) == 2, process.report()
    assert len(process.err) == 1, process.report()
    assert re.search(sentence, process.err[0]), process.err[0]


def gone(process: psutil.Process) -> bool:
    """True if it has ended, whether or not anybody has asked how."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True
