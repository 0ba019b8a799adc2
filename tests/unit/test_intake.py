"""A learner's intake: each segment once, on disk before it is acknowledged, grants as the demand says."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from protocol import keys
from protocol.codec import decode, encode
from protocol.gate import Gate
from protocol.messages import Ack, Phase, Segment
from services.runtime.allotment import Allotment
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.errors import StorageError
from services.runtime.intake import Intake
from services.runtime.memory_bus import MemoryBus
from services.runtime.spool import Spool

FINGERPRINT = "0123456789abcdef"


class ToldSpool(Spool):
    """A spool that tells what was asked of it, and can be full."""

    def __init__(self, folder: Path) -> None:
        self.told: list[str] = []
        self.full = False
        super().__init__(folder)

    def append(self, frame: bytes) -> None:
        if self.full:
            raise StorageError("the disk is full")
        self.told.append("append")
        super().append(frame)

    def sync(self) -> None:
        self.told.append("sync")
        super().sync()


class Stage:
    """One intake, and the actor on the other side of a memory bus."""

    def __init__(self, folder: Path) -> None:
        hub = MemoryBus()
        self.spool = ToldSpool(folder)
        self.gate = Gate("r", {"segment"}, fingerprint=FINGERPRINT)
        self.intake = Intake(
            hub.connect("learner-1"), self.gate, consumer="encoder_learner", blocks=["body"], run="r",
            life="learner-1", spool=self.spool, wakeup=Wakeup(),
        )  # fmt: skip
        self.actor = hub.connect("actor-1")
        self.actor.announce(keys.alive("r", "actor", "actor-1"))
        self.heard = Inbox()
        self.actor.subscribe("ack", keys.ack("r", "actor-1", "*"), self.heard)
        self.allotment = Allotment(columns_per_segment=2, window=4, patience_secs=10.0)

    def send(self, seq: int, **changes: Any) -> None:
        fields: dict[str, Any] = {"fingerprint": FINGERPRINT, "run": "r", "block": "body"} | changes
        segment = Segment(
            term=1, life="actor-1", seq=seq, consumer="encoder_learner", phase=Phase.BABBLE,
            steps=3, columns=2, first_step=3 * seq,
            arrays={
                "observation": np.full((3, 2, 1), seq, np.float32),
                "episode": np.zeros((3, 2), np.int32),
            },
            **fields,
        )  # fmt: skip
        self.actor.publish(
            "segment", keys.segment("r", "encoder_learner", segment.block, "actor-1"), encode(segment)
        )

    def acks(self, now_secs: float = 0.0) -> list[tuple[int, int]]:
        """(upto, granted) of each acknowledgement that reaches the actor now."""
        self.allotment.appeared("actor-1", self.intake.ledger.upto("actor-1", "body"), now_secs)
        self.intake.answer("body", self.allotment, term=1, policy_floor=0, want="random", now_secs=now_secs)
        messages = [decode(frame.data) for frame in self.heard.take_all() if isinstance(frame, Frame)]
        return [(ack.upto, ack.granted) for ack in messages if isinstance(ack, Ack)]


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


def test_segments_are_on_disk_before_they_are_given_out(stage: Stage) -> None:
    stage.send(0)
    stage.send(1)
    assert [segment.seq for segment in stage.intake.collect()] == [0, 1]
    assert stage.spool.told == ["append", "append", "sync"]
    assert stage.acks() == [(2, 2)]


def test_a_full_disk_acknowledges_nothing(stage: Stage) -> None:
    stage.spool.full = True
    stage.send(0)
    with pytest.raises(StorageError, match="full"):
        stage.intake.collect()
    assert stage.acks() == [(0, 0)]


def test_what_comes_twice_or_too_early_is_not_taken_and_is_answered_at_once(stage: Stage) -> None:
    stage.send(0)
    stage.intake.collect()
    assert stage.acks(0.0) == [(1, 1)]
    assert stage.acks(0.1) == [], "nothing new to say"
    stage.send(0)
    stage.send(2)
    assert stage.intake.collect() == []
    assert (stage.intake.ledger.duplicated, stage.intake.ledger.gaps) == (1, 1)
    assert stage.acks(0.2) == [(1, 1)], "its sender does not know what is held"


def test_an_acknowledgement_is_repeated_since_it_may_be_lost(stage: Stage) -> None:
    stage.send(0)
    stage.intake.collect()
    assert stage.acks(0.0) == [(1, 1)]
    assert stage.acks(0.6) == [(1, 1)]


def test_grants_follow_the_demand(stage: Stage) -> None:
    stage.allotment.want(6)
    assert stage.acks() == [(0, 3)]


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"run": "other"}, "foreign-run"),
        ({"fingerprint": "f" * 16}, "wrong-fingerprint"),
    ],
)
def test_a_stranger_is_refused_and_counted(stage: Stage, changes: dict[str, str], reason: str) -> None:
    stage.send(0, **changes)
    assert stage.intake.collect() == []
    assert stage.gate.refused == {reason: 1}


def test_segments_of_another_learners_blocks_are_neither_taken_nor_refused(stage: Stage) -> None:
    stage.send(0, block="another")
    stage.send(0)
    assert [segment.block for segment in stage.intake.collect()] == ["body"]
    assert stage.gate.refused == {}
    assert stage.intake.dropped == 0


def test_a_learner_that_was_killed_finds_what_it_took(stage: Stage, tmp_path: Path) -> None:
    for seq in range(3):
        stage.send(seq)
    stage.intake.collect()
    again = Stage(tmp_path)
    replayed = list(again.intake.replay(0))
    assert [segment.seq for segment in replayed] == [0, 1, 2]
    assert replayed[2].arrays["observation"][0, 0, 0] == 2
    assert again.intake.ledger.upto("actor-1", "body") == 3


def test_a_flood_of_segments_never_hides_that_an_actor_is_there(stage: Stage) -> None:
    for _ in range(keys.DELIVERY["segment"].keep + 10):
        stage.send(5)
    stage.intake.collect(limit=1)
    assert stage.intake.present == {"actor-1"}
    assert stage.intake.dropped > 0
