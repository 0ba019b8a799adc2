"""Encoder and policy works: a restart in the middle changes nothing, blending and floors hold."""

from typing import Any

import numpy as np
import pytest

from babble.observations import Layout, Senses
from babble.parts import Part
from babble.policy.act import EncoderModel, PolicyModel
from protocol.messages import ModelFloor, Phase, PhaseAnnounced, Segment
from services.encoder_learner import config as encoder_config
from services.encoder_learner.work import EncoderWork
from services.policy_learner import config as policy_config
from services.policy_learner.work import PolicyWork
from services.runtime.clock import Clock, HandClock
from services.runtime.settings import RunSettings, SettingsError, parse
from tests.unit.trees import tree_on

POSITION: Senses = {"position": (3,)}
TABLE: dict[str, Any] = {
    "scenario": "test",
    "actors": {"envs_per_actor": 4, "segment_steps": 8},
    "phases": {"babble_steps": 64, "ground_steps": 64, "practise_steps": 32, "walk_steps": 64},
    "encoder": {"batch": 16, "encode": {"updates": 60}, "refine": {"updates": 30, "window_steps": 3}},
    "policy": {"rollout_columns": 4, "epochs": 2, "minibatch": 16},
}


def settings_of(**changes: Any) -> RunSettings:
    return parse(TABLE | changes, origin="test")


def announce(
    phase: Phase, term: int, encoder: int = 0, policy: int = 0, iteration: int = 0
) -> PhaseAnnounced:
    return PhaseAnnounced(
        run="r", term=term, block="all", life="c", seq=0, phase=phase,
        evaluates=Phase.GROUND if phase is Phase.EVALUATE else None,
        blocks={"body": ModelFloor(encoder=encoder)},
    )  # fmt: skip


def segment(phase: Phase, seq: int, rng: np.random.Generator, **header: Any) -> Segment:
    steps, columns = 8, 4
    if phase in (Phase.BABBLE, Phase.WALK):
        walk = np.cumsum(rng.normal(size=(steps, columns, 3)), axis=0).astype(np.float32)
        arrays = {"observation": walk, "episode": np.zeros((steps, columns), np.int32)}
    else:
        z = rng.dirichlet([1, 1], (steps, columns)).astype(np.float32)
        arrays = {
            "latent": z,
            "next_latent": np.roll(z, -1, axis=0),
            "goal": np.eye(2, dtype=np.float32)[rng.integers(0, 2, (steps, columns))],
            "action": rng.normal(size=(steps, columns, 3)).astype(np.float32),
            "log_prob": rng.normal(size=(steps, columns)).astype(np.float32),
            "truncated": np.zeros((steps, columns), np.uint8),
            "terminated": np.zeros((steps, columns), np.uint8),
        }
    consumer = "encoder_learner" if "observation" in arrays else "policy_learner"
    fields: dict[str, Any] = {"encoder_version": 1, "policy_version": 1, "policy": "sampled"} | header
    return Segment(
        run="r", term=1, block="body", life="actor-1", seq=seq, consumer=consumer, fingerprint="0" * 16,
        phase=phase, steps=steps, columns=columns, first_step=0, arrays=arrays, **fields,
    )  # fmt: skip


def new_encoder_work(
    settings: RunSettings, senses: Senses = POSITION, clock: Clock | None = None
) -> EncoderWork:
    tree = tree_on(settings, Layout(senses).size, 3)
    config = encoder_config.work_config(settings, tree, senses, "body", 0)
    return EncoderWork(config, clock or HandClock())


def new_policy_work(settings: RunSettings) -> PolicyWork:
    tree = tree_on(settings, 3, 3)
    return PolicyWork(
        policy_config.work_config(
            settings, tree, "body", 0, run="r", posture_size=3, part=Part(np.arange(3), 2.0, None, ())
        )
    )


def babbled(settings: RunSettings, clock: Clock | None = None) -> EncoderWork:
    work, rng = new_encoder_work(settings, clock=clock), np.random.default_rng(0)
    work.begin(announce(Phase.BABBLE, 1))
    for seq in range(2):
        assert work.take(segment(Phase.BABBLE, seq, rng, policy="random"))
    assert work.wanted_columns() == 0
    return work


def walk(work: EncoderWork) -> None:
    """The experience of a WALK, in which nothing of before is left."""
    work.begin(announce(Phase.WALK, 5))
    assert work.wanted_columns() == 8
    rng = np.random.default_rng(7)
    for seq in range(2):
        assert work.take(segment(Phase.WALK, seq, rng).model_copy(update={"first_step": 8 * seq}))


def finish(work: EncoderWork | PolicyWork) -> None:
    while work.advance():
        pass


def test_an_encoder_restarted_in_the_middle_of_a_fit_ends_with_the_same_model() -> None:
    straight = babbled(settings_of())
    straight.begin(announce(Phase.ENCODE, 2))
    straight.advance()
    restarted = new_encoder_work(settings_of())
    restarted.restore(straight.state())
    finish(straight)
    finish(restarted)
    one, other = straight.model(), restarted.model()
    assert one is not None
    assert one == other
    assert one.version == 1


def test_blending_lands_between_the_old_and_the_new_encoder() -> None:
    answers = {}
    points = np.random.default_rng(5).normal(size=(50, 3)).astype(np.float32)
    for blend in (1.0, 0.25):
        work = babbled(settings_of(encoder=TABLE["encoder"] | {"blend": blend}))
        work.begin(announce(Phase.ENCODE, 2))
        finish(work)
        first = work.model()
        walk(work)
        work.begin(announce(Phase.REFINE, 6))
        finish(work)
        second = work.model()
        assert first is not None
        assert second is not None
        answers[blend] = [EncoderModel(offer.onnx).latent(points) for offer in (first, second)]
    old, new = answers[1.0]
    same_old, blended = answers[0.25]
    np.testing.assert_array_equal(old, same_old)
    assert 0 < np.abs(blended - old).mean() < np.abs(new - old).mean()


def test_an_encoder_of_no_updates_is_published_untrained_for_the_control() -> None:
    work = babbled(settings_of(encoder=TABLE["encoder"] | {"encode": {"updates": 0}}))
    work.begin(announce(Phase.ENCODE, 2))
    finish(work)
    progress = work.progress()
    assert work.model() is not None
    assert progress is not None
    assert progress.done == progress.wanted


def grounded() -> PolicyWork:
    work = new_policy_work(settings_of())
    work.begin(announce(Phase.GROUND, 3, encoder=1))
    return work


def test_each_update_is_a_version_and_the_last_one_is_kept() -> None:
    work, rng = grounded(), np.random.default_rng(1)
    kept = []
    for seq in range(2):
        version = work.model()
        assert version is not None
        assert work.wanted_columns() == 4
        assert work.take(segment(Phase.GROUND, seq, rng, policy_version=version.version))
        finish(work)
        offer = work.model()
        assert offer is not None
        kept.append((offer.version, offer.keep))
    assert kept == [(2, False), (3, True)]
    assert work.wanted_columns() == 0
    assert not work.take(segment(Phase.GROUND, 2, rng)), "the phase has had its steps"


def test_a_policy_restarted_with_columns_in_hand_ends_with_the_same_model() -> None:
    straight, rng = grounded(), np.random.default_rng(1)
    straight.take(segment(Phase.GROUND, 0, rng))
    restarted = new_policy_work(settings_of())
    restarted.restore(straight.state())
    finish(straight)
    finish(restarted)
    one, other = straight.model(), restarted.model()
    assert one is not None
    assert one == other
    z = np.array([[0.3, 0.7]], np.float32)
    fresh = PolicyModel(grounded().model().onnx)  # type: ignore[union-attr]
    assert np.abs(PolicyModel(one.onnx).distribution(z, z)[0] - fresh.distribution(z, z)[0]).max() > 0


def test_experience_of_another_encoder_is_not_used() -> None:
    assert not grounded().take(segment(Phase.GROUND, 0, np.random.default_rng(1), encoder_version=2))


@pytest.mark.parametrize("spoilt", ["latent", "action", "log_prob"])
def test_experience_that_is_not_a_number_is_refused_by_name(spoilt: str) -> None:
    bad = segment(Phase.GROUND, 0, np.random.default_rng(1))
    bad.arrays[spoilt][0] = np.nan
    with pytest.raises(ValueError, match=spoilt):
        grounded().take(bad)


def test_positives_are_never_taken_across_missing_steps() -> None:
    work, rng = (
        new_encoder_work(settings_of(phases=TABLE["phases"] | {"babble_steps": 320})),
        np.random.default_rng(0),
    )
    work.begin(announce(Phase.BABBLE, 1))
    for seq, first_step in enumerate((0, 8, 24)):  # the steps 16 to 23 are missing
        taken = segment(Phase.BABBLE, seq, rng, policy="random").model_copy(update={"first_step": first_step})
        taken.arrays["observation"][:] = first_step + np.arange(8, dtype=np.float32)[:, None, None]
        assert work.take(taken)
    anchor, positive = work._memory.sample_pairs(rng, 2000, 12)
    apart = (positive - anchor)[:, 0]
    assert apart.max() <= 12
    assert not ((anchor[:, 0] < 16) & (positive[:, 0] >= 24)).any()
    assert ((anchor[:, 0] < 8) & (positive[:, 0] >= 8)).any(), "a border without a gap is crossed"


def test_positives_are_never_taken_across_a_segment_that_was_refused() -> None:
    work, rng = new_encoder_work(settings_of()), np.random.default_rng(0)
    work.begin(announce(Phase.BABBLE, 1))
    for seq in range(3):
        taken = segment(Phase.BABBLE, seq, rng).model_copy(update={"first_step": 8 * seq})
        taken.arrays["observation"][:] = 8 * seq + np.arange(8, dtype=np.float32)[:, None, None]
        if seq == 1:
            taken.arrays["observation"][3] = np.nan
            with pytest.raises(ValueError, match="not finite"):
                work.take(taken)
        else:
            assert work.take(taken)
    anchor, positive = work._memory.sample_pairs(rng, 500, 12)
    assert (positive - anchor).max() <= 7


EYES: Senses = {"joints": (2,), "eyes": (1, 8, 8, 3)}


def seen(seq: int, rng: np.random.Generator) -> Segment:
    """A segment with images."""
    plain = segment(Phase.BABBLE, seq, rng, policy="random")
    layout, walk = Layout(EYES), plain.arrays["observation"]
    observation = np.concatenate([walk[..., :2], rng.integers(0, 256, (8, 4, 192))], axis=-1)
    return plain.model_copy(
        update={"arrays": layout.pack(observation.astype(np.float32)) | {"episode": plain.arrays["episode"]}}
    )


def test_an_encoder_of_images_restarted_in_the_middle_ends_with_the_same_model() -> None:
    settings = settings_of(encoder=TABLE["encoder"] | {"encode": {"updates": 30}})
    straight, rng = new_encoder_work(settings, EYES), np.random.default_rng(0)
    straight.begin(announce(Phase.BABBLE, 1))
    assert straight.take(seen(0, rng))
    restarted = new_encoder_work(settings, EYES)
    restarted.restore(straight.state())
    second = seen(1, rng).model_copy(update={"first_step": 8})
    for work in (straight, restarted):
        assert work.take(second)
        work.begin(announce(Phase.ENCODE, 2))
    straight.advance()
    restarted.restore(straight.state())
    finish(straight)
    finish(restarted)
    one = straight.model()
    assert one is not None
    assert one == restarted.model()
    assert EncoderModel(one.onnx).observation_size == 194


def test_experience_of_other_senses_is_refused_in_a_sentence() -> None:
    work, rng = new_encoder_work(settings_of(), EYES), np.random.default_rng(0)
    work.begin(announce(Phase.BABBLE, 1))
    with pytest.raises(
        ValueError, match="of actor-1/0: these senses are packed as observation of 2, image of 192"
    ):
        work.take(segment(Phase.BABBLE, 0, rng))


def test_each_block_learns_from_the_senses_that_it_observes() -> None:
    blocks = [
        {"name": "arm", "observes": [1, *range(2, 194)], "drives": [0]},
        {"name": "leg", "observes": [0], "drives": [1]},
        {"name": "both", "children": ["arm", "leg"]},
    ]
    settings = settings_of(block=blocks)
    tree = tree_on(settings, 194, 2)
    senses = [
        encoder_config.work_config(settings, tree, EYES, name, index).senses
        for index, name in enumerate(("arm", "leg", "both"))
    ]
    assert senses == [{"joints": (1,), "eyes": (1, 8, 8, 3)}, {"joints": (1,)}, {"latent": (4,)}]


def test_a_block_that_observes_part_of_an_image_is_refused_by_name() -> None:
    settings = settings_of(block=[{"observes": [0, 1, 2, 3]}])
    tree = tree_on(settings, 194, 3)
    with pytest.raises(SettingsError, match="block 'body': a block observes images whole"):
        encoder_config.work_config(settings, tree, EYES, "body", 0)


@pytest.mark.parametrize(("side", "steps", "refused"), [(64, 20_000, False), (128, 50_000, True)])
def test_experience_that_memory_cannot_hold_is_refused_at_the_start(
    side: int, steps: int, refused: bool
) -> None:
    settings = settings_of(phases=TABLE["phases"] | {"walk_steps": steps})
    senses = {"eyes": (2, side, side, 3)}
    tree = tree_on(settings, Layout(senses).size, 3)
    configs = [encoder_config.work_config(settings, tree, senses, "body", 0)]
    if refused:
        with pytest.raises(SettingsError, match=r"need 9.8 GB .* block 'body'.* limit of 8 GB; lower phases"):
            encoder_config.check_memory(configs)
    else:
        encoder_config.check_memory(configs)


@pytest.mark.parametrize(("hidden", "refused"), [(4000, False), (4200, True)])
def test_an_encoder_that_no_frame_holds_is_refused_at_the_start(hidden: int, refused: bool) -> None:
    settings = settings_of(encoder=TABLE["encoder"] | {"hidden": [hidden, hidden]})
    tree = tree_on(settings, 3, 3)
    configs = [encoder_config.work_config(settings, tree, POSITION, "body", 0)]
    if refused:
        with pytest.raises(SettingsError, match=r"block body would have 70.7 MB, .* lower encoder\.hidden"):
            encoder_config.check_models(configs)
    else:
        encoder_config.check_models(configs)


@pytest.mark.parametrize("spoilt", [{"goal": 7}, {"latent": np.nan}, {"posture": np.inf}])
def test_legs_that_cannot_be_scored_are_refused_and_leave_the_evaluation_as_it_was(
    spoilt: dict[str, float],
) -> None:
    work, rng = grounded(), np.random.default_rng(3)
    work.begin(announce(Phase.EVALUATE, 4, encoder=1))
    arrays: dict[str, Any] = {
        "start_posture": np.zeros((4, 3), np.float32),
        "posture": rng.normal(size=(5, 4, 3)).astype(np.float32),
        "latent": rng.dirichlet([1, 1], (5, 4)).astype(np.float32),
        "goal": rng.integers(0, 2, (5, 4)).astype(np.int32),
    }
    good = segment(Phase.GROUND, 0, rng, policy="mean").model_copy(
        update={"phase": Phase.EVALUATE, "arrays": arrays}
    )
    bad_arrays = {name: array.copy() for name, array in arrays.items()}
    for name, value in spoilt.items():
        bad_arrays[name][0, 0] = value
    with pytest.raises(ValueError, match="must be"):
        work.take(good.model_copy(update={"arrays": bad_arrays}))
    assert work.wanted_columns() == 16
    assert work.take(good)
    assert work.wanted_columns() == 12
