"""The latent model: observation in, a point of the simplex out (thesis eq. 10), or any point without it."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Literal

import numpy as np
import torch
from numpy.typing import ArrayLike
from torch import Tensor, nn

from babble.encoder.vision import FEATURES, Eyes
from babble.observations import VECTORS, Layout, Senses

Output = Literal["softmax", "linear"]


def weight_bytes(
    senses: Senses, latent_dim: int, hidden: Sequence[int], *, vision_features: int = FEATURES
) -> int:
    """What the weights of such an encoder and its scaling take, found without making room for them."""
    with torch.device("meta"):
        encoder = Encoder(senses, latent_dim, hidden, vision_features=vision_features)
    return sum(numbers.nbytes for numbers in encoder.state_dict().values())


class Encoder(nn.Module):
    """x -> z = softmax(MLP(v)), with tanh layers; z is (B, latent_dim), its rows sum to 1.

    With the `output` "linear" z = MLP(v): no simplex, any numbers (thesis 4.5, C3).

    v = (x - mean) / scale, in which `Eyes` have replaced the images by their features, put at the end.
    `mean` and `scale` are part of the model and never trained: set once from phase 1 and frozen,
    else the encoder's input would move under it. `seed` fixes the initial weights without touching
    torch's global generator.
    """

    mean: Tensor
    scale: Tensor

    def __init__(
        self,
        senses: Senses,
        latent_dim: int,
        hidden: Sequence[int] = (64, 64),
        mean: ArrayLike | None = None,
        scale: ArrayLike = 1.0,
        *,
        vision_features: int = FEATURES,
        output: Output = "softmax",
        seed: int | None = None,
    ) -> None:
        super().__init__()
        if latent_dim < 2:
            raise ValueError(f"a simplex needs at least two vertices, got latent_dim {latent_dim}")
        self.layout = Layout(senses)
        self.observation_size = self.layout.size
        self.latent_dim = latent_dim
        self.hidden = tuple(hidden)
        self.output = output
        self.register_buffer("mean", torch.zeros(self.observation_size))
        self.register_buffer("scale", torch.ones(self.observation_size))
        images = self.layout.images.values()
        joined = self.layout.parts.get(VECTORS, 0) + vision_features * sum(eyes for eyes, *_ in images)
        with torch.random.fork_rng(devices=[], enabled=seed is not None):
            if seed is not None:
                torch.manual_seed(seed)
            self.layers = nn.ModuleList(nn.Linear(n, m) for n, m in pairwise([joined, *hidden, latent_dim]))
            self.eyes = nn.ModuleList(Eyes(shape, vision_features) for shape in images)
        self.normalise(np.zeros(self.observation_size) if mean is None else mean, scale)

    def normalise(self, mean: ArrayLike, scale: ArrayLike) -> None:
        """Fix the observation's mean (n,) and its scale, one number or (n,).

        Raises ValueError for another shape, or a scale that is not above 0.
        """
        given, spread = np.asarray(mean, np.float32), np.asarray(scale, np.float32)
        fits = given.shape == self.mean.shape and spread.shape in ((), self.mean.shape)
        if not fits or not np.isfinite(spread).all() or spread.min() <= 0:
            raise ValueError(
                f"normalisation needs a mean of {self.observation_size} numbers and a positive scale, "
                f"got shape {given.shape} and a scale of shape {spread.shape} from {spread.min():g}"
            )
        self.mean.copy_(torch.from_numpy(given))
        self.scale.copy_(torch.from_numpy(spread))

    def forward(self, observation: Tensor) -> Tensor:
        """(B, n) -> (B, d)."""
        h = self._joined((observation - self.mean) / self.scale)
        for layer in list(self.layers)[:-1]:
            h = torch.tanh(layer(h))
        logits: Tensor = self.layers[-1](h)
        return logits if self.output == "linear" else torch.softmax(logits, dim=-1)

    def _joined(self, standardised: Tensor) -> Tensor:
        if not self.eyes:
            return standardised
        layout = self.layout
        of = {name: standardised[:, place] for name, place in layout.slices.items()}
        vectors = [numbers for name, numbers in of.items() if name not in layout.images]
        seen = [eyes(of[name]) for eyes, name in zip(self.eyes, layout.images, strict=True)]
        return torch.cat([*vectors, *seen], dim=1)
