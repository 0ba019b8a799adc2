"""Intrinsic dimension from nearest neighbours: TwoNN (thesis, appendix C), and a second estimator."""

import numpy as np
from numpy.typing import NDArray

from babble.coverage_passes import Doubles, Floats, Indices

CHECK_NEIGHBOURS = 20
"""k of the maximum-likelihood estimator, the default of scikit-dimension."""
LEAST_ROWS = CHECK_NEIGHBOURS + 2
"""Different rows below which nothing is estimated."""


def spread_rows(rows: int, wanted: int, seed: int = 0) -> Indices:
    """Indices of `wanted` of so many rows, growing: one drawn at random from each of as many equal parts.

    Rows are in the order of time. Even spacing would beat against the episodes (1,000,000 rows over
    6000 are a third of an episode of 500), and free draws put neighbours in time side by side.
    """
    if wanted >= rows:
        return np.arange(rows)
    edges = np.arange(wanted + 1) * rows // wanted
    return np.random.default_rng(seed).integers(edges[:-1], edges[1:])


def distinct(points: NDArray[np.floating]) -> Doubles:
    """The different ones of (N, s) rows."""
    # 0.0 turns -0.0 into 0.0, which is the same place but other bytes.
    return np.unique(np.asarray(points, np.float64) + 0.0, axis=0)


def neighbour_distances(points: Doubles, count: int) -> Doubles:
    """(N, count) distances of each of (N, s) different rows to its nearest others, growing."""
    moved = points - points.mean(axis=0)
    squares = np.einsum("ij,ij->i", moved, moved)
    found = np.empty((len(moved), count))
    for first in range(0, len(moved), 500):
        part = np.arange(first, min(len(moved), first + 500))
        apart = squares[part, None] + squares - 2 * (moved[part] @ moved.T)
        apart[part - first, part] = np.inf
        nearest = np.argpartition(apart, count - 1, axis=1)[:, :count]
        # The product loses digits where rows are close: their distances are taken once more.
        found[part] = np.linalg.norm(points[nearest] - points[part, None], axis=2)
    return np.sort(found, axis=1)


def neighbour_ratios(points: NDArray[np.floating]) -> Doubles:
    """(n,) growing: mu = r2 / r1 of each different row of (N, s), eq. 23.

    Equal rows count once: their r1 would be 0. Raises ValueError for fewer than three different rows.
    """
    different = distinct(points)
    if len(different) < 3:
        raise ValueError(f"neighbour ratios need three or more different rows, got {len(different)}")
    return ratios_of(neighbour_distances(different, 2))


def ratios_of(distances: Doubles) -> Doubles:
    """Sorted mu of `neighbour_distances`."""
    return np.sort(distances[:, 1] / distances[:, 0])


def twonn(ratios: Doubles, discard: float = 0.1) -> float:
    """The slope through the origin of -log(1 - F_i) over log(mu_i), F_i = (i - 0.5) / n; eq. 26-29.

    `ratios` are sorted; the largest share `discard` of them is left out of the regression, not of n.
    Raises ValueError for a share that leaves nothing, and if all neighbours are equally far (a grid).
    """
    kept = int(len(ratios) * (1 - discard))
    if not 0 <= discard < 1 or kept < 1:
        raise ValueError(f"discarding {discard} of {len(ratios)} neighbour ratios leaves nothing to fit")
    x = np.log(ratios[:kept])
    y = -np.log(1 - (np.arange(1, kept + 1) - 0.5) / len(ratios))
    if not x.any():
        raise ValueError("the two nearest neighbours of each row are equally far (a grid?): no dimension")
    return float((x @ y) / (x @ x))


def likely_dimension(distances: Doubles) -> float:
    """The estimate of Levina and Bickel (2004) by scikit-dimension, given neighbour distances (n, k).

    The rows' estimates are combined by their harmonic mean (MacKay and Ghahramani 2005). The import
    takes seconds, the estimate milliseconds.
    """
    from skdim.id import MLE

    unused = np.zeros_like(distances, dtype=np.int64)
    estimator = MLE().fit(distances, precomputed_knn_arrays=(distances, unused), comb="mle")
    return float(estimator.dimension_)


def dimensions(states: Floats) -> tuple[int, float, float, float]:
    """Of sampled rows: how many are different, TwoNN without the largest 10 %, with all, and the check.

    Raises ValueError for fewer than LEAST_ROWS different rows.
    """
    different = distinct(states)
    if len(different) < LEAST_ROWS:
        raise ValueError(
            f"an intrinsic dimension needs {LEAST_ROWS} different states, but of {len(states)} sampled "
            f"only {len(different)} differ"
        )
    distances = neighbour_distances(different, CHECK_NEIGHBOURS)
    ratios = ratios_of(distances)
    return len(different), twonn(ratios), twonn(ratios, discard=0.0), likely_dimension(distances)
