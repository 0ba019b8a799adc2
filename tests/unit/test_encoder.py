import io

import numpy as np
import pytest
import torch

from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.memory import ExperienceMemory

TWO = {"sense": (2,)}
BOTH = {"sense": (3,), "eyes": (1, 8, 8, 3)}


def weights(encoder):
    return torch.cat([p.detach().flatten() for p in encoder.parameters()])


def trainer(seed=0, **settings):
    encoder = Encoder(TWO, 2, (16,), seed=seed)
    return EncoderTrainer(encoder, learning_rate=1e-2, batch=32, seed=seed, **settings)


def saved_and_loaded(state):
    """Through a file, as a checkpoint goes: data only, no code."""
    file = io.BytesIO()
    torch.save(state, file)
    file.seek(0)
    return torch.load(file, weights_only=True)


@pytest.fixture
def memory():
    """Two slow walks along the first axis; the second axis is noise."""
    rng = np.random.default_rng(0)
    held = ExperienceMemory(TWO)
    slow = np.sin(np.arange(400) / 40)[:, None] * [1.0, -1.0]
    observation = np.stack([slow, rng.standard_normal(slow.shape)], axis=2)
    held.extend("a", {"observation": observation}, np.zeros((400, 2)))
    return held


def test_latents_lie_on_the_simplex_row_by_row():
    z = Encoder({"sense": (5,)}, 3)(torch.randn(7, 5) * 10)
    assert z.shape == (7, 3)
    assert (z >= 0).all()
    np.testing.assert_allclose(z.detach().sum(dim=1), 1, rtol=1e-6)


def test_the_latent_of_an_observation_does_not_depend_on_its_batch():
    encoder, observation = Encoder({"sense": (4,)}, 3, seed=0), torch.randn(6, 4)
    alone = torch.cat([encoder(row[None]) for row in observation])
    np.testing.assert_allclose(alone.detach(), encoder(observation).detach(), rtol=1e-5)


def test_equation_10_by_hand():
    encoder = Encoder(TWO, 3, (4,), mean=[1.0, -1.0], scale=2.0, seed=3)
    observation = np.array([[0.5, 0.7]], np.float32)
    first, last = ((part.weight.detach().numpy(), part.bias.detach().numpy()) for part in encoder.layers)
    h = np.tanh((observation - [1.0, -1.0]) / 2.0 @ first[0].T + first[1])
    logits = h @ last[0].T + last[1]
    expected = np.exp(logits) / np.exp(logits).sum()
    np.testing.assert_allclose(encoder(torch.from_numpy(observation)).detach(), expected, rtol=1e-5)


def test_the_scaling_is_frozen(memory):
    mean, scale = memory.scaling()
    encoder = Encoder(TWO, 2, (16,), mean, scale, seed=0)
    fit = EncoderTrainer(encoder, learning_rate=1e-2, batch=32, seed=0)
    fit.begin_fit(5, 0.3)
    fit.update(memory, 20)
    fit.end_fit(0.5)
    np.testing.assert_array_equal(encoder.mean, mean)
    np.testing.assert_array_equal(encoder.scale, scale)


def test_the_seed_fixes_the_weights_and_leaves_torchs_own_generator_alone():
    torch.manual_seed(1)
    before = torch.get_rng_state()
    one, again, other = (Encoder(BOTH, 2, seed=seed) for seed in (5, 5, 6))
    assert torch.equal(torch.get_rng_state(), before)
    assert torch.equal(weights(one), weights(again))
    assert not torch.equal(weights(one), weights(other))


@pytest.mark.parametrize(
    ("mean", "scale"),
    [
        ([0.0], 1.0),
        ([0.0, 0.0], 0.0),
        ([0.0, 0.0], float("nan")),
        ([0.0, 0.0], [1.0, 1.0, 1.0]),
        ([0.0, 0.0], [1.0, -1.0]),
    ],
)
def test_a_wrong_scaling_is_refused(mean, scale):
    with pytest.raises(ValueError, match="a mean of 2 numbers and a positive scale"):
        Encoder(TWO, 2, mean=mean, scale=scale)


@pytest.mark.parametrize("similarity", ["l2", "cosine", "dot"])
def test_a_fit_finds_what_changes_slowly(memory, similarity):
    fit = trainer(similarity=similarity)
    fit.begin_fit(10, 0.3)
    first = fit.update(memory, 5)
    fit.update(memory, 200)
    last = fit.update(memory, 5)
    assert last["loss"] < first["loss"] - 0.1
    assert last["uniformity"] < first["uniformity"] - 0.1
    grid = torch.linspace(-1, 1, 21)
    with torch.no_grad():
        along = fit.encoder(torch.stack([grid, torch.zeros(21)], dim=1))[:, 0]
        across = fit.encoder(torch.stack([torch.zeros(21), grid], dim=1))[:, 0]
    assert abs(along[0] - along[-1]) > 0.5
    assert abs(across[0] - across[-1]) < 0.25


@pytest.mark.parametrize("blend", [0.25, 0.5, 1.0])
def test_blending_is_equation_13(memory, blend):
    fit = trainer()
    old = weights(fit.encoder)
    fit.begin_fit(5, 0.3)
    fit.update(memory, 20)
    new = weights(fit.encoder)
    assert (new - old).abs().max() > 0.01
    fit.end_fit(blend)
    np.testing.assert_allclose(weights(fit.encoder), (1 - blend) * old + blend * new, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("blend", [0.0, -0.1, 1.1])
def test_a_blend_outside_0_to_1_is_refused(blend):
    fit = trainer()
    fit.begin_fit(5, 0.3)
    with pytest.raises(ValueError, match="blend"):
        fit.end_fit(blend)


def test_there_is_no_update_outside_a_fit(memory):
    fit = trainer()
    for call in (lambda: fit.update(memory, 1), lambda: fit.end_fit(1.0)):
        with pytest.raises(RuntimeError, match="begin_fit"):
            call()
    fit.begin_fit(5, 0.3)
    fit.update(memory, 3)
    assert fit.updates_done == 3
    fit.end_fit()
    assert fit.updates_done == 0


def test_each_fit_begins_with_a_fresh_optimiser(memory):
    fit = trainer()
    fit.begin_fit(5, 0.3)
    fit.update(memory, 3)
    used = len(fit.state()["optimiser"]["state"])
    fit.end_fit()
    fit.begin_fit(5, 0.3)
    assert used > 0
    assert fit.state()["optimiser"]["state"] == {}


def test_a_trainer_restored_in_the_middle_of_a_fit_goes_on_bit_for_bit(memory):
    fit = trainer()
    fit.begin_fit(5, 0.3)
    fit.update(memory, 7)
    state = saved_and_loaded(fit.state())
    other = trainer(seed=9)
    other.restore(state)
    assert other.updates_done == 7
    for each in (fit, other):
        each.update(memory, 5)
        each.end_fit(0.5)
    assert torch.equal(weights(fit.encoder), weights(other.encoder))


def test_a_state_does_not_change_as_training_goes_on(memory):
    fit = trainer()
    fit.begin_fit(5, 0.3)
    fit.update(memory, 2)
    state = fit.state()
    kept = {name: value.clone() for name, value in state["encoder"].items()}
    moments = [moment["exp_avg"].clone() for moment in state["optimiser"]["state"].values()]
    fit.update(memory, 5)
    assert all(torch.equal(state["encoder"][name], kept[name]) for name in kept)
    after = [moment["exp_avg"] for moment in state["optimiser"]["state"].values()]
    assert all(torch.equal(a, b) for a, b in zip(after, moments, strict=True))


def test_a_state_between_fits_can_be_restored(memory):
    other = trainer(seed=1)
    other.restore(saved_and_loaded(trainer(seed=0).state()))
    assert torch.equal(weights(other.encoder), weights(trainer(seed=0).encoder))
    other.begin_fit(5, 0.3)
    other.update(memory, 1)


def test_a_loss_that_is_not_finite_stops_the_fit(memory):
    fit = trainer()
    with torch.no_grad():
        fit.encoder.layers[0].weight.fill_(float("nan"))
    fit.begin_fit(5, 0.3)
    with pytest.raises(FloatingPointError, match="loss is nan"):
        fit.update(memory, 1)
