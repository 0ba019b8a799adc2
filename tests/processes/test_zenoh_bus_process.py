"""The one loop as a real process: how a service ends, in order and out of order."""

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from protocol import keys
from services.runtime.bus import Inbox, Membership, Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, Process, RunningRouter, free_port, wait_for

pytestmark = pytest.mark.processes

SERVICE = """
import sys
from services.runtime.bus import Inbox
from services.runtime.errors import StorageError
from services.runtime.process import run_process

class Service:
    def __init__(self, context, mood):
        self.mood, self.stops, self.polls = mood, 0, 0
        context.bus.subscribe("phase", "babble/r/phase", Inbox(context.wakeup))

    def poll(self, now_secs):
        self.polls += 1
        if self.polls == 2:
            print("polling", flush=True)
        if self.mood == "finish" and self.polls > 3:
            return None
        if self.mood == "bug" and self.polls > 3:
            raise ZeroDivisionError("no such luck")
        if self.mood == "full" and self.polls > 3:
            raise StorageError("cannot write /disk: No space left on device")
        if self.stops and self.mood == "orderly" and self.polls > 20:
            print("in order after", self.stops, "stop", flush=True)
            return None
        return 0.02

    def stop(self):
        self.stops += 1

mood = sys.argv.pop(1)
sys.exit(run_process("encoder_learner", lambda context: Service(context, mood)))
"""


@pytest.fixture(scope="module")
def router() -> Iterator[RunningRouter]:
    """One for all: nothing of a test is left once its processes have ended."""
    with Owner() as owner:
        yield owner.router()


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    (tmp_path / "run.json").write_text('{"run": "r"}')
    (tmp_path / "config.toml").write_text('scenario = "cuboid"\n[wire]\nconnect_secs = 1.0\n')
    return tmp_path


def start(owner: Owner, mood: str, run_dir: Path, endpoint: str) -> Process:
    return owner.start_code(mood, SERVICE, mood, "--run-dir", str(run_dir), "--connect", endpoint)


def test_a_service_that_finishes_ends_with_code_0(owner: Owner, router: RunningRouter, run_dir: Path) -> None:
    process = start(owner, "finish", run_dir, router.endpoint)
    assert process.ended() == 0


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_stops_it_once_and_it_ends_in_order(
    owner: Owner, router: RunningRouter, run_dir: Path, number: int
) -> None:
    process = start(owner, "orderly", run_dir, router.endpoint)
    process.expect("polling")
    process.interrupt(number)
    process.interrupt(number)
    process.expect("in order after 1 stop")
    assert process.ended() == 0


def test_one_that_does_not_stop_is_ended_all_the_same(
    owner: Owner, router: RunningRouter, run_dir: Path
) -> None:
    process = start(owner, "stubborn", run_dir, router.endpoint)
    process.expect("polling")
    process.interrupt()
    assert process.ended(within_secs=8.0) == 0
    assert any("not in order" in line for line in process.err)


def test_it_is_a_member_while_it_lives_under_a_new_life_name(
    owner: Owner, router: RunningRouter, run_dir: Path
) -> None:
    watcher, inbox = ZenohBus(router.endpoint, "coordinator-1", Wakeup(), 10.0), Inbox()
    watcher.watch(keys.alive("r", "*", "*"), inbox)
    process = start(owner, "orderly", run_dir, router.endpoint)
    came = wait_for("the member", inbox.take)
    assert isinstance(came, Membership)
    service, life = keys.member(came.key)
    assert service == "encoder_learner"
    assert life.startswith("encoder_learner-")
    assert all(life in line for line in process.err)
    process.expect("polling")
    process.interrupt()
    assert process.ended() == 0
    assert wait_for("its leaving", inbox.take) == Membership(came.key, False)
    watcher.close()


def test_no_router_is_one_sentence_and_code_2(owner: Owner, run_dir: Path) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    process = start(owner, "finish", run_dir, endpoint)
    assert process.ended() == 2
    *earlier, sentence = process.err
    assert not any("Traceback" in line for line in earlier)
    assert sentence.startswith(
        f"encoder_learner: no router answered at {endpoint} within 1 s: nobody listens there; "
    )


def test_a_signal_while_it_looks_for_the_router_ends_it_with_code_0(owner: Owner, run_dir: Path) -> None:
    (run_dir / "config.toml").write_text('scenario = "cuboid"\n[wire]\nconnect_secs = 60.0\n')
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    process = start(owner, "finish", run_dir, endpoint)
    wait_for("the attempt", lambda: any("connecting to" in line for line in process.err))
    process.interrupt()
    assert process.ended(within_secs=5.0) == 0


def test_an_error_that_a_person_can_mend_is_one_sentence_and_code_2(
    owner: Owner, router: RunningRouter, run_dir: Path
) -> None:
    process = start(owner, "full", run_dir, router.endpoint)
    assert process.ended() == 2
    assert process.err[-1] == "encoder_learner: cannot write /disk: No space left on device"
    assert not any("Traceback" in line for line in process.err)


def test_a_bug_leaves_its_traceback_in_the_log_and_code_1(
    owner: Owner, router: RunningRouter, run_dir: Path
) -> None:
    process = start(owner, "bug", run_dir, router.endpoint)
    assert process.ended() == 1
    assert any("Traceback" in line for line in process.err)
    assert "stopped by a bug (ZeroDivisionError: no such luck)" in process.err[-1]


@pytest.mark.parametrize(
    ("file", "text", "says"),
    [
        ("run.json", None, "run.json"),
        ("run.json", '{"run": "No Name!"}', "run.json"),
        ("config.toml", 'scenario = "x"\nspeed = 3\n', "speed: is not a known key"),
    ],
)
def test_a_broken_run_folder_is_one_sentence_and_code_2(
    owner: Owner, run_dir: Path, file: str, text: str | None, says: str
) -> None:
    (run_dir / file).unlink()
    if text is not None:
        (run_dir / file).write_text(text)
    process = start(owner, "finish", run_dir, "tcp/127.0.0.1:1")
    assert process.ended() == 2
    (sentence,) = process.err
    assert says in sentence
