"""How much of a state space a run covered: the metrics of the thesis's Table 1 (4.5) and their doubts.

Everything is measured on raw, unscaled states, joint positions in rad and velocities in rad/s mixed, as
the thesis does. docs/coverage.md defines each metric and says what it cannot tell.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np

from babble.coverage_cells import visited_cells_entropy
from babble.coverage_centres import insertion_distances
from babble.coverage_diameter import bulk_of, diameter, furthest_pair
from babble.coverage_neighbours import dimensions, neighbour_ratios, spread_rows, twonn
from babble.coverage_passes import Doubles, Floats, covariance_without, distance, moments

__all__ = [
    "Coverage",
    "coverage",
    "coverage_curve",
    "furthest_pair",
    "insertion_distances",
    "neighbour_ratios",
    "participation_ratio",
    "spread_rows",
    "twonn",
    "visited_cells_entropy",
]


@dataclass(frozen=True)
class Coverage:
    """The metrics of one cloud of states; distances are in the states' own mixed unit."""

    rows: int
    dims: int
    seed: int
    diameter: float
    """The largest distance found between two states; a lower bound, unless `diameter_exact`."""
    diameter_exact: bool
    furthest_rows: tuple[int, int]
    """The two states that are so far apart."""
    bulk_diameter: float
    """The same without the one state in 10,000 that lies furthest from the mean; a lower bound."""
    projection_width: float
    """The largest extent along one of 64 random directions; never above the diameter."""
    radius: float
    """From the mean to the furthest state: half the diameter at least."""
    box_diagonal: float
    """The Euclidean norm of all components' ranges; never below the diameter."""
    centres: int
    centre_first: float
    """Greedy k-centre: the distance at which the second centre was inserted, the first is near the mean."""
    centre_last: float
    """The same of the last centre."""
    centre_sum: float
    """The sum of all insertion distances."""
    participation_ratio: float
    bulk_participation_ratio: float
    """The same without the one state in 10,000."""
    variances: tuple[float, ...]
    """Along the principal axes, falling."""
    neighbour_rows: int
    """States that the intrinsic dimensions were estimated from, duplicates included."""
    duplicates: int
    """Of these, the ones that equal an earlier one and were left out."""
    twonn: float
    """Without the largest 10 % of the neighbour ratios."""
    twonn_all: float
    intrinsic_check: float
    """The maximum-likelihood estimate from 20 neighbours on the same states (Levina and Bickel 2004)."""
    visited_cells_entropy: float
    """In bits."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Coverage":
        """What `as_dict` gave, also after JSON. Raises ValueError for missing or unknown names."""
        names = {field.name for field in fields(cls)}
        if wrong := sorted(names ^ values.keys()):
            known = "lacks" if wrong[0] in names else "has an unknown"
            raise ValueError(f"this coverage {known} {wrong[0]!r}; measure it again with `babble coverage`")
        one, other = values["furthest_rows"]
        listed = {"variances": tuple(values["variances"]), "furthest_rows": (one, other)}
        return cls(**{**values, **listed})


def coverage(states: Floats, *, seed: int = 0, neighbour_rows: int = 6000, centres: int = 100) -> Coverage:
    """All metrics of (N, s) states in the order of time; what is drawn at random is drawn by the seed.

    The states may be a memory map; nothing is copied but chunks and samples.
    Raises ValueError for states that are not finite, all equal, or fewer than 22 different in the sample,
    for neighbours at one and the same distance (a grid), and for fewer than 2 centres.
    """
    known = moments(states)
    bulk = bulk_of(states, known, seed)
    wide = diameter(states, known, seed, bulk.furthest)
    inserted = insertion_distances(states, known.mean.astype(np.float32), centres)
    variances = _variances(known.covariance)
    inner = _variances(covariance_without(known, states, bulk.outside))
    sample = states[spread_rows(len(states), neighbour_rows, seed)]
    different, without_tail, with_all, check = dimensions(sample)
    return Coverage(
        rows=states.shape[0],
        dims=states.shape[1],
        seed=seed,
        diameter=wide.distance,
        diameter_exact=wide.exact,
        furthest_rows=wide.rows,
        bulk_diameter=distance(states, *bulk.furthest),
        projection_width=wide.projection_width,
        radius=wide.radius,
        box_diagonal=known.box_diagonal,
        centres=centres,
        centre_first=float(inserted[0]),
        centre_last=float(inserted[-1]),
        centre_sum=float(inserted.sum()),
        participation_ratio=participation_ratio(variances),
        bulk_participation_ratio=participation_ratio(inner),
        variances=tuple(float(variance) for variance in variances),
        neighbour_rows=len(sample),
        duplicates=len(sample) - different,
        twonn=without_tail,
        twonn_all=with_all,
        intrinsic_check=check,
        visited_cells_entropy=visited_cells_entropy(states),
    )


def coverage_curve(
    states: Floats, rows: Sequence[int], *, seed: int = 0, neighbour_rows: int = 6000, centres: int = 100
) -> list[Coverage]:
    """The coverage of the first n states for each n of `rows`: how it grows with time.

    Raises ValueError for more rows than there are, and as `coverage` does.
    """
    if wrong := [n for n in rows if not 2 <= n <= len(states)]:
        raise ValueError(f"there are {len(states)} states, so no coverage of the first {wrong[0]}")
    return [coverage(states[:n], seed=seed, neighbour_rows=neighbour_rows, centres=centres) for n in rows]


def participation_ratio(variances: Sequence[float] | Doubles) -> float:
    """(sum l)^2 / sum l^2 of the variances l along the principal axes: 1 for a line, s for a ball."""
    values = np.asarray(variances, np.float64)
    return float(values.sum() ** 2 / (values**2).sum())


def _variances(covariance: Doubles) -> Doubles:
    """Along the principal axes, falling."""
    return np.clip(np.linalg.eigvalsh(covariance)[::-1], 0, None)
