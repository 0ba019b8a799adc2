"""The largest distance between two rows: sought by sweeps, bounded by a ball, and proven where it can be."""

from dataclasses import dataclass

import numpy as np

from babble.coverage_passes import (
    Floats,
    Indices,
    Moments,
    chunks,
    distance,
    moments,
    squared_distances,
    unit_directions,
)

STARTS = 8
"""Seeded random rows from which sweeps start."""
MOST_SWEEPS = 20
"""Sweeps end here even if the last one grew; three to five are usual."""
DIRECTIONS = 64
"""Of the projections whose ends are on the convex hull."""
MOST_PAIRED = 10_000
"""Rows that are compared each with each."""
OUTLYING = 10_000
"""One row in so many, the furthest from the mean, does not belong to the bulk."""


@dataclass(frozen=True)
class Diameter:
    """projection_width <= distance <= the true diameter <= min(2 radius, box diagonal)."""

    rows: tuple[int, int]
    """The furthest pair that was found."""
    distance: float
    """Between them."""
    exact: bool
    """No other pair is further, up to the precision of float32."""
    projection_width: float
    """The largest extent along one of the directions."""
    radius: float
    """From the mean to the row that is furthest from it."""


def furthest_pair(states: Floats, seed: int = 0) -> tuple[int, int, float]:
    """Two rows of (N, s) that are as far apart as any that were found, and their distance.

    Raises ValueError as `moments` does.
    """
    found = diameter(states, moments(states), seed)
    return *found.rows, found.distance


def diameter(states: Floats, known: Moments, seed: int = 0, found: tuple[int, int] | None = None) -> Diameter:
    """Double sweeps: from each start to the row furthest from it, from there again, until none grows.

    Starts are STARTS random rows, the row furthest from the mean, and the furthest two of the rows that
    are extreme along a random direction, or of the pair that was found otherwise. Then, if few enough rows
    are so far out that they could be in a longer pair, all of these are compared.
    """
    middle = known.mean.astype(np.float32)
    norms = np.sqrt(squared_distances(states, middle))
    radius = float(norms.max())
    hull, width = _extremes(states, middle, seed)
    best = _furthest_of(states, hull, middle)
    if found is not None:
        best = max(best, found, key=lambda pair: distance(states, *pair))
    rng = np.random.default_rng(seed)
    starts = np.concatenate([rng.integers(0, len(states), STARTS), [norms.argmax(), *best]])
    best = max(best, _swept(states, starts, middle), key=lambda pair: distance(states, *pair))
    reach = distance(states, *best)
    # A row of a pair longer than `reach` is further from the mean than `reach` minus the radius.
    outer = np.flatnonzero(norms >= reach - radius * (1 + 1e-5))
    exact = len(outer) <= MOST_PAIRED
    if exact:
        best = max(best, _furthest_of(states, outer, middle), key=lambda pair: distance(states, *pair))
    return Diameter(best, distance(states, *best), exact, width, radius)


@dataclass(frozen=True)
class Bulk:
    """All rows but the one in OUTLYING, at least one, that lie furthest from the mean."""

    outside: Indices
    """The rows that are not of it, rising."""
    furthest: tuple[int, int]
    """The furthest pair that sweeps find in it."""


def bulk_of(states: Floats, known: Moments, seed: int = 0) -> Bulk:
    """The bulk of (N, s) states.

    A single contact that flings a limb for some steps of a million can make the diameter fifty times as
    large, and the participation ratio a fifth smaller.
    """
    middle = known.mean.astype(np.float32)
    squares = squared_distances(states, middle)
    count = -(-len(states) // OUTLYING)
    outside = np.sort(np.argpartition(squares, len(states) - count)[len(states) - count :])
    squares[outside] = -np.inf
    inside = np.flatnonzero(squares >= 0)
    starts = np.append(np.random.default_rng(seed).choice(inside, STARTS), squares.argmax())
    return Bulk(outside, _swept(states, starts, middle, float(squares.max())))


def _extremes(states: Floats, middle: Floats, seed: int) -> tuple[Indices, float]:
    """The rows at both ends of each direction, and the largest extent."""
    directions = unit_directions(DIRECTIONS, states.shape[1], seed)
    ends = np.zeros((2, DIRECTIONS), np.int64)
    values = np.full((2, DIRECTIONS), -np.inf, np.float32)
    for rows in chunks(len(states)):
        along = directions @ (states[rows] - middle).T
        for end, signed in enumerate((along, -along)):
            at = signed.argmax(axis=1)
            peak = signed[np.arange(DIRECTIONS), at]
            better = peak > values[end]
            ends[end, better], values[end, better] = rows.start + at[better], peak[better]
    return np.unique(ends), float(values.sum(axis=0).max())


def _furthest_of(states: Floats, rows: Indices, middle: Floats) -> tuple[int, int]:
    """The furthest pair of these rows, all compared with all."""
    points = states[rows] - middle
    squares = np.einsum("ij,ij->i", points, points)
    best, pair = -np.inf, (0, 0)
    for first in range(0, len(rows), 512):
        part = slice(first, first + 512)
        apart = squares[part, None] + squares - 2 * (points[part] @ points.T)
        if apart.max() > best:
            one, other = np.unravel_index(int(apart.argmax()), apart.shape)
            best, pair = float(apart.max()), (int(rows[first + one]), int(rows[other]))
    return pair


def _swept(states: Floats, starts: Indices, middle: Floats, limit: float = np.inf) -> tuple[int, int]:
    """The furthest pair that sweeps from the starts end at, of rows whose square is not over the limit."""
    reach, best = 0.0, (0, 0)
    for _ in range(MOST_SWEEPS):
        ends = _furthest_from(states, starts, middle, limit)
        pairs = [(int(start), int(end)) for start, end in zip(starts, ends, strict=True)]
        lengths = np.array([distance(states, *pair) for pair in pairs])
        if lengths.max() <= reach:
            break
        reach, best = float(lengths.max()), pairs[int(lengths.argmax())]
        starts = np.unique(ends)
    return best


def _furthest_from(states: Floats, starts: Indices, middle: Floats, limit: float | np.floating) -> Indices:
    """For each start the row furthest from it, of those whose square is not over the limit."""
    points = states[starts] - middle
    found, best = np.zeros(len(starts), np.int64), np.full(len(starts), -np.inf, np.float32)
    for rows in chunks(len(states)):
        moved = states[rows] - middle
        squares = np.einsum("ij,ij->i", moved, moved)
        # The start's own square is the same for all rows, so it does not matter which is the largest.
        apart = np.where(squares <= limit, squares, -np.inf) - 2 * (points @ moved.T)
        at = apart.argmax(axis=1)
        peak = apart[np.arange(len(starts)), at]
        better = peak > best
        found[better], best[better] = rows.start + at[better], peak[better]
    return found
