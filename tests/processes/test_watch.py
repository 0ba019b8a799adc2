"""`babble prepare` and `babble watch` as containers use them: the run's processes are somebody else's."""

import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from services.launcher.cli import main
from services.runtime import health
from tests.processes.owned import Owner, Process, RunningRouter, free_port, wait_for
from tests.processes.test_up import RUN_SECS, START_SECS, TINY, refused, table
from tests.unit.analytic_run import good, write_run

pytestmark = pytest.mark.processes

LEAVE_SECS = 2.0
SERVICES = ("coordinator", "encoder_learner", "policy_learner", "actor", "actor")

Babble = Callable[..., Process]


@pytest.fixture
def babble(owner: Owner) -> Babble:
    """Starts `babble <arguments>`."""

    def start(*arguments: str | Path) -> Process:
        return owner.start("babble", "-m", "services.launcher", *map(str, arguments))

    return start


@pytest.mark.slow
def test_a_run_by_hand_is_prepared_watched_from_two_sides_and_reported(
    owner: Owner, babble: Babble, tmp_path: Path
) -> None:
    endpoint, folder = f"tcp/127.0.0.1:{free_port()}", tmp_path / "mine"
    (tmp_path / "tiny.toml").write_text(TINY.replace("iterations = 1", "iterations = 2"))
    prepared = babble("prepare", tmp_path / "tiny.toml", "--run", "mine", "--runs", tmp_path, "--seed", "")
    assert prepared.ended(START_SECS) == 0, prepared.report()
    near = babble("watch", folder, "--connect", endpoint, "--report")
    far = babble("watch", "mine", "--connect", endpoint)
    near.expect(f"no router answered at {endpoint}", START_SECS)
    router = RunningRouter(owner, endpoint)
    for service in SERVICES:
        where = ("--run-dir", str(folder), "--connect", endpoint)
        told = {health.VARIABLE: str(tmp_path / f"{service}.health")}
        owner.start(service, "-m", f"services.{service}", *where, environment=told)
    wait_for("the first word on its health", (tmp_path / "actor.health").exists, START_SECS)
    assert health.main([str(tmp_path / "actor.health")]) == 0
    near.expect("WALK 1 of 2", RUN_SECS)
    router.kill()
    router.start_again()
    near.expect("the router is back", START_SECS)
    assert near.ended(RUN_SECS) == 0, near.report()
    assert far.ended(START_SECS) == 0, far.report()
    assert sum("actor-" in line and line.endswith("is there") for line in near.out) >= 2
    assert len(table(near.out)) == 6
    assert table(near.out) == table(far.out), "the coordinator told what the folder says"
    assert f"all files are in {folder}; read report.md first" in near.out
    assert "unfinished" not in (folder / "report.md").read_text()
    assert "policy_learner-" in (folder / "report.md").read_text().partition("CPU seconds")[2]
    assert not (folder / "endpoint").exists(), "a watcher changed the run"


def test_a_completed_run_is_told_at_once_and_reported_if_it_is_not_yet(
    babble: Babble, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "run", [good()])
    assert main(["watch", str(folder)]) == 0
    said = capsys.readouterr().out
    assert said.startswith(f"the run {folder} is completed already")
    assert not (folder / "report.md").exists()
    (folder / "report.md").write_text("**This run is unfinished**")
    first = babble("watch", folder, "--report")
    assert first.ended(START_SECS) == 0, first.report()
    assert table(first.out) == table(said.splitlines())
    assert first.out[-1] == f"all files are in {folder}; read report.md first"
    assert "unfinished" not in (folder / "report.md").read_text()
    written = (folder / "report.md").stat().st_mtime_ns
    again = babble("watch", folder, "--report")
    assert again.ended(START_SECS) == 0
    assert (folder / "report.md").stat().st_mtime_ns == written


def test_it_leaves_at_once_with_or_without_a_router(
    owner: Owner, babble: Babble, router: RunningRouter
) -> None:
    numbers = (signal.SIGTERM, signal.SIGINT)
    nobody = f"tcp/127.0.0.1:{free_port()}"
    unlinked = [(babble("watch", "nosuch", "--connect", nobody), number) for number in numbers]
    linked = [(babble("watch", "nosuch", "--connect", router.endpoint), number) for number in numbers]
    for watcher, _ in unlinked:
        watcher.expect("no router answered", START_SECS)
    # With nothing to hear it says after a while that it waits, so it is listening by then.
    for watcher, _ in linked:
        watcher.expect("waiting for the coordinator", START_SECS)
    for watcher, number in unlinked + linked:
        asked_secs = time.monotonic()
        watcher.interrupt(number)
        assert watcher.ended(LEAVE_SECS) == 128 + number, watcher.report()
        assert time.monotonic() - asked_secs < LEAVE_SECS
        assert watcher.err == []
        assert watcher.out[-1] == "no longer watching; the run goes on"


INTERRUPTED = """
import os, signal, sys

class Interrupter:
    def find_spec(self, name, path=None, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGTERM)

sys.meta_path.insert(0, Interrupter())
from services.launcher.cli import main
main(["watch", sys.argv[2], "--report"])
print("went on")
"""


def test_docker_stop_during_the_report_leaves_no_half_of_it(owner: Owner, tmp_path: Path) -> None:
    places = ("matplotlib", "matplotlib.backends.backend_agg", "pyarrow")
    folders = [write_run(tmp_path / f"run-{i}", [good()]) for i in range(len(places))]
    started = [
        owner.start_code("watch", INTERRUPTED, where, str(folder))
        for where, folder in zip(places, folders, strict=True)
    ]
    for process, folder in zip(started, folders, strict=True):
        assert process.ended(START_SECS) == 128 + signal.SIGTERM, process.report()
        assert process.err == []
        assert process.out[-1] == f"the report was not written; babble report {folder} does it later"
        assert not list(folder.rglob("*.draft"))


def test_what_cannot_be_watched_is_one_sentence_and_code_2(babble: Babble, tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()], phase="walk (level 0, iteration 1, term 5)")
    started = {
        r"is not the folder of a run": babble("watch", tmp_path),
        r"is not going on here; go on with `babble up --resume": babble("watch", folder),
        r"--report writes into the run's folder": babble(
            "watch", "mine", "--connect", "tcp/127.0.0.1:1", "--report"
        ),
        r"tls/127\.0\.0\.1:1 needs a credential": babble("watch", folder, "--connect", "tls/127.0.0.1:1"),
        r"neither a run's folder nor a run's name": babble(
            "watch", "No Name", "--connect", "tcp/127.0.0.1:1"
        ),
        r"there is no credential": babble(
            "status", "mine", "--connect", "tls/127.0.0.1:1", "--credential", tmp_path / "none.pem"
        ),
    }
    for sentence, process in started.items():
        refused(process, sentence)
