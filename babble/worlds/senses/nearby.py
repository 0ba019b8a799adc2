"""Which points of a skin are near a place on it, found without looking at all of them."""

import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from babble.worlds.senses.skin import Patch

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
REACH_CELLS = 2
"""A place reaches as far as so many cells; more and smaller cells hold fewer needless points."""


class Nearby:
    """Space around each patch is cut into cubic cells that list the points within reach of any of them.

    All coordinates are counted in cells, from a corner of the patch's space, so that the reach is the
    same on all patches. Numbers of cells are floats, exact to 2^53.
    """

    def __init__(self, patches: Sequence[Patch], reach_m: Array) -> None:
        """`reach_m` (patches,): how far a place on each patch reaches."""
        self._first = np.cumsum([0, *(len(patch.points) for patch in patches)])
        self._origin = np.stack([patch.points.min(axis=0) for patch in patches]) - reach_m[:, None]
        self._per_m = REACH_CELLS / reach_m[:, None]
        ends = np.stack([patch.points.max(axis=0) for patch in patches]) + reach_m[:, None]
        self._last = np.floor((ends - self._origin) * self._per_m)
        x, y, z = (self._last + 1).T
        self._strides = np.stack([y * z, z, np.ones_like(z)], axis=1)
        self._base = np.cumsum([0, *(x * y * z)])[:-1]
        patch = np.arange(len(patches)).repeat(np.diff(self._first))
        metres = np.concatenate([patch.points for patch in patches])
        self._points = (metres - self._origin[patch]) * self._per_m[patch]
        cells, points = self._pairs(patch)
        self._listed = points[np.argsort(cells, kind="stable")]
        self._cells, self._counts = np.unique(cells, return_counts=True)
        self._starts = np.cumsum(self._counts) - self._counts

    def shares(self, patch: Indices, place: Array) -> tuple[Indices, Indices, Array]:
        """How each of P places (P, 3), in the frame of its patch's body (P,), is shared among points.

        Three arrays of one length, place by place: the place, the point, and its share. The weight of a
        point falls in proportion to distance, to 0 at the reach; a place's shares add up to 1. Of
        points out of reach some are listed, with 0. Where none is in reach the nearest has all.
        """
        at = (place - self._origin.take(patch, axis=0)) * self._per_m.take(patch, axis=0)
        rows, points = self._candidates(patch, at)
        away = self._points.take(points, axis=0) - at.take(rows, axis=0)
        share = np.maximum(REACH_CELLS - np.sqrt(np.einsum("ij,ij->i", away, away)), 0)
        total = np.bincount(rows, share, minlength=len(at))
        if not total.all():
            strays = np.flatnonzero(total == 0)
            nearest = [self._nearest(patch[row], at[row]) for row in strays]
            rows, points = np.append(rows, strays), np.append(points, nearest)
            share, total[strays] = np.append(share, np.ones(len(strays))), 1.0
        return rows, points, share / total.take(rows)

    def _candidates(self, patch: Indices, at: Array) -> tuple[Indices, Indices]:
        """Pairs of a place and a point: all that are within reach, and some a little farther."""
        cells = self._numbers(patch, at)
        slot = self._cells.searchsorted(cells)
        counts = self._counts.take(slot, mode="clip") * (self._cells.take(slot, mode="clip") == cells)
        rows = np.arange(len(at)).repeat(counts)
        before = self._starts.take(slot, mode="clip") - counts.cumsum() + counts
        return rows, self._listed.take(np.arange(len(rows)) + before.take(rows))

    def _numbers(self, patch: Indices, at: Array) -> Array:
        """The number of the cell that holds each place, or of one at the border for a place outside."""
        cell = np.minimum(np.maximum(np.floor(at), 0), self._last.take(patch, axis=0))
        return self._base.take(patch) + np.einsum("ij,ij->i", cell, self._strides.take(patch, axis=0))

    def _nearest(self, patch: int, at: Array) -> int:
        first, end = self._first[patch : patch + 2]
        return int(first + np.argmin(np.linalg.norm(self._points[first:end] - at, axis=1)))

    def _pairs(self, patch: Indices) -> tuple[Array, Indices]:
        """All pairs of a cell's number and a point within reach of that cell."""
        home = np.floor(self._points)
        cells, points = [], []
        steps = range(-REACH_CELLS, REACH_CELLS + 1)
        for step in itertools.product(steps, steps, steps):
            centre = home + step + 0.5
            beyond = np.maximum(np.abs(self._points - centre) - 0.5, 0)
            near = np.flatnonzero(np.einsum("ij,ij->i", beyond, beyond) < REACH_CELLS**2)
            cells.append(self._numbers(patch[near], centre[near]))
            points.append(near)
        return np.concatenate(cells), np.concatenate(points)
