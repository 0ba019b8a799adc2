"""One learner of many blocks: nobody starves, nothing is refused for its size, the disk is asked once."""

from collections.abc import Mapping
from pathlib import Path

import pytest

from protocol.codec import decode, encode
from protocol.messages import Phase, PhaseAnnounced, Progress, Score, Segment, Status
from services.runtime.clock import HandClock
from services.runtime.errors import CheckpointError
from services.runtime.intake import Want
from services.runtime.learner import ADVANCE_SECS, Learner
from services.runtime.models import ModelKind, ModelOffer
from services.runtime.process import Context
from services.runtime.settings import MOST_BLOCKS, parse
from services.runtime.work import Work
from tests.unit.learner_stage import LearnerStage

MEASURES = 11
"""of a policy"""
QUANTUM_SECS = 0.1
SETTINGS = parse({"scenario": "many"}, origin="test")


class CountingWork:
    """Counts its quanta and the times it was asked for its state; a quantum takes a while of the clock."""

    kind: ModelKind = "policy"

    def __init__(self, block: str, clock: HandClock, wanted: int, quantum_secs: float) -> None:
        self.block, self.quanta, self.asked = block, 0, 0
        self._clock, self._wanted, self._quantum_secs = clock, wanted, quantum_secs
        self._version = 0

    def begin(self, announced: PhaseAnnounced) -> None:
        self.quanta = 0

    def take(self, segment: Segment) -> bool:
        return False

    def advance(self) -> bool:
        if self.quanta >= self._wanted:
            return False
        self.quanta += 1
        self._clock.advance(self._quantum_secs)
        return True

    def wanted_columns(self) -> int:
        return 0

    def request(self) -> tuple[Want, int]:
        return "sampled", 0

    def progress(self) -> Progress:
        return Progress(block=self.block, done=self.quanta, wanted=self._wanted, unit="updates")

    def model(self) -> ModelOffer | None:
        if self._version == 0:
            return None
        return ModelOffer(kind="policy", version=self._version, encoder_version=1, onnx=b"frozen", keep=False)

    def scores(self) -> list[Score]:
        return [
            Score(
                run="r", block=self.block, iteration=1, phase=Phase.PRACTISE, separation=0.5,
                separation_worst=0.5, z_min=0.5, z_goal=0.5, switch_success=0.5, crossing=0.5, policy=policy,
                landmarks={"open": 0.5, "closed": 0.5}, landmark_vertices={"open": 0, "closed": 1},
                external_reward=0.1, external_reward_by_vertex=[0.1, 0.2], steps=1,
            )
            for policy in ("mean", "sampled")
        ]  # fmt: skip

    def metrics(self) -> Mapping[str, float]:
        return {f"{self.block}/policy/measure-{number}": 0.5 for number in range(MEASURES)}

    def totals(self) -> Mapping[str, int]:
        return {f"{self.block}/policy_updates": self.quanta, f"{self.block}/too_old_columns": 0}

    def freeze(self, version: int, onnx: bytes) -> None:
        self._version = version

    def state(self) -> bytes:
        self.asked += 1
        return bytes([self._version])

    def restore(self, state: bytes) -> None:
        self._version = state[0]


class ManyStage(LearnerStage):
    """A learner of `blocks` blocks."""

    def __init__(self, run_dir: Path, blocks: int, wanted: int = 5, quantum_secs: float = 0.0) -> None:
        super().__init__(SETTINGS, run_dir, self._built)
        self.names = [f"b{number}" for number in range(blocks)]
        self.works = {name: CountingWork(name, self.clock, wanted, quantum_secs) for name in self.names}
        self.start("learner")

    def _built(self, context: Context) -> Learner:
        works: list[Work] = list(self.works.values())
        return Learner(context, works, service="policy_learner", fingerprint="0" * 16)

    @property
    def checkpoints(self) -> int:
        folder = self.run_dir / "checkpoints" / "policy_learner"
        return max(int(path.stem) for path in folder.glob("*.checkpoint"))


@pytest.mark.parametrize("blocks", [24, MOST_BLOCKS])
def test_a_status_of_many_blocks_is_none_too_large_and_each_block_is_told_in_time(
    tmp_path: Path, blocks: int
) -> None:
    stage = ManyStage(tmp_path, blocks)
    stage.announce(Phase.EVALUATE, 1, stage.names)
    measured: set[str] = set()
    for _ in range(30):
        stage.poll(2)
        measured |= {name for name in stage.status("learner").metrics if "/policy/" in name}
    assert len(measured) == blocks * MEASURES
    said = stage.status("learner")
    assert decode(encode(said)) == said, "what is sent is understood"
    assert (len(said.progress), len(said.scores)) == (blocks, 2 * blocks)
    assert isinstance(said, Status)


def test_acknowledgements_need_not_wait_until_all_blocks_have_had_their_turn(tmp_path: Path) -> None:
    stage = ManyStage(tmp_path, blocks=60, wanted=1000, quantum_secs=QUANTUM_SECS)
    stage.announce(Phase.REFINE, 1, stage.names)
    service = stage.services["learner"]
    for _ in range(90):
        began_secs = stage.clock.now_secs()
        assert service.poll(began_secs) == 0.0, "there is more to do"
        assert stage.clock.now_secs() - began_secs <= ADVANCE_SECS + QUANTUM_SECS
    quanta = [work.quanta for work in stage.works.values()]
    assert min(quanta) >= 3
    assert max(quanta) - min(quanta) <= 1, "each has its turn"


def test_blocks_that_end_together_are_in_one_checkpoint(tmp_path: Path) -> None:
    stage = ManyStage(tmp_path, blocks=18)
    stage.announce(Phase.REFINE, 1, stage.names)
    stage.poll(1)
    before = stage.checkpoints
    stage.poll(10)
    assert all(progress.finished for progress in stage.status("learner").progress)
    assert stage.checkpoints == before + 1


def test_a_work_at_rest_is_asked_for_its_state_once_a_level(tmp_path: Path) -> None:
    stage = ManyStage(tmp_path, blocks=3)
    below, above = stage.names[:2], stage.names[2:]
    stage.announce(Phase.EVALUATE, 1, below)
    stage.poll()
    for work in stage.works.values():
        work.asked = 0
    for term, phase in enumerate((Phase.BABBLE, Phase.ENCODE, Phase.GROUND), start=2):
        stage.announce(phase, term, above)
        stage.poll(10)
    assert [stage.works[name].asked for name in below] == [1, 1]
    assert stage.works[above[0]].asked > 3


def test_two_learners_of_the_same_index_are_one_too_many(tmp_path: Path) -> None:
    stage = ManyStage(tmp_path, blocks=2)
    with pytest.raises(
        CheckpointError, match=r"another process is this learner already.* --index"
    ) as refusal:
        stage.start("twin")
    assert "\n" not in str(refusal.value)
    stage.start("other", index=1)
    stage.crash("learner")
    stage.start("reborn")
