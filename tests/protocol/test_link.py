"""Window and ledger together: over any link and any crash, each segment is taken once and in order."""

import json
from dataclasses import dataclass, field

from hypothesis import event, given, settings
from hypothesis import strategies as st

from protocol.ledger import Ledger, Verdict
from protocol.window import SendWindow

SIZE = 3
RESEND_SECS = 0.5
SEGMENTS = 8
STREAM = ("actor-1", "body")


@dataclass
class Receiver:
    """A learner: takes, spools, syncs, acknowledges, checkpoints, and dies."""

    ledger: Ledger = field(default_factory=Ledger)
    taken: list[int] = field(default_factory=list)
    spool: list[int] = field(default_factory=list)
    synced: int = 0
    checkpoint: str = '{"ledger": null, "taken": []}'
    promised: int = 0

    def hear(self, seq: int) -> None:
        """Take a segment into the spool if it is new."""
        if self.ledger.judge(*STREAM, seq) is Verdict.NEW:
            self.spool.append(seq)
            self.take(seq)
        else:
            self.ledger.refuse(*STREAM, seq)

    def take(self, seq: int) -> None:
        """Accept and use it."""
        self.ledger.accept(*STREAM, seq)
        self.taken.append(seq)

    def ack(self) -> int:
        """Sync the spool, then promise."""
        self.synced = len(self.spool)
        upto = self.ledger.upto(*STREAM)
        assert upto >= self.promised, "an acknowledgement went back"
        self.promised = upto
        return upto

    def save(self) -> None:
        """Write a checkpoint and begin a new spool."""
        self.checkpoint = json.dumps({"ledger": self.ledger.state(), "taken": self.taken})
        self.spool, self.synced = [], 0

    def crash(self) -> None:
        """Die, losing what was not synced, and start from the checkpoint and the spool."""
        saved = json.loads(self.checkpoint)
        self.ledger, self.taken = Ledger(), saved["taken"]
        if saved["ledger"] is not None:
            self.ledger.restore(saved["ledger"])
        self.spool = self.spool[: self.synced]
        for seq in self.spool:
            assert self.ledger.judge(*STREAM, seq) is Verdict.NEW
            self.take(seq)
        assert self.ledger.upto(*STREAM) >= self.promised, "a promise was broken"


class Run:
    """A sender, a receiver, and two lossy, duplicating, reordering links between them."""

    def __init__(self) -> None:
        self.window = SendWindow(SIZE, RESEND_SECS)
        self.receiver = Receiver()
        self.now_secs = 0.0
        self.granted = 0
        self.out: list[int] = []
        self.back: list[tuple[int, int]] = []

    def send(self, _: int) -> None:
        if self.window.may_send(self.granted):
            seq = self.window.next_seq
            self.window.sent(seq, b"%d" % seq, self.now_secs)
            self.out.append(seq)

    def wait(self, tenths: int) -> None:
        self.now_secs += tenths / 10
        for seq, frame in self.window.due(self.now_secs):
            assert frame == b"%d" % seq
            self.out.append(seq)

    def deliver(self, which: int) -> None:
        if self.out:
            self.receiver.hear(self.out.pop(which % len(self.out)))

    def duplicate(self, which: int) -> None:
        if self.out:
            self.out.append(self.out[which % len(self.out)])

    def lose(self, which: int) -> None:
        if self.out:
            self.out.pop(which % len(self.out))

    def ack(self, more: int) -> None:
        granted = min(SEGMENTS, self.receiver.ledger.upto(*STREAM) + more)
        self.back.append((self.receiver.ack(), granted))

    def deliver_ack(self, which: int) -> None:
        if self.back:
            upto, granted = self.back.pop(which % len(self.back))
            self.window.acked(upto)
            self.granted = max(self.granted, granted)

    def repeat_ack(self, which: int) -> None:
        if self.back:
            self.back.append(self.back[which % len(self.back)])

    def lose_ack(self, which: int) -> None:
        if self.back:
            self.back.pop(which % len(self.back))

    def save(self, _: int) -> None:
        self.receiver.save()

    def crash(self, _: int) -> None:
        self.receiver.crash()

    def check(self) -> None:
        """What holds at any moment."""
        assert self.receiver.taken == list(range(len(self.receiver.taken)))
        assert self.window.acked_total <= self.receiver.promised <= len(self.receiver.taken)
        assert len(self.receiver.taken) <= self.window.sent_total <= max(self.granted, 0)
        assert self.window.unacknowledged <= SIZE
        assert self.window.acked_total + self.window.unacknowledged == self.window.sent_total

    def finish(self) -> int:
        """Let the link be good from now on; returns the rounds it took."""
        for rounds in range(1, 40):
            self.ack(SEGMENTS)
            while self.back:
                self.deliver_ack(0)
            if self.window.acked_total == SEGMENTS:
                return rounds
            for _ in range(SIZE):
                self.send(0)
            self.wait(11)
            while self.out:
                self.deliver(0)
                self.check()
        raise AssertionError(f"stuck with {self.receiver.taken}")


STEPS = (
    "send",
    "wait",
    "deliver",
    "duplicate",
    "lose",
    "ack",
    "deliver_ack",
    "repeat_ack",
    "lose_ack",
    "save",
    "crash",
)


@settings(max_examples=300, deadline=None)
@given(history=st.lists(st.tuples(st.sampled_from(STEPS), st.integers(0, 12)), min_size=20, max_size=120))
def test_each_segment_is_taken_once_and_in_order(history):
    run = Run()
    run.ack(SEGMENTS)
    run.deliver_ack(0)
    for step, how in history:
        getattr(run, step)(how)
        run.check()
    event(f"resent {min(run.window.resent, 5)}")
    run.finish()
    assert run.receiver.taken == list(range(SEGMENTS))
    assert run.window.unacknowledged == run.window.held_bytes == 0


@settings(max_examples=100, deadline=None)
@given(
    arrivals=st.permutations([seq for seq in range(5) for _ in range(3)]),
    losses=st.sets(st.integers(0, 14), max_size=10),
)
def test_any_schedule_followed_by_resends_fills_every_gap(arrivals, losses):
    receiver = Receiver()
    for place, seq in enumerate(arrivals):
        if place not in losses:
            receiver.hear(seq)
    for _ in range(2):
        for seq in range(receiver.ledger.upto(*STREAM), 5):
            receiver.hear(seq)
    assert receiver.taken == [0, 1, 2, 3, 4]
    assert receiver.ledger.new == 5
