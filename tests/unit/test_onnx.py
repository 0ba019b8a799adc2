import subprocess
import sys

import numpy as np
import onnx
import pytest
import torch

import babble.encoder.export
import babble.policy.export
from babble.encoder.export import ExportError, encoder_weights, export_encoder
from babble.encoder.network import Encoder
from babble.observations import Layout
from babble.onnx_model import encoder_onnx, policy_onnx
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from babble.policy.export import export_policy
from babble.policy.goals import one_hot
from babble.policy.ppo import GoalPPO

THREE = {"sense": (3,)}


@pytest.fixture(scope="module")
def encoder_bytes():
    return export_encoder(Encoder(THREE, 2, (16, 8), mean=[1.0, 2.0, 3.0], scale=0.5, seed=0))


@pytest.fixture(scope="module")
def ppo():
    return GoalPPO(2, 3, hidden=(16,), log_std=-0.5)


@pytest.fixture(scope="module")
def policy_bytes(ppo):
    return export_policy(ppo)


@pytest.mark.parametrize(("n", "d", "hidden"), [(3, 2, (64, 64)), (14, 8, ()), (1, 3, (5, 4, 3))])
def test_the_encoder_computes_the_same_as_in_torch(n, d, hidden):
    rng = np.random.default_rng(0)
    encoder = Encoder({"sense": (n,)}, d, hidden, mean=rng.standard_normal(n), scale=3.0, seed=1)
    model = EncoderModel(export_encoder(encoder))
    assert (model.observation_size, model.latent_dim) == (n, d)
    for batch in (1, 16, 100):
        observation = (5 * rng.standard_normal((batch, n))).astype(np.float32)
        with torch.no_grad():
            expected = encoder(torch.from_numpy(observation)).numpy()
        found = model.latent(observation)
        assert found.dtype == np.float32
        np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.parametrize(
    "senses",
    [
        {"eyes": (2, 16, 16, 3)},
        {"joints": (4,), "eyes": (1, 20, 33, 3), "touch": (2, 3)},
        {"left": (1, 8, 8, 3), "joints": (4,), "right": (2, 9, 5, 3)},
        {"eyes": (2, 128, 128, 3), "joints": (1,)},
    ],
)
def test_an_encoder_of_several_senses_takes_one_flat_observation_and_computes_the_same(senses):
    rng = np.random.default_rng(0)
    n = Layout(senses).size
    mean, scale = 100 * rng.standard_normal(n), 50 * np.exp(rng.standard_normal(n))
    encoder = Encoder(senses, 3, (16,), mean=mean, scale=scale, seed=1)
    model = EncoderModel(export_encoder(encoder))
    assert (model.observation_size, model.latent_dim) == (n, 3)
    for batch in (1, 5):
        observation = rng.integers(0, 256, (batch, n)).astype(np.float32)
        with torch.no_grad():
            expected = encoder(torch.from_numpy(observation)).numpy()
        np.testing.assert_allclose(model.latent(observation), expected, atol=1e-6)


@pytest.mark.parametrize(("d", "a", "hidden"), [(2, 3, (64, 64)), (4, 1, (8,))])
def test_the_policy_computes_the_same_as_in_torch(d, a, hidden):
    rng = np.random.default_rng(0)
    ppo = GoalPPO(d, a, hidden=hidden, log_std=-1.0, seed=2)
    model = PolicyModel(export_policy(ppo))
    assert (model.latent_dim, model.action_size) == (d, a)
    for batch in (1, 16):
        z, g = rng.dirichlet(np.ones(d), batch).astype(np.float32), one_hot(rng.integers(0, d, batch), d)
        mean, log_std = model.distribution(z, g)
        np.testing.assert_allclose(mean, ppo.distribution(z, g)[0], atol=1e-6)
        np.testing.assert_allclose(log_std, np.full((batch, a), -1.0), atol=1e-6)


def test_sampled_actions_follow_the_distribution_and_know_their_probability(policy_bytes):
    model, rng = PolicyModel(policy_bytes), np.random.default_rng(0)
    z, g = np.full((20_000, 2), 0.5, np.float32), one_hot(np.zeros(20_000, int), 2)
    mean, log_std = model.distribution(z, g)
    action, log_prob = model.act(z, g, rng)
    np.testing.assert_allclose(action.mean(axis=0), mean[0], atol=0.02)
    np.testing.assert_allclose(action.std(axis=0), np.exp(log_std[0]), rtol=0.02)
    normal = torch.distributions.Normal(torch.from_numpy(mean), torch.from_numpy(np.exp(log_std)))
    expected = normal.log_prob(torch.from_numpy(action)).sum(dim=1)
    np.testing.assert_allclose(log_prob, expected, atol=1e-4)
    assert (action.dtype, log_prob.dtype) == (np.float32, np.float32)


def test_mean_actions_are_the_mean_and_use_no_chance(policy_bytes):
    model, rng = PolicyModel(policy_bytes), np.random.default_rng(0)
    before = rng.bit_generator.state
    z, g = np.full((2, 2), 0.5, np.float32), one_hot([0, 1], 2)
    action, log_prob = model.act(z, g, rng, "mean")
    np.testing.assert_array_equal(action, model.distribution(z, g)[0])
    np.testing.assert_allclose(log_prob, -3 * (-0.5 + 0.5 * np.log(2 * np.pi)), rtol=1e-5)
    assert rng.bit_generator.state == before


def test_the_seed_decides_the_actions(policy_bytes):
    model = PolicyModel(policy_bytes)
    z, g = np.full((4, 2), 0.5, np.float32), one_hot([0, 1, 0, 1], 2)
    one, again = (model.act(z, g, np.random.default_rng(3))[0] for _ in range(2))
    np.testing.assert_array_equal(one, again)


def test_the_same_weights_give_the_same_bytes(encoder_bytes):
    weights = encoder_weights(Encoder(THREE, 2, (16, 8), mean=[1.0, 2.0, 3.0], scale=0.5, seed=0))
    assert encoder_onnx(weights) == encoder_bytes


def test_the_model_file_is_valid_and_of_a_fixed_format(encoder_bytes, policy_bytes):
    for data in (encoder_bytes, policy_bytes):
        model = onnx.load_model_from_string(data)
        onnx.checker.check_model(model, full_check=True)
        assert (model.ir_version, model.opset_import[0].version) == (8, 17)


def test_an_export_that_computes_something_else_is_refused(monkeypatch, ppo):
    monkeypatch.setattr(
        babble.encoder.export, "encoder_weights", lambda _: encoder_weights(Encoder(THREE, 2, seed=1))
    )
    with pytest.raises(ExportError, match="off the network"):
        export_encoder(Encoder(THREE, 2, seed=0))
    other = policy_onnx(GoalPPO(2, 3, hidden=(16,), seed=8).export_weights())
    monkeypatch.setattr(babble.policy.export, "policy_onnx", lambda *_: other)
    with pytest.raises(babble.policy.export.ExportError, match="off the network"):
        export_policy(ppo)


def test_weights_that_are_not_numbers_are_not_exported():
    encoder = Encoder(THREE, 2, seed=0)
    with torch.no_grad():
        encoder.layers[0].bias.fill_(float("nan"))
    with pytest.raises(ExportError):
        export_encoder(encoder)


@pytest.mark.parametrize("data", [b"", b"not a model", bytes(range(256)) * 10])
def test_bytes_that_are_no_model_are_refused_in_one_sentence(data):
    for kind in (EncoderModel, PolicyModel):
        with pytest.raises(ModelError, match="not a model that ONNX Runtime reads") as caught:
            kind(data)
        assert "\n" not in str(caught.value)


def test_a_cut_off_model_is_refused(encoder_bytes):
    for length in range(1, len(encoder_bytes) - 1, 97):
        with pytest.raises(ModelError):
            EncoderModel(encoder_bytes[:length])


def test_a_model_of_the_other_kind_is_refused(encoder_bytes, policy_bytes):
    with pytest.raises(ModelError, match="the encoder has inputs latent, goal, expected observation"):
        EncoderModel(policy_bytes)
    with pytest.raises(ModelError, match="the policy has inputs observation, expected latent, goal"):
        PolicyModel(encoder_bytes)


def reshaped(data, **dims):
    model = onnx.load_model_from_string(data)
    for value in (*model.graph.input, *model.graph.output):
        if value.name in dims:
            shape = onnx.helper.make_tensor_value_info(value.name, onnx.TensorProto.FLOAT, dims[value.name])
            value.CopyFrom(shape)
    return model.SerializeToString()


@pytest.mark.parametrize("shape", [[1, 3], ["batch", "n"], ["batch", 3, 1]])
def test_a_model_of_another_shape_is_refused(encoder_bytes, shape):
    with pytest.raises(ModelError):
        EncoderModel(reshaped(encoder_bytes, observation=shape))


def test_inputs_that_do_not_fit_are_refused_in_one_sentence(encoder_bytes, policy_bytes):
    with pytest.raises(ModelError, match="takes observation of size 3, got shape"):
        EncoderModel(encoder_bytes).latent(np.zeros((2, 4), np.float32))
    with pytest.raises(ModelError, match=r"cannot run on latent \(2, 2\), goal \(3, 2\)"):
        PolicyModel(policy_bytes).distribution(np.zeros((2, 2), np.float32), np.zeros((3, 2), np.float32))


def test_what_an_actor_imports_holds_no_torch():
    program = """
import sys
import babble.blocks, babble.noise, babble.policy.act, babble.policy.goals, babble.scores, babble.segments
import babble.memory, babble.observations, babble.worlds
found = {"torch", "stable_baselines3", "onnx"} & set(sys.modules)
assert not found, found
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
