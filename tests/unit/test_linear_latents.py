"""An encoder without the simplex (thesis 4.5, C3): trained, exported, joined and restored as others are."""

import numpy as np
import onnx
import pytest
import torch

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.memory import ExperienceMemory
from babble.policy.act import EncoderModel
from babble.policy.export import export_policy
from babble.policy.ppo import GoalPPO
from babble.policy.together import Encoders

FIVE = {"sense": (5,)}
MEAN, SCALE = [1.0, 2.0, 3.0, 4.0, 5.0], 0.5


def linear(seed=0, **changes):
    return Encoder(FIVE, 3, (16, 8), MEAN, SCALE, output="linear", seed=seed, **changes)


def observations(rows=100):
    return (np.array(MEAN) + np.random.default_rng(0).standard_normal((rows, 5))).astype(np.float32)


def computed(encoder, observation):
    with torch.no_grad():
        return np.asarray(encoder(torch.from_numpy(observation)).numpy())


def test_latents_are_what_the_softmax_would_be_taken_of():
    given = observations()
    found = computed(linear(), given)
    raised = np.exp(found)
    softmax = computed(Encoder(FIVE, 3, (16, 8), MEAN, SCALE, seed=0), given)
    np.testing.assert_allclose(raised / raised.sum(axis=1, keepdims=True), softmax, atol=1e-6)
    assert (np.abs(found.sum(axis=1) - 1) > 0.1).any()
    assert (found < 0).any()


@pytest.mark.parametrize("gain", [1.0, 300.0])
def test_the_exported_model_computes_the_same_and_has_no_softmax(gain):
    encoder = linear()
    with torch.no_grad():
        encoder.layers[-1].weight.mul_(gain)
    exported = export_encoder(encoder)
    operators = {node.op_type for node in onnx.load_model_from_string(exported).graph.node}
    assert "Softmax" not in operators
    expected = computed(encoder, observations())
    np.testing.assert_allclose(EncoderModel(exported).latent(observations()), expected, rtol=1e-4, atol=1e-5)


def test_a_linear_encoder_joins_one_with_a_simplex():
    models = {
        "free": EncoderModel(export_encoder(linear(), "free")),
        "bound": EncoderModel(export_encoder(Encoder(FIVE, 2, seed=1), "bound")),
    }
    joined = Encoders(models)
    assert joined._joined is not None
    latents = joined.latents(dict.fromkeys(models, observations(7)))
    for block, model in models.items():
        np.testing.assert_allclose(latents[block], model.latent(observations(7)), atol=1e-6)
    assert (np.abs(latents["free"].sum(axis=1) - 1) > 0.1).any()


def test_it_is_fitted_and_goes_on_from_a_checkpoint_with_the_same_model():
    memory, rng = ExperienceMemory(FIVE), np.random.default_rng(0)
    walk = np.cumsum(rng.normal(size=(200, 2, 5)), axis=0)
    memory.extend("a", {"observation": walk}, np.zeros((200, 2)))
    one, other = (EncoderTrainer(linear(seed), learning_rate=1e-2, batch=32) for seed in (0, 1))
    one.begin_fit(5, 0.3)
    first = one.update(memory, 5)["loss"]
    other.restore(one.state())
    for fit in (one, other):
        last = fit.update(memory, 60)["loss"]
        fit.end_fit(0.5)
        assert last < first
    assert export_encoder(one.encoder) == export_encoder(other.encoder)


def test_a_policy_learns_on_latents_of_any_size():
    ppo, rng, frame = GoalPPO(3, 2, steps=8, columns=4, minibatch=16), np.random.default_rng(0), (8, 4)
    latent = rng.normal(scale=20, size=(*frame, 3)).astype(np.float32)
    found = ppo.update(
        {
            "latent": latent,
            "next_latent": np.roll(latent, -1, axis=0),
            "goal": np.eye(3, dtype=np.float32)[rng.integers(0, 3, frame)],
            "action": rng.normal(size=(*frame, 2)).astype(np.float32),
            "log_prob": np.full(frame, -2.8, np.float32),
            "truncated": np.zeros(frame, np.uint8),
            "terminated": np.zeros(frame, np.uint8),
        }
    )
    assert np.isfinite(list(found.values())).all()
    assert export_policy(ppo)
