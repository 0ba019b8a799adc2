"""One actor's certificate floods the router: it is cut off, named and counted; the others notice nothing."""

import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode
from protocol.messages import Status
from services.runtime.bus import Arrival, Frame, Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.credentials_stage import CredentialsStage, GuardedRouter
from tests.processes.owned import Owner, Process, wait_for

pytestmark = pytest.mark.processes

RUN = "flooded"
GOOD, EVIL = "actor-good-00000001", "actor-evil-00000001"
GOOD_PER_SEC = 50
LOW = ("--most-mb-per-sec", "20", "--most-messages-per-sec", "400", "--most-lives", "12")
"""Limits that a flood soon exceeds, and the good actor does not."""
CUT_SECS = 8.0
"""Within so long a flood must be over."""
WORST_GAP_SECS = 1.0
"""A busy machine may hold up the good actor's 50 messages a second for so long; a flood of 5 s may not."""

ACTOR = """
import sys, time
from pathlib import Path
import numpy as np
from protocol import keys
from protocol.codec import encode
from protocol.messages import Segment
from services.runtime.bus import Wakeup
from services.runtime.credentials import read_credential
from services.runtime.zenoh_bus import ZenohBus

endpoint, file, run, life, what, amount = sys.argv[1:]
credential = read_credential(Path(file))

def connect():
    return ZenohBus(endpoint, life, Wakeup(), 10.0, credential)

def frame(size):
    steps, width = 16, max(1, size // 64)
    arrays = {"observation": np.zeros((steps, 1, width), "<f4"), "episode": np.zeros((steps, 1), "<i4")}
    return encode(Segment(
        run=run, term=1, block="body", life=life, seq=0, consumer="encoder_learner",
        fingerprint="0" * 16, phase="babble", steps=steps, columns=1, first_step=0, arrays=arrays,
    ))

key = keys.segment(run, "encoder_learner", "body", life)
bus = connect()
bus.announce(keys.alive(run, "actor", life))
print("begun", flush=True)
more = []
if what == "lives":
    for number in range(int(amount)):
        bus.announce(keys.alive(run, "actor", f"{life[:-8]}{number:08x}"))
elif what == "connections":
    for number in range(int(amount)):
        more.append(connect())
elif what == "garbage":
    while True:
        bus.publish("segment", key, bytes(100))
        time.sleep(1 / int(amount))
elif what == "borrowed":
    status_key = keys.status(run, "actor", life)
    while True:
        bus.publish("status", status_key, frame(100))
        time.sleep(1 / int(amount))
else:
    sent, per_sec = frame(int(what)), int(amount)
    while True:
        bus.publish("segment", key, sent)
        if per_sec:
            time.sleep(1 / per_sec)
time.sleep(60)
"""
"""An actor of a host: `what` is the size of its segments or another way to misbehave, `amount` how much of it
(per second, 0 for as much as it can)."""


class Gaps(Inbox):
    """Hears segments: how many of each life, how many bytes, and the longest time between two."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: dict[str, int] = {}
        self.bytes: dict[str, int] = {}
        self.worst_secs: dict[str, float] = {}
        self._last_secs: dict[str, float] = {}

    def put(self, arrival: Arrival) -> None:
        """Count it."""
        assert isinstance(arrival, Frame)
        life, now_secs = arrival.key.rsplit("/", 1)[1], time.monotonic()
        gap_secs = now_secs - self._last_secs.get(life, now_secs)
        self.worst_secs[life] = max(gap_secs, self.worst_secs.get(life, 0.0))
        self._last_secs[life] = now_secs
        self.heard[life] = self.heard.get(life, 0) + 1
        self.bytes[life] = self.bytes.get(life, 0) + len(arrival.data)


class FloodedRun:
    """A router with a list of two hosts, a learner and a coordinator (this test), a good actor that works."""

    def __init__(self, owner: Owner, folder: Path, *options: str) -> None:
        self.stage = CredentialsStage(folder)
        self.owner = owner
        hosts = folder / "hosts"
        hosts.write_text("good\nevil\n")
        credential = ("--credential", str(self.stage.path("router")))
        self.router = GuardedRouter(owner, hosts, *credential, *options)
        self.segments, self._statuses = Gaps(), Inbox()
        self.buses: list[ZenohBus] = []
        learner = self.join("encoder_learner")
        learner.subscribe("segment", keys.segment(RUN, "encoder_learner", "*", "*"), self.segments)
        coordinator = self.join("coordinator")
        coordinator.announce(keys.alive(RUN, "coordinator", "coordinator-00000001"))
        coordinator.subscribe("status", keys.status(RUN, "router", "*"), self._statuses)
        self._status: Status | None = None

    def join(self, identity: str) -> ZenohBus:
        """Connect the test itself."""
        bus = ZenohBus(
            self.router.endpoint, f"{identity}-00000001", Wakeup(), 10.0, self.stage.credential(identity)
        )
        self.buses.append(bus)
        return bus

    def actor(self, host: str, what: str, amount: int) -> Process:
        """Start an actor of a host; it is connected."""
        arguments = (self.router.endpoint, str(self.stage.path(f"actor.{host}")), RUN)
        process = self.owner.start_code(host, ACTOR, *arguments, f"actor-{host}-00000001", what, str(amount))
        process.expect("begun")
        return process

    def good_actor(self) -> Process:
        """Start the one that works as it should, and hear it."""
        process = self.actor("good", "20000", GOOD_PER_SEC)
        wait_for("the good actor's segments", lambda: self.segments.heard.get(GOOD, 0) > 10)
        return process

    def status(self) -> Status | None:
        """The newest status of the router."""
        for arrival in self._statuses.take_all():
            assert isinstance(arrival, Frame)
            status = decode(arrival.data)
            assert isinstance(status, Status)
            self._status = status
        return self._status

    def total(self, name: str) -> int:
        """One of the router's totals; 0 before its first status."""
        status = self.status()
        return 0 if status is None else status.totals.get(name, 0)

    def log_line(self, text: str, within_secs: float = CUT_SECS) -> str:
        """The router's first log line with the text."""
        return wait_for(
            f"{text!r} in the router's log",
            lambda: next((line for line in list(self.router.process.err) if text in line), None),
            within_secs,
        )


@pytest.fixture
def flooded(owner: Owner, tmp_path: Path) -> Iterator[Callable[..., FloodedRun]]:
    """Makes the run, with options of the router."""
    made: list[FloodedRun] = []

    def make(*options: str) -> FloodedRun:
        made.append(FloodedRun(owner, tmp_path, *options))
        return made[-1]

    yield make
    for run in made:
        for bus in run.buses:
            bus.close()


@pytest.mark.parametrize(
    ("what", "amount", "named"),
    [
        ("1000000", 0, "MB/s"),
        ("garbage", 20, "frames of garbage"),
        ("lives", 100, "processes at once"),
        pytest.param("100", 0, "messages/s", marks=pytest.mark.slow),
        pytest.param("borrowed", 20, "frames of garbage", marks=pytest.mark.slow),
        pytest.param("connections", 20, "connections at once", marks=pytest.mark.slow),
    ],
)
def test_a_flood_is_cut_off_named_and_counted_while_another_host_goes_on(
    flooded: Callable[..., FloodedRun], what: str, amount: int, named: str
) -> None:
    run = flooded(*LOW)
    good = run.good_actor()
    evil = run.actor("evil", what, amount)
    line = run.log_line("cut off")
    assert "actor.evil" in line
    assert "127.0.0.1" in line
    assert named in line
    assert "limit" in line
    assert "kept out for 60 s" in line
    wait_for("the status of the router", lambda: run.total("cut_off") == 1)
    status = run.status()
    assert status is not None
    assert "actor.evil" in status.last_error
    assert status.totals["banned"] == 1
    before = run.segments.heard[GOOD]
    wait_for("the good one's segments", lambda: run.segments.heard[GOOD] > before + GOOD_PER_SEC)
    assert good.running()
    assert run.segments.worst_secs[GOOD] < WORST_GAP_SECS
    assert "actor.good" not in "\n".join(run.router.process.err)
    evil.kill()


@pytest.mark.parametrize(("what", "amount"), [("100000", 0), ("garbage", 100)])
def test_what_a_banned_host_sends_hardly_arrives(
    flooded: Callable[..., FloodedRun], what: str, amount: int
) -> None:
    run = flooded(*LOW)
    run.actor("evil", what, amount)
    run.log_line("cut off")
    heard, cut, since_secs = run.segments.heard[EVIL], run.total("turned_away"), time.monotonic()
    wait_for("six connections turned away", lambda: run.total("turned_away") >= cut + 6)
    tried = max(100, amount) * (time.monotonic() - since_secs)
    assert run.segments.heard[EVIL] - heard < tried / 4


def test_garbage_is_counted_by_reason(flooded: Callable[..., FloodedRun]) -> None:
    run = flooded()
    run.actor("evil", "garbage", 5)
    wait_for("garbage in the status", lambda: (status := run.status()) is not None and bool(status.refused))
    status = run.status()
    assert status is not None
    assert set(status.refused) == {"malformed"}


@pytest.mark.slow
def test_an_actor_that_works_hard_is_not_cut_off(flooded: Callable[..., FloodedRun]) -> None:
    run = flooded()
    run.actor("good", "1000000", 40)
    wait_for("200 MB of segments", lambda: run.segments.bytes.get(GOOD, 0) > 200e6, within_secs=60.0)
    bytes_heard = run.segments.bytes[GOOD]
    wait_for("the router's count of it", lambda: run.total("bytes") >= bytes_heard)
    assert run.total("cut_off") == 0
    assert run.total("turned_away") == 0
    assert run.router.process.err == []
