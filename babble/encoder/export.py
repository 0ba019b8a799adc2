"""From the trained encoder to the model that actors run."""

import numpy as np
import torch
from torch import nn

from babble.encoder.network import Encoder
from babble.encoder.vision import PADDING, STRIDE, Eyes
from babble.onnx_model import (
    CHECKED_ROWS,
    TOLERANCE,
    EncoderWeights,
    ExportError,
    EyesWeights,
    Layer,
    encoder_onnx,
)
from babble.policy.act import EncoderModel


def encoder_weights(encoder: Encoder) -> EncoderWeights:
    """The encoder as plain arrays (copies)."""
    images = zip(encoder.eyes, encoder.layout.images, strict=True)
    return EncoderWeights(
        encoder.mean.numpy().copy(),
        encoder.scale.numpy().copy(),
        [_layer(part) for part in encoder.layers],
        [_eyes_weights(eyes, encoder.layout.slices[name].start) for eyes, name in images],
        simplex=encoder.output == "softmax",
    )


def export_encoder(encoder: Encoder, block: str = "") -> bytes:
    """The encoder as ONNX, checked on random observations. Raises `ExportError` beyond 1e-5 of difference.

    Latents off the simplex may be large: over 1, the largest of them is the unit of the difference.
    With the name of its `block` it can be joined with those of others (babble.policy.together).
    """
    exported = encoder_onnx(encoder_weights(encoder), block)
    spread = np.random.default_rng(0).standard_normal((CHECKED_ROWS, encoder.observation_size))
    observation = (encoder.mean.numpy() + 2 * encoder.scale.numpy() * spread).astype(np.float32)
    with torch.no_grad():
        expected = encoder(torch.from_numpy(observation)).numpy()
    found = EncoderModel(exported).latent(observation)
    difference = float(np.abs(found - expected).max() / max(1.0, np.abs(expected).max()))
    if not difference <= TOLERANCE:
        raise ExportError("encoder", difference)
    return exported


def _layer(part: nn.Linear | nn.Conv2d) -> Layer:
    return Layer(part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy())


def _eyes_weights(eyes: Eyes, start: int) -> EyesWeights:
    convolutions = [_layer(part) for part in eyes.convolutions]
    return EyesWeights(start, eyes.shape, convolutions, STRIDE, PADDING, _layer(eyes.readout))
