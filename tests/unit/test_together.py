"""Several blocks' models in one call: the same numbers as one by one."""

from itertools import pairwise

import numpy as np
import onnx
import pytest

from babble.onnx_model import EncoderWeights, Layer, PolicyWeights, encoder_onnx, policy_onnx
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from babble.policy.together import Encoders, Policies

SIZES = {"index": (3, 2, 3), "thumb": (2, 4, 2), "hand": (6, 3, 5)}
"""By block: what it observes, its latent dimension, its actions."""
COLUMNS = 5


def layers(rng: np.random.Generator, *sizes: int) -> list[Layer]:
    return [
        Layer(
            rng.standard_normal((out, into)).astype(np.float32),
            rng.standard_normal(out).astype(np.float32),
        )
        for into, out in pairwise(sizes)
    ]


def encoder_of(block: str, prefix: str) -> EncoderModel:
    n, d, _ = SIZES[block]
    rng = np.random.default_rng(n)
    mean = rng.standard_normal(n).astype(np.float32)
    return EncoderModel(encoder_onnx(EncoderWeights(mean, 1.5, layers(rng, n, 8, d)), prefix))


def policy_of(block: str, prefix: str) -> PolicyModel:
    n, d, a = SIZES[block]
    rng = np.random.default_rng(10 + n)
    deviations = rng.standard_normal(a).astype(np.float32)
    return PolicyModel(policy_onnx(PolicyWeights(d, layers(rng, 2 * d, 8, a), deviations), prefix))


def seen() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {b: rng.standard_normal((COLUMNS, n)).astype(np.float32) for b, (n, _, _) in SIZES.items()}


def on_simplex(seed: int) -> dict[str, np.ndarray]:
    rng = np.random.default_rng(seed)
    return {b: rng.dirichlet(np.ones(d), COLUMNS).astype(np.float32) for b, (_, d, _) in SIZES.items()}


def test_joined_encoders_find_what_each_finds_alone() -> None:
    models = {block: encoder_of(block, block) for block in SIZES}
    found = Encoders(models).latents(seen())
    assert list(found) == list(SIZES)
    for block, model in models.items():
        np.testing.assert_allclose(found[block], model.latent(seen()[block]), atol=1e-6)


def test_joined_policies_have_the_means_and_probabilities_of_each_alone() -> None:
    models = {block: policy_of(block, block) for block in SIZES}
    policies, z, g = Policies(models), on_simplex(1), on_simplex(2)
    means = policies.means(z, g)
    drawn = policies.act(z, g, np.random.default_rng(3), "sampled")
    certain = policies.act(z, g, np.random.default_rng(3), "mean")
    for block, model in models.items():
        mean, log_std = model.distribution(z[block], g[block])
        np.testing.assert_allclose(means[block], mean, atol=1e-5)
        np.testing.assert_allclose(certain[block][0], mean, atol=1e-5)
        action, log_prob = drawn[block]
        standard = (action - mean) / np.exp(log_std)
        expected = (-0.5 * standard**2 - log_std - 0.5 * np.log(2 * np.pi)).sum(axis=1)
        np.testing.assert_allclose(log_prob, expected, atol=1e-3)
        assert np.abs(standard).max() > 0.1, "sampled actions are not the mean"


def test_samples_of_joined_policies_have_the_deviation_of_each() -> None:
    models = {block: policy_of(block, block) for block in SIZES}
    columns = 4000
    z = {b: np.full((columns, d), 1 / d, np.float32) for b, (_, d, _) in SIZES.items()}
    drawn = Policies(models).act(z, z, np.random.default_rng(0), "sampled")
    for block, model in models.items():
        _, log_std = model.distribution(z[block][:1], z[block][:1])
        np.testing.assert_allclose(drawn[block][0].std(axis=0), np.exp(log_std[0]), rtol=0.06)


@pytest.mark.parametrize("prefix", ["", "same"])
def test_models_whose_names_are_not_their_own_still_run(prefix: str) -> None:
    models = {block: encoder_of(block, prefix) for block in SIZES}
    found = Encoders(models).latents(seen())
    for block, model in models.items():
        np.testing.assert_array_equal(found[block], model.latent(seen()[block]))


def with_inner_names_of(model: EncoderModel) -> EncoderModel:
    """The same model, in which only inputs and outputs have the block's name."""
    proto = onnx.load_from_string(model.onnx)
    for constant in proto.graph.initializer:
        constant.name = constant.name.removeprefix(model.prefix)
    for node in proto.graph.node:
        constants = {constant.name for constant in proto.graph.initializer}
        plain = [name.removeprefix(model.prefix) for name in node.input]
        node.input[:] = [
            short if short in constants else name for name, short in zip(node.input, plain, strict=True)
        ]
    return EncoderModel(proto.SerializeToString())


def test_models_that_would_mix_each_others_numbers_up_run_one_by_one() -> None:
    models = {
        block: with_inner_names_of(
            EncoderModel(
                encoder_onnx(
                    EncoderWeights(np.zeros(2, np.float32), 1.0, layers(np.random.default_rng(seed), 2, 4)),
                    block,
                )
            )
        )
        for seed, block in enumerate(["thumb", "toe"])
    }
    observation = np.random.default_rng(5).standard_normal((COLUMNS, 2)).astype(np.float32)
    found = Encoders(models).latents(dict.fromkeys(models, observation))
    for block, model in models.items():
        np.testing.assert_array_equal(found[block], model.latent(observation))


def test_a_block_that_sees_too_much_is_named_by_size() -> None:
    encoders = Encoders({block: encoder_of(block, block) for block in SIZES})
    wrong = {**seen(), "thumb": np.zeros((COLUMNS, 7), np.float32)}
    with pytest.raises(ModelError, match=r"observation of size 2, got shape \(5, 7\)"):
        encoders.latents(wrong)
