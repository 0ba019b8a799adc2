"""The latent model: observation in, a point of the simplex out (thesis eq. 10)."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn


class Encoder(nn.Module):
    """x -> z = softmax(MLP((x - mean) / scale)), with tanh layers; z is (B, latent_dim), its rows sum to 1.

    `mean` and `scale` are part of the model and never trained: set once from phase 1 and frozen,
    else the encoder's input would move under it. `seed` fixes the initial weights without touching
    torch's global generator.
    """

    mean: Tensor
    scale: Tensor

    def __init__(
        self,
        observation_size: int,
        latent_dim: int,
        hidden: Sequence[int] = (64, 64),
        mean: ArrayLike | None = None,
        scale: float = 1.0,
        *,
        seed: int | None = None,
    ) -> None:
        super().__init__()
        if latent_dim < 2:
            raise ValueError(f"a simplex needs at least two vertices, got latent_dim {latent_dim}")
        self.observation_size = observation_size
        self.latent_dim = latent_dim
        self.hidden = tuple(hidden)
        self.register_buffer("mean", torch.zeros(observation_size))
        self.register_buffer("scale", torch.ones(()))
        with torch.random.fork_rng(devices=[], enabled=seed is not None):
            if seed is not None:
                torch.manual_seed(seed)
            sizes = [observation_size, *hidden, latent_dim]
            self.layers = nn.ModuleList(nn.Linear(n, m) for n, m in pairwise(sizes))
        self.normalise(np.zeros(observation_size) if mean is None else mean, scale)

    def normalise(self, mean: ArrayLike, scale: float) -> None:
        """Fix the observation's mean (n,) and scale. Raises ValueError for a wrong shape or scale <= 0."""
        given = torch.as_tensor(np.asarray(mean, dtype=np.float32))
        if given.shape != self.mean.shape or not np.isfinite(scale) or scale <= 0:
            raise ValueError(
                f"normalisation needs a mean of {self.observation_size} numbers and a positive scale, "
                f"got shape {tuple(given.shape)} and {scale}"
            )
        self.mean.copy_(given)
        self.scale.fill_(scale)

    def forward(self, observation: Tensor) -> Tensor:
        """(B, n) -> (B, d)."""
        h = (observation - self.mean) / self.scale
        for layer in list(self.layers)[:-1]:
            h = torch.tanh(layer(h))
        return torch.softmax(self.layers[-1](h), dim=-1)
