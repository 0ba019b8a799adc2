"""What survives when the router is killed, a member is killed, or somebody is frozen."""

import threading
import time
from collections.abc import Callable

import pytest

from protocol import keys
from protocol.ledger import Ledger, Verdict
from protocol.window import SendWindow
from services.runtime.bus import Frame, Inbox, Link, Membership
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, Process, RunningRouter, wait_for

pytestmark = pytest.mark.processes

Connect = Callable[[str], ZenohBus]
MODEL = keys.model("r", "policy", "body")
PHASE = keys.phase("r")
STREAM = keys.segment("r", "encoder_learner", "body", "actor-1")
ACKS = keys.ack("r", "actor-1", "encoder_learner")

MEMBER = """
import sys
from services.runtime.bus import Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
endpoint, life = sys.argv[1:]
bus = ZenohBus(endpoint, life, Wakeup(), 10.0)
inbox, phases = Inbox(max_frames=4), Inbox()
bus.subscribe("segment", "babble/r/segment/*/*/*", inbox)
bus.subscribe("model", "babble/r/model/*/*", inbox)
bus.subscribe("phase", "babble/r/phase", phases)
bus.announce(f"babble/r/alive/actor/{life}")
print("member", flush=True)
Wakeup().wait(120)
"""


def member(owner: Owner, router: RunningRouter, life: str) -> Process:
    process = owner.start_code(life, MEMBER, router.endpoint, life)
    process.expect("member")
    return process


def frames(inbox: Inbox) -> list[bytes]:
    return [arrival.data for arrival in inbox.take_all() if isinstance(arrival, Frame)]


def test_a_killed_member_is_seen_to_go_at_once(owner: Owner, router: RunningRouter, connect: Connect) -> None:
    watcher, inbox = connect("coordinator-1"), Inbox()
    watcher.watch(keys.alive("r", "actor", "*"), inbox)
    actor = member(owner, router, "actor-9")
    key = keys.alive("r", "actor", "actor-9")
    assert wait_for("the member", inbox.take) == Membership(key, True)
    actor.kill()
    assert wait_for("its going", inbox.take, within_secs=3.0) == Membership(key, False)


def test_a_frozen_member_goes_after_its_lease_and_comes_back(
    owner: Owner, router: RunningRouter, connect: Connect
) -> None:
    watcher, inbox = connect("coordinator-1"), Inbox()
    watcher.watch(keys.alive("r", "actor", "*"), inbox)
    actor = member(owner, router, "actor-9")
    key = keys.alive("r", "actor", "actor-9")
    assert wait_for("the member", inbox.take) == Membership(key, True)
    actor.freeze()
    assert wait_for("its going", inbox.take, within_secs=5.0) == Membership(key, False)
    actor.thaw()
    assert wait_for("its return", inbox.take, within_secs=10.0) == Membership(key, True)


def test_a_killed_router_is_noticed_and_its_successor_found(router: RunningRouter, connect: Connect) -> None:
    learner, actor = connect("learner-1"), connect("actor-1")
    links, models, phases, members = Inbox(), Inbox(), Inbox(), Inbox()
    actor.watch_link(links)
    actor.subscribe("model", MODEL, models)
    actor.subscribe("phase", PHASE, phases)
    actor.watch(keys.alive("r", "policy_learner", "*"), members)
    learner.announce(keys.alive("r", "policy_learner", "learner-1"))
    learner.publish("model", MODEL, b"model 1")
    learner.publish("phase", PHASE, b"term 1")
    wait_for("the first model", lambda: b"model 1" in frames(models))
    wait_for("the first phase", lambda: b"term 1" in frames(phases))
    wait_for(
        "the learner",
        lambda: members.take() == Membership(keys.alive("r", "policy_learner", "learner-1"), True),
    )
    assert links.take() is None

    router.kill()
    assert wait_for("the loss of the link", links.take, within_secs=5.0) == Link(False)
    assert not actor.linked()
    wait_for("the learner's loss", lambda: members.take() is not None)
    learner.publish("model", MODEL, b"model 2")
    learner.publish("phase", PHASE, b"term 2")
    router.start_again()

    assert wait_for("the link", links.take, within_secs=10.0) == Link(True)
    wait_for("the model published meanwhile", lambda: b"model 2" in frames(models))
    wait_for("the phase published meanwhile", lambda: b"term 2" in frames(phases))
    wait_for("the learner's return", lambda: (m := members.take()) is not None and m.present)  # type: ignore[union-attr]
    late, late_models = connect("actor-2"), Inbox()
    late.subscribe("model", MODEL, late_models)
    wait_for("the model at a late joiner", lambda: frames(late_models) == [b"model 2"])


def test_nothing_is_lost_or_taken_twice_when_the_router_is_killed_midway(
    router: RunningRouter, connect: Connect
) -> None:
    learner, actor = connect("encoder_learner-1"), connect("actor-1")
    segments, acks = Inbox(), Inbox()
    learner.subscribe("segment", STREAM, segments)
    actor.subscribe("ack", ACKS, acks)
    window, ledger, total = SendWindow(4, 0.2), Ledger(), 300
    taken: list[int] = []

    def exchange() -> None:
        for data in frames(acks):
            window.acked(int.from_bytes(data, "big"))
        now_secs = time.monotonic()
        while window.next_seq < total and window.may_send(total):
            seq = window.next_seq
            frame = seq.to_bytes(4, "big") + bytes(20_000)
            window.sent(seq, frame, now_secs)
            actor.publish("segment", STREAM, frame)
        for _, frame in window.due(now_secs):
            actor.publish("segment", STREAM, frame)
        for data in frames(segments):
            seq = int.from_bytes(data[:4], "big")
            if ledger.judge("actor-1", "body", seq) is Verdict.NEW:
                ledger.accept("actor-1", "body", seq)
                taken.append(seq)
            learner.publish("ack", ACKS, ledger.upto("actor-1", "body").to_bytes(4, "big"))

    def acknowledged(count: int) -> bool:
        exchange()
        return window.acked_total >= count

    wait_for("the first 50", lambda: acknowledged(50), 20.0)
    router.kill()
    wait_for("the window to stall and resend", lambda: acknowledged(total) or window.resent > 0)
    assert window.unacknowledged == 4
    assert window.acked_total < total
    router.start_again()
    wait_for("all of them", lambda: acknowledged(total), within_secs=30.0)
    assert taken == list(range(total))


class Flood(threading.Thread):
    """Publishes segments of 0.5 MB and models of 1 MB as fast as they go out, until `done`."""

    def __init__(self, bus: ZenohBus, done: threading.Event) -> None:
        super().__init__(daemon=True)
        self.sent = 0
        self._bus = bus
        self._done = done

    def run(self) -> None:
        while not self._done.is_set():
            self._bus.publish("segment", STREAM, self.sent.to_bytes(4, "big") + bytes(500_000))
            self.sent += 1
            if self.sent % 5 == 0:
                self._bus.publish("model", MODEL, bytes(1_000_000))


def seqs(inbox: Inbox) -> list[int]:
    return [int.from_bytes(data[:4], "big") for data in frames(inbox) if data]


def test_a_frozen_subscriber_delays_no_phase_and_loses_no_segment_of_others(
    owner: Owner, router: RunningRouter, connect: Connect
) -> None:
    frozen = [member(owner, router, f"actor-{index}") for index in (7, 8)]
    coordinator, learner, healthy = connect("coordinator-1"), connect("learner-1"), connect("actor-1")
    phases, segments = Inbox(), Inbox(max_frames=10_000)
    healthy.subscribe("phase", PHASE, phases)
    healthy.subscribe("segment", keys.segment("r", "*", "*", "*"), segments)

    def connected() -> bool:
        learner.publish("segment", STREAM, b"")
        return bool(frames(segments))

    wait_for("a first segment", connected)
    for process in frozen:
        process.freeze()

    got: list[int] = []
    done = threading.Event()
    flood = Flood(learner, done)
    flood.start()
    worst_secs = 0.0
    for term in range(300):
        sent_secs = time.monotonic()
        coordinator.publish("phase", PHASE, str(term).encode())
        wait_for(f"phase {term}", lambda: frames(phases), within_secs=5.0)
        worst_secs = max(worst_secs, time.monotonic() - sent_secs)
        got.extend(seqs(segments))
    done.set()
    flood.join(10.0)

    def complete() -> bool:
        got.extend(seqs(segments))
        return len(got) >= flood.sent

    wait_for("all segments", complete)
    assert got == list(range(flood.sent))
    assert flood.sent > 20
    assert worst_secs < 1.5
    print(f"phase max {worst_secs * 1e3:.0f} ms; {flood.sent} segments of 0.5 MB, none lost")
