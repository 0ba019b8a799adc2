"""Clouds whose extent and dimension are known."""

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]


def rotation(dims: int, seed: int = 0) -> NDArray[np.float64]:
    """(dims, dims): drawn evenly from all rotations and reflections."""
    matrix, upper = np.linalg.qr(np.random.default_rng(seed).standard_normal((dims, dims)))
    return np.asarray(matrix * np.sign(np.diag(upper)))


def embedded(points: NDArray[np.float64], dims: int = 98, seed: int = 0) -> Floats:
    """Points (N, d) in d of `dims` axes, turned."""
    return (points @ rotation(dims, seed)[:, : points.shape[1]].T).astype(np.float32)


def gaussian(rows: int, deviations: NDArray[np.float64], seed: int = 0) -> NDArray[np.float64]:
    """(rows, d) normal rows with such deviations along the axes."""
    return np.random.default_rng(seed).standard_normal((rows, len(deviations))) * deviations


def sphere(rows: int, dims: int, seed: int = 0) -> NDArray[np.float64]:
    """(rows, dims + 1): even on the surface of the unit ball, of dimension `dims`."""
    drawn = gaussian(rows, np.ones(dims + 1), seed)
    return np.asarray(drawn / np.linalg.norm(drawn, axis=1, keepdims=True))


def swiss_roll(rows: int, seed: int = 0) -> NDArray[np.float64]:
    """(rows, 3): a plane rolled up, of dimension 2."""
    rng = np.random.default_rng(seed)
    turn, along = 1.5 * np.pi * (1 + 2 * rng.random(rows)), 21 * rng.random(rows)
    return np.stack([turn * np.cos(turn), along, turn * np.sin(turn)], axis=1)


def cube_corners(dims: int, side: float = 1.0) -> Floats:
    """(2**dims, dims)."""
    return (side * ((np.arange(2**dims)[:, None] >> np.arange(dims)) & 1)).astype(np.float32)
