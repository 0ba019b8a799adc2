"""Contrastive learning through time: the InfoNCE loss (thesis eq. 4) and two measures of a latent."""

from typing import Literal

import torch
from torch import Tensor
from torch.nn import functional

Similarity = Literal["l2", "cosine", "dot"]

UNIFORMITY_SHARPNESS = 2.0
"""t of Wang & Isola (2020), eq. 3."""


def similarities(z: Tensor, other: Tensor, similarity: Similarity) -> Tensor:
    """sim(z_i, other_j) of all pairs, (B, C); "l2" is -||z - z'||^2. Raises ValueError for another name."""
    match similarity:
        case "l2":
            return -(z[:, None] - other[None]).square().sum(dim=-1)
        case "cosine":
            return functional.normalize(z, dim=-1) @ functional.normalize(other, dim=-1).T
        case "dot":
            return z @ other.T
        case _:
            raise ValueError(f"there is no similarity {similarity!r}; choose l2, cosine or dot")


def info_nce(
    z_anchor: Tensor, z_positive: Tensor, temperature: float, similarity: Similarity = "l2"
) -> Tensor:
    """Eq. 4 averaged over the batch: each anchor's positive against all positives of the batch; a scalar."""
    logits = similarities(z_anchor, z_positive, similarity) / temperature
    return functional.cross_entropy(logits, torch.arange(len(logits)))


def alignment(z_anchor: Tensor, z_positive: Tensor) -> Tensor:
    """Mean squared distance of positives (Wang & Isola 2020, alpha = 2); 0 when they coincide."""
    return (z_anchor - z_positive).square().sum(dim=-1).mean()


def uniformity(z: Tensor) -> Tensor:
    """Log of the mean Gaussian potential of all pairs (Wang & Isola 2020, t = 2); 0 when collapsed."""
    return torch.pdist(z).square().mul(-UNIFORMITY_SHARPNESS).exp().mean().log()
