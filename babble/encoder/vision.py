"""How images enter the latent model: a few features of each eye, by a small convolutional network."""

from itertools import pairwise

import torch
from torch import Tensor, nn

CHANNELS = (8, 16, 32)
"""Maps of each convolution; each halves height and width."""
KERNEL, STRIDE, PADDING = 3, 2, 1
FEATURES = 32
"""Numbers that an eye gives to the layers that join the senses."""


def halved(size: int) -> int:
    """Height or width after one convolution."""
    return (size + 2 * PADDING - KERNEL) // STRIDE + 1


class Eyes(nn.Module):
    """Images (B, eyes, height, width, channels), standardised -> features (B, eyes * features) in (-1, 1).

    The eyes share all weights, as what is to be seen does not depend on the eye. The maps are not pooled but
    read by a linear layer, since where something is matters more here than what it is. ReLU between the
    convolutions keeps the gradient over four layers, and its gain in the first weights keeps the variance:
    the features come in as large as standardised vectors do. tanh bounds them, as it does the other layers'.
    """

    def __init__(self, shape: tuple[int, ...], features: int = FEATURES) -> None:
        super().__init__()
        self.shape = shape
        self.eyes, height, width, channels = shape
        self.convolutions = nn.ModuleList(
            nn.Conv2d(n, m, KERNEL, STRIDE, PADDING) for n, m in pairwise((channels, *CHANNELS))
        )
        for _ in CHANNELS:
            height, width = halved(height), halved(width)
        self.readout = nn.Linear(CHANNELS[-1] * height * width, features)
        self.features = self.eyes * features
        for convolution in self.convolutions:
            nn.init.kaiming_uniform_(convolution.weight, nonlinearity="relu")
            nn.init.zeros_(convolution.bias)
        nn.init.kaiming_uniform_(self.readout.weight, nonlinearity="linear")
        nn.init.zeros_(self.readout.bias)

    def forward(self, images: Tensor) -> Tensor:
        """The images may also come flat, (B, eyes * height * width * channels)."""
        _, height, width, channels = self.shape
        seen = images.reshape(-1, height, width, channels).permute(0, 3, 1, 2)
        for convolution in self.convolutions:
            seen = torch.relu(convolution(seen))
        return torch.tanh(self.readout(seen.flatten(1))).reshape(-1, self.features)
