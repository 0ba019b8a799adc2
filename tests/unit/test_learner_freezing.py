"""A block whose level is done: it is its best version, for good, and is not trained again."""

from pathlib import Path

import numpy as np
import pytest

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.export import export_policy
from babble.policy.ppo import GoalPPO
from protocol import keys
from protocol.codec import decode
from protocol.messages import Frozen, Model, Phase
from services.encoder_learner.service import build as build_encoder_learner
from services.encoder_learner.work import EncoderWork
from services.policy_learner.service import build as build_policy_learner
from services.policy_learner.work import PolicyWork
from services.runtime.bus import Frame, Inbox
from services.runtime.errors import CheckpointError
from services.runtime.models import ModelKind, model_path
from services.runtime.settings import RunSettings, parse
from tests.unit.learner_stage import RUN, LearnerStage
from tests.unit.test_learner_works import (
    TABLE,
    announce,
    babbled,
    finish,
    grounded,
    new_encoder_work,
    new_policy_work,
    segment,
    settings_of,
    walk,
)

POINTS = np.random.default_rng(5).normal(size=(20, 3)).astype(np.float32)
FROZEN = Frozen(encoder=3, policy=7, of_encoder=1, of_policy=4)
"""Both were best before they were newest, 2 and 6."""


def two_level() -> RunSettings:
    blocks = [
        {"name": "x", "observes": [0], "drives": [0]},
        {"name": "yz", "observes": [1, 2], "drives": [1, 2]},
        {"name": "body", "children": ["x", "yz"]},
    ]
    return parse(TABLE | {"block": blocks}, origin="test")


def encoder_of_two_versions() -> tuple[EncoderWork, bytes]:
    """A work at version 2, and the ONNX of its version 1."""
    work = babbled(settings_of())
    work.begin(announce(Phase.ENCODE, 2))
    finish(work)
    first = work.model()
    walk(work)
    work.begin(announce(Phase.REFINE, 6))
    finish(work)
    assert first is not None
    return work, first.onnx


def policy_of_two_versions() -> tuple[PolicyWork, bytes]:
    """A work at version 2 with columns in hand, and the ONNX of its version 1."""
    work = grounded()
    first = work.model()
    assert first is not None
    work.take(segment(Phase.GROUND, 0, np.random.default_rng(1)))
    finish(work)
    work.take(segment(Phase.GROUND, 1, np.random.default_rng(2)))
    return work, first.onnx


def test_a_frozen_encoder_is_the_one_that_was_best_also_after_a_restart() -> None:
    work, best = encoder_of_two_versions()
    work.freeze(3, best)
    restarted = new_encoder_work(settings_of())
    restarted.restore(work.state())
    for each in (work, restarted):
        offer = each.model()
        assert offer is not None
        assert (offer.version, offer.keep) == (3, True)
        np.testing.assert_array_equal(
            EncoderModel(offer.onnx).latent(POINTS), EncoderModel(best).latent(POINTS)
        )


def test_a_frozen_policy_is_the_one_that_was_best_also_after_a_restart() -> None:
    work, best = policy_of_two_versions()
    z = np.eye(2, dtype=np.float32)
    newest = work.model()
    assert newest is not None
    assert np.abs(
        PolicyModel(newest.onnx).distribution(z, z)[0] - PolicyModel(best).distribution(z, z)[0]
    ).max()
    work.freeze(7, best)
    restarted = new_policy_work(settings_of())
    restarted.restore(work.state())
    for each in (work, restarted):
        offer = each.model()
        assert offer is not None
        assert (offer.version, offer.onnx, offer.keep) == (7, best, True)


def test_what_is_frozen_wants_nothing_and_does_nothing_whatever_it_was_in_the_middle_of() -> None:
    encoder = babbled(settings_of())
    encoder.begin(announce(Phase.ENCODE, 2))
    encoder.advance()
    encoder.freeze(5, encoder_of_two_versions()[1])
    policy, best = policy_of_two_versions()
    policy.freeze(5, best)
    for work in (encoder, policy):
        assert not work.advance()
        assert not work.take(segment(Phase.GROUND, 2, np.random.default_rng(1)))
        assert (work.wanted_columns(), work.progress(), list(work.scores())) == (0, None, [])


@pytest.mark.parametrize("kind", ["encoder", "policy"])
def test_a_model_of_another_block_is_not_frozen(kind: ModelKind) -> None:
    (encoder, encoded), (policy, acted) = encoder_of_two_versions(), policy_of_two_versions()
    work, foreign = (encoder, acted) if kind == "encoder" else (policy, encoded)
    for onnx in (foreign, b"nothing of the kind"):
        with pytest.raises(ValueError, match=kind):
            work.freeze(9, onnx)
    offer = work.model()
    assert offer is not None
    assert offer.version == 2


def keep(run_dir: Path, kind: ModelKind, version: int) -> bytes:
    """A version of x's model as an earlier learner would have kept it."""
    if kind == "encoder":
        onnx = export_encoder(Encoder({"position": (1,)}, 2, seed=version), "x")
    else:
        onnx = export_policy(GoalPPO(2, 1, steps=8, columns=4, minibatch=16, seed=version), "x")
    path = model_path(run_dir, "x", kind, version)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(onnx)
    return onnx


@pytest.mark.parametrize(("kind", "best", "version"), [("encoder", 1, 3), ("policy", 4, 7)])
def test_a_learner_whose_checkpoint_is_of_before_the_freeze_catches_up_and_trains_nothing_again(
    tmp_path: Path, kind: ModelKind, best: int, version: int
) -> None:
    onnx = keep(tmp_path, kind, best)
    build = build_encoder_learner if kind == "encoder" else build_policy_learner
    stage = LearnerStage(two_level(), tmp_path, build)
    stage.start("learner-a")
    stage.announce(Phase.BABBLE, 1, ("x", "yz"))
    stage.poll()
    stage.announce(Phase.BABBLE, 20, ("body",), {"x": FROZEN})
    stage.poll()
    for life in ("learner-a", "learner-b"):
        said = stage.status(life)
        assert said.versions[f"{kind}/x"] == version
        assert {progress.block for progress in said.progress} <= {"body"}
        assert said.totals[f"x/{kind}_updates"] == 0
        latecomer = Inbox()
        stage.hub.connect(f"late-{life}").subscribe("model", keys.model(RUN, kind, "x"), latecomer)
        (model,) = (decode(frame.data) for frame in latecomer.take_all() if isinstance(frame, Frame))
        assert isinstance(model, Model)
        assert (model.version, model.arrays["onnx"].tobytes()) == (version, onnx)
        assert model_path(tmp_path, "x", kind, version).read_bytes() == onnx
        if life == "learner-a":
            stage.crash(life)
            model_path(tmp_path, "x", kind, best).unlink()
            stage.start("learner-b")
            stage.poll()


@pytest.mark.parametrize("spoilt", [None, b"torn"])
def test_a_frozen_model_that_is_gone_or_torn_is_told_by_its_file(
    tmp_path: Path, spoilt: bytes | None
) -> None:
    stage = LearnerStage(two_level(), tmp_path, build_encoder_learner)
    path = model_path(tmp_path, "x", "encoder", FROZEN.of_encoder)
    if spoilt is not None:
        path.parent.mkdir(parents=True)
        path.write_bytes(spoilt)
    stage.start("learner-a")
    stage.announce(Phase.BABBLE, 20, ("body",), {"x": FROZEN})
    with pytest.raises(CheckpointError) as said:
        stage.poll()
    assert str(path) in str(said.value)
    assert "\n" not in str(said.value)
    assert "restore it" in str(said.value)
