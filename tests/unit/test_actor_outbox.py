"""An actor sends what was granted in this term, within its window, and again until it is acknowledged."""

import numpy as np
import pytest

from protocol import keys
from protocol.codec import decode
from protocol.messages import Ack, Phase, PhaseAnnounced, Segment
from services.actor.collect import Finished
from services.actor.outbox import Outbox
from services.runtime.bus import Frame, Inbox
from services.runtime.memory_bus import MemoryBus
from services.runtime.settings import SettingsError

FINGERPRINT = "0" * 16


class Stage:
    """An outbox, and the consumer that hears it."""

    def __init__(self) -> None:
        hub = MemoryBus()
        self.outbox = Outbox(
            hub.connect("actor-1"),
            run="r",
            life="actor-1",
            fingerprint=FINGERPRINT,
            window=2,
            resend_secs=1.0,
        )
        self.heard = Inbox()
        hub.connect("learner-1").subscribe("segment", keys.segment("r", "*", "*", "*"), self.heard)

    def ack(self, *, upto: int = 0, granted: int, term: int = 1) -> None:
        self.outbox.hear(
            Ack(
                run="r",
                term=term,
                block="body",
                life="learner-1",
                seq=0,
                to="actor-1",
                consumer="encoder_learner",
                upto=upto,
                granted=granted,
            )
        )

    def send(self, now_secs: float = 0.0, columns: int = 2) -> None:
        arrays = {
            "observation": np.zeros((3, columns, 1), np.float32),
            "episode": np.zeros((3, columns), np.int32),
        }
        finished = Finished("body", arrays, "random", 0, 0, steps=3, columns=columns, first_step=0)
        announced = PhaseAnnounced(
            run="r",
            term=1,
            block="all",
            life="coordinator-1",
            seq=0,
            phase=Phase.BABBLE,
            level=1,
            iteration=2,
            blocks={},
        )
        self.outbox.send(finished, announced, now_secs)

    def heard_seqs(self) -> list[int]:
        messages = [decode(frame.data) for frame in self.heard.take_all() if isinstance(frame, Frame)]
        return [message.seq for message in messages if isinstance(message, Segment)]


def test_nothing_is_sent_without_a_grant_and_no_more_than_granted() -> None:
    stage = Stage()
    stage.send()
    stage.ack(granted=1)
    stage.send()
    stage.send()
    assert stage.heard_seqs() == [0]
    assert stage.outbox.unwanted == 2


def test_a_segment_says_of_which_level_and_iteration_it_is() -> None:
    stage = Stage()
    stage.ack(granted=1)
    stage.send()
    (frame,) = stage.heard.take_all()
    assert isinstance(frame, Frame)
    segment = decode(frame.data)
    assert isinstance(segment, Segment)
    assert (segment.term, segment.level, segment.iteration) == (1, 1, 2)


def test_a_grant_of_another_term_does_not_count() -> None:
    stage = Stage()
    stage.ack(granted=5, term=2)
    assert stage.outbox.grant(Phase.BABBLE, 1, "body") is None
    assert stage.outbox.grant(Phase.BABBLE, 2, "body") is not None


def test_the_window_holds_back_what_is_granted_until_it_is_acknowledged() -> None:
    stage = Stage()
    stage.ack(granted=9)
    for _ in range(3):
        stage.send()
    assert stage.heard_seqs() == [0, 1]
    stage.ack(upto=1, granted=9)
    stage.send()
    assert stage.heard_seqs() == [2]


def test_what_is_not_acknowledged_is_sent_again_in_order() -> None:
    stage = Stage()
    stage.ack(granted=9)
    stage.send(0.0)
    stage.send(0.1)
    stage.outbox.resend(0.5)
    assert stage.heard_seqs() == [0, 1]
    stage.ack(upto=1, granted=9)
    stage.outbox.resend(1.2)
    assert stage.heard_seqs() == [1]
    assert (stage.outbox.resent, stage.outbox.unacknowledged) == (1, 1)


def test_phases_without_experience_have_no_grants() -> None:
    stage = Stage()
    stage.ack(granted=9)
    assert stage.outbox.grant(Phase.ENCODE, 1, "body") is None


def test_a_segment_over_the_limit_of_a_frame_is_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("protocol.codec.MAX_FRAME_BYTES", 200)
    stage = Stage()
    stage.ack(granted=1)
    with pytest.raises(SettingsError, match=r"segment_steps and actors\.envs_per_actor are too large"):
        stage.send(columns=50)
