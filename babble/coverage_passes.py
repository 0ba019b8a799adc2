"""Passes over many rows in chunks: what the metrics of coverage know of a cloud without a second copy of it.

Every difference is taken before it is squared, so that a cloud far from the origin loses no digits.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Doubles = NDArray[np.float64]
Indices = NDArray[np.int64]

CHUNK_ROWS = 16_384
"""Rows of one step of a pass: 6 MB of 98 numbers."""


@dataclass(frozen=True)
class Moments:
    """What one pass finds."""

    mean: Doubles
    """(s,)"""
    covariance: Doubles
    """(s, s), divided by N."""
    least: Doubles
    """(s,): the lower corner of the bounding box."""
    most: Doubles
    """(s,): the upper corner."""

    @property
    def box_diagonal(self) -> float:
        """The length of the box's diagonal: no two rows are further apart."""
        return float(np.linalg.norm(self.most - self.least))


def chunks(rows: int) -> Iterator[slice]:
    """The rows 0 to `rows` in order."""
    for first in range(0, rows, CHUNK_ROWS):
        yield slice(first, min(rows, first + CHUNK_ROWS))


def moments(states: Floats) -> Moments:
    """Mean, covariance and bounding box of (N, s) rows.

    Raises ValueError unless there are two or more rows, all finite, that are not all equal.
    """
    if states.ndim != 2 or len(states) < 2 or states.shape[1] < 1:
        raise ValueError(f"coverage needs two or more states as rows (N, s), got shape {states.shape}")
    dims = states.shape[1]
    near = states[0].astype(np.float64)
    total, products = np.zeros(dims), np.zeros((dims, dims))
    least, most = np.full(dims, np.inf), np.full(dims, -np.inf)
    for rows in chunks(len(states)):
        least, most = np.minimum(least, states[rows].min(axis=0)), np.maximum(most, states[rows].max(axis=0))
        if not (np.isfinite(least) & np.isfinite(most)).all():
            raise ValueError(_not_finite(states, rows))
        moved = states[rows] - near
        total += moved.sum(axis=0)
        products += moved.T @ moved
    if (least == most).all():
        raise ValueError(f"all {len(states)} states are equal, so they cover nothing")
    shift = total / len(states)
    return Moments(near + shift, products / len(states) - np.outer(shift, shift), least, most)


def covariance_without(known: Moments, states: Floats, rows: Indices) -> Doubles:
    """(s, s): the covariance of all states but these few rows, from that of all of them."""
    left = len(states) - len(rows)
    moved = states[rows] - known.mean
    shift = -moved.sum(axis=0) / left
    return np.asarray((len(states) * known.covariance - moved.T @ moved) / left - np.outer(shift, shift))


def _not_finite(states: Floats, rows: slice) -> str:
    row, column = np.argwhere(~np.isfinite(states[rows]))[0]
    value = states[rows][row, column]
    return f"row {rows.start + row} of the states has {value} in column {column}; leave such rows out"


def squared_distances(states: Floats, point: Floats, rows: Indices | None = None) -> Floats:
    """(N,) squared distances of all rows, or of the given ones, to a point (s,)."""
    count = len(states) if rows is None else len(rows)
    found = np.empty(count, np.float32)
    for part in chunks(count):
        moved = (states[part] if rows is None else states[rows[part]]) - point
        found[part] = np.einsum("ij,ij->i", moved, moved)
    return found


def distance(states: Floats, one: int, other: int) -> float:
    """Between two rows, in double precision."""
    return float(np.linalg.norm(states[one].astype(np.float64) - states[other].astype(np.float64)))


def unit_directions(count: int, dims: int, seed: int) -> Floats:
    """(count, dims): directions drawn evenly from the sphere."""
    drawn = np.random.default_rng(seed).standard_normal((count, dims))
    return (drawn / np.linalg.norm(drawn, axis=1, keepdims=True)).astype(np.float32)
