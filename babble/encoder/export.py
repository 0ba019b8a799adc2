"""From the trained encoder to the model that actors run."""

import numpy as np
import torch

from babble.encoder.network import Encoder
from babble.onnx_model import CHECKED_ROWS, TOLERANCE, EncoderWeights, ExportError, Layer, encoder_onnx
from babble.policy.act import EncoderModel


def encoder_weights(encoder: Encoder) -> EncoderWeights:
    """The encoder as plain arrays (copies)."""
    layers = [
        Layer(part.weight.detach().numpy().copy(), part.bias.detach().numpy().copy())
        for part in encoder.layers
        if isinstance(part, torch.nn.Linear)
    ]
    return EncoderWeights(encoder.mean.numpy().copy(), encoder.scale.item(), layers)


def export_encoder(encoder: Encoder) -> bytes:
    """The encoder as ONNX, checked on random observations. Raises `ExportError` beyond 1e-5 of difference."""
    exported = encoder_onnx(encoder_weights(encoder))
    spread = np.random.default_rng(0).standard_normal((CHECKED_ROWS, encoder.observation_size))
    observation = (encoder.mean.numpy() + 2 * encoder.scale.item() * spread).astype(np.float32)
    with torch.no_grad():
        expected = encoder(torch.from_numpy(observation)).numpy()
    difference = float(np.abs(EncoderModel(exported).latent(observation) - expected).max())
    if not difference <= TOLERANCE:
        raise ExportError("encoder", difference)
    return exported
