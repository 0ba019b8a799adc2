"""An encoder with eyes: it learns what only they see; without them it is what it always was."""

import io

import numpy as np
import pytest
import torch

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder, weight_bytes
from babble.encoder.training import EncoderTrainer
from babble.encoder.vision import Eyes
from babble.memory import ExperienceMemory
from babble.policy.act import EncoderModel

SIDE = 16
BLIND = {"joints": (3,)}
SEEING = {"joints": (3,), "eyes": (1, SIDE, SIDE, 3)}


def observed(position, rng):
    """The joints are noise; the eye sees a bright ball at `position` (...) of -1 to 1, before a wall."""
    column, row = np.meshgrid(np.arange(SIDE), np.arange(SIDE))
    centre = (SIDE - 1) / 2 * (1 + position[..., None, None])
    ball = np.exp(-((column - centre) ** 2 + (row - SIDE / 2) ** 2) / 8)
    wall = np.linspace(0, 80, SIDE * SIDE * 3).reshape(SIDE, SIDE, 3)
    image = np.rint(wall + 150 * ball[..., None])
    joints = rng.standard_normal((*position.shape, 3))
    return np.concatenate([joints, image.reshape(*position.shape, -1)], axis=-1).astype(np.float32)


def fitted(senses, updates=100):
    """An encoder fitted to walks of 8 columns along the line; it is given the senses named."""
    rng = np.random.default_rng(0)
    walk = np.cumsum(0.1 * rng.standard_normal((300, 8)), axis=0) + rng.uniform(-1, 1, 8)
    position = np.abs((walk - 1) % 4 - 2) - 1  # reflected at both ends
    memory = ExperienceMemory(senses)
    observation = observed(position, rng)[..., : memory.layout.size]
    memory.extend("a", memory.layout.pack(observation), np.zeros(position.shape))
    encoder = Encoder(senses, 2, (32,), *memory.scaling(), seed=0)
    trainer = EncoderTrainer(encoder, learning_rate=2e-3, batch=64)
    trainer.begin_fit(10, 0.3)
    trainer.update(memory, updates)
    return trainer


def correlation(encoder):
    """Of the published model's latent with the position, on observations that it has not seen."""
    position = np.linspace(-1, 1, 200)
    observation = observed(position, np.random.default_rng(1))[:, : encoder.observation_size]
    latent = EncoderModel(export_encoder(encoder)).latent(observation)[:, 0]
    return abs(np.corrcoef(position, latent)[0, 1])


def test_an_encoder_learns_a_position_that_only_its_eye_sees():
    assert correlation(fitted(SEEING).encoder) > 0.95
    assert correlation(fitted(BLIND).encoder) < 0.3


def test_a_fit_with_images_restored_in_its_middle_goes_on_bit_for_bit():
    straight, file = fitted(SEEING, updates=5), io.BytesIO()
    torch.save(straight.state(), file)
    file.seek(0)
    other = EncoderTrainer(Encoder(SEEING, 2, (32,), seed=3), learning_rate=2e-3, batch=64)
    other.restore(torch.load(file, weights_only=True))
    memory = ExperienceMemory(SEEING)
    observation = observed(np.random.default_rng(2).uniform(-1, 1, (20, 4)), np.random.default_rng(2))
    memory.extend("a", memory.layout.pack(observation), np.zeros((20, 4)))
    for each in (straight, other):
        each.update(memory, 3)
    for one, another in zip(straight.encoder.parameters(), other.encoder.parameters(), strict=True):
        assert torch.equal(one, another)


def test_eyes_share_their_weights_and_keep_their_places():
    torch.manual_seed(0)
    eyes, images = Eyes((2, 16, 16, 3)), torch.randn(3, 2, 16 * 16 * 3)
    left, right = eyes(images.flatten(1)).chunk(2, dim=1)
    swapped_left, swapped_right = eyes(images.flip(1).flatten(1)).chunk(2, dim=1)
    torch.testing.assert_close(left, swapped_right)
    torch.testing.assert_close(right, swapped_left)
    assert not torch.allclose(left, right, atol=0.1)


@pytest.mark.parametrize("shape", [(1, 16, 16, 3), (2, 64, 48, 3), (1, 128, 128, 3), (1, 8, 8, 3)])
def test_features_come_in_about_as_large_as_standardised_vectors_at_every_resolution(shape):
    torch.manual_seed(0)
    eyes = Eyes(shape)
    features = eyes(torch.randn(32, int(np.prod(shape))))
    assert features.shape == (32, shape[0] * 32)
    assert 0.3 < features.std() < 0.9


def test_without_images_the_network_is_the_same_as_ever():
    """Equation 10 on one vector: nothing but the linear layers, drawn in their order from the seed."""
    torch.manual_seed(5)
    layers = [torch.nn.Linear(3, 8), torch.nn.Linear(8, 2)]
    encoder = Encoder(BLIND, 2, (8,), [1.0, 2.0, 3.0], 0.7, seed=5)
    observation = torch.randn(20, 3)
    with torch.no_grad():
        h = (observation - torch.tensor([1.0, 2.0, 3.0])) / torch.tensor(0.7)
        expected = torch.softmax(layers[1](torch.tanh(layers[0](h))), dim=-1)
        assert torch.equal(encoder(observation), expected)
    assert len(list(encoder.parameters())) == 4


def test_what_one_observes_besides_the_images_changes_the_latent_too():
    encoder = Encoder({"a": (2,), "eyes": (1, 8, 8, 3), "b": (2,)}, 2, seed=0)
    observation = torch.zeros(5, 196)
    observation[1, 0] = observation[2, 60] = observation[3, 195] = 1.0
    latents = encoder(observation).detach()[:, 0]
    assert torch.equal(latents[0], latents[4])
    assert (latents[1:4] - latents[0]).abs().min() > 1e-4


def test_the_size_of_an_encoder_is_known_before_it_is_made():
    before = torch.get_rng_state()
    for senses, features in (({"touch": (300,)}, 32), ({"touch": (3,), "eyes": (2, 32, 16, 3)}, 9)):
        known = weight_bytes(senses, 5, (40, 20), vision_features=features)
        made = Encoder(senses, 5, (40, 20), vision_features=features, seed=0)
        assert known <= len(export_encoder(made)) < known + 8_000
    assert torch.equal(torch.get_rng_state(), before)
