"""A learner tells actors how far it is with what it wants of them."""

from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode
from protocol.messages import Ack, Phase, Progress
from services.runtime.bus import Frame, Inbox
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import parse
from tests.unit.learner_stage import RUN, LearnerStage
from tests.unit.test_learner_many_blocks import CountingWork


class Collecting(CountingWork):
    """Has collected 30 of 120 steps, or makes updates, or has nothing to do."""

    said: Progress | None = None

    def progress(self) -> Progress | None:  # type: ignore[override]
        return self.said


@pytest.mark.parametrize(
    ("said", "share"),
    [
        (Progress(block="body", done=30, wanted=120, unit="steps"), 0.25),
        (Progress(block="body", done=130, wanted=120, unit="steps"), 1.0),
        (Progress(block="body", done=0, wanted=0, unit="steps"), 0.0),
        (Progress(block="body", done=30, wanted=120, unit="updates"), 0.0),
        (None, 0.0),
    ],
    ids=["a-quarter", "more-than-wanted", "nothing-wanted", "updates", "not-its-term"],
)
def test_acks_say_the_share_of_the_experience_that_is_there(
    tmp_path: Path, said: Progress | None, share: float
) -> None:
    settings, works = parse({"scenario": "s"}, origin="test"), list[Collecting]()

    def build(context: Context) -> Learner:
        works.append(Collecting("body", stage.clock, wanted=0, quantum_secs=0.0))
        works[0].said = said
        return Learner(context, works, service="encoder_learner", fingerprint="0" * 16)

    stage = LearnerStage(settings, tmp_path, build)
    heard = Inbox()
    stage.hub.connect("listener").subscribe("ack", keys.ack(RUN, "actor-1", "encoder_learner"), heard)
    stage.start("encoder_learner-1")
    stage.actor_appears("actor-1")
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.poll()
    acks = [decode(frame.data) for frame in heard.take_all() if isinstance(frame, Frame)]
    assert [ack.progress for ack in acks if isinstance(ack, Ack) and ack.term == 1][-1:] == [share]
