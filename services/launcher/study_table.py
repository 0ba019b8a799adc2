"""The numbers of a study over its seeds, and how near they come to the thesis's (pure)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from babble.coverage import Coverage
from services.launcher.study_measurement import Measurement
from services.launcher.study_plan import Condition, Measured, Plan

Measurements = Mapping[str, Mapping[int, Measurement]]
"""By condition and seed."""

BOOTSTRAPS = 10_000
CONFIDENCE = 0.95
BOOTSTRAP_SEED = 0
NEAR = 0.2
"""Within this share of the thesis's number is near."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One number of a `Coverage`."""

    name: str
    """its field"""
    head: str
    digits: int
    thesis: str | None = None
    """the column of the thesis's table that it may be"""
    words: str = ""
    """what it is, in a line"""


METRICS = (
    Metric(
        name="diameter",
        head="diameter",
        digits=1,
        thesis="diameter",
        words="largest distance found between two states",
    ),
    Metric(
        name="bulk_diameter",
        head="bulk diameter",
        digits=1,
        thesis="diameter",
        words="largest distance found, without the 0.01 % of states furthest from the mean",
    ),
    Metric(
        name="projection_width",
        head="projection width",
        digits=1,
        thesis="diameter",
        words="largest extent along one of 64 random directions",
    ),
    Metric(
        name="box_diagonal",
        head="box diagonal",
        digits=1,
        thesis="diameter",
        words="norm of all components' ranges",
    ),
    Metric(
        name="centre_first",
        head="k-centre first",
        digits=1,
        thesis="diameter",
        words="greedy k-centre: distance of the second centre from the first",
    ),
    Metric(
        name="centre_last",
        head="k-centre last",
        digits=1,
        thesis="diameter",
        words="greedy k-centre: distance at which the last centre was added",
    ),
    Metric(
        name="centre_sum",
        head="k-centre sum",
        digits=0,
        thesis="diameter",
        words="greedy k-centre: sum of all those distances",
    ),
    Metric(
        name="participation_ratio",
        head="PR",
        digits=2,
        thesis="participation_ratio",
        words="participation ratio (sum l)^2 / sum l^2 of the variances",
    ),
    Metric(
        name="bulk_participation_ratio",
        head="bulk PR",
        digits=2,
        thesis="participation_ratio",
        words="participation ratio without the 0.01 % of states furthest from the mean",
    ),
    Metric(
        name="twonn",
        head="TwoNN d10",
        digits=2,
        thesis="intrinsic_dimension",
        words="intrinsic dimension by TwoNN, without the largest 10 % of the ratios",
    ),
    Metric(
        name="twonn_all",
        head="TwoNN all",
        digits=2,
        thesis="intrinsic_dimension",
        words="the same with all ratios",
    ),
    Metric(
        name="intrinsic_check",
        head="MLE",
        digits=2,
        thesis="intrinsic_dimension",
        words="intrinsic dimension by maximum likelihood from 20 neighbours, as a check",
    ),
    Metric(
        name="visited_cells_entropy",
        head="cell entropy",
        digits=2,
        words="entropy of the visited cells, bits",
    ),
)
SHOWN = (
    "diameter",
    "bulk_diameter",
    "box_diagonal",
    "participation_ratio",
    "bulk_participation_ratio",
    "twonn",
    "twonn_all",
)
"""In the short table."""
BESIDE = ("diameter", "participation_ratio", "twonn")
"""Of these, what the thesis's numbers stand beside."""
BY_NAME = {metric.name: metric for metric in METRICS}


@dataclass(frozen=True, kw_only=True)
class Estimate:
    """A number over the seeds of a condition."""

    values: Mapping[int, float]
    """by seed"""
    mean: float
    deviation: float | None
    """of the seeds (n - 1); None for one seed"""
    low: float
    """The mean's bootstrap interval over the seeds, its lower end; of few seeds it is too narrow."""
    high: float

    @property
    def least(self) -> float:
        """Of all seeds."""
        return min(self.values.values())

    @property
    def most(self) -> float:
        """Of all seeds."""
        return max(self.values.values())


Estimates = Mapping[str, Mapping[str, Estimate]]
"""By condition and metric."""


def estimate(values: Mapping[int, float]) -> Estimate:
    """Mean, deviation and interval of the seeds' values. Raises ValueError if there are none."""
    if not values:
        raise ValueError("no seed, no estimate")
    array = np.array(list(values.values()), np.float64)
    drawn = np.random.default_rng(BOOTSTRAP_SEED).integers(len(array), size=(BOOTSTRAPS, len(array)))
    tail = 50 * (1 - CONFIDENCE)
    means = array[drawn].mean(axis=1)
    return Estimate(
        values=dict(values),
        mean=float(array.mean()),
        deviation=float(array.std(ddof=1)) if len(array) > 1 else None,
        low=float(np.percentile(means, tail)),
        high=float(np.percentile(means, 100 - tail)),
    )


def estimates_of(measurements: Measurements) -> dict[str, dict[str, Estimate]]:
    """All metrics of all conditions that have a run."""
    return {
        condition: {
            metric.name: estimate({seed: value_of(each.coverage, metric) for seed, each in by_seed.items()})
            for metric in METRICS
        }
        for condition, by_seed in measurements.items()
        if by_seed
    }


def value_of(coverage: Coverage, metric: Metric) -> float:
    """The metric's number."""
    return float(getattr(coverage, metric.name))


def thesis_of(condition: Condition, metric: Metric) -> Measured | None:
    """The thesis's mean and deviation of what the metric may be; None where it has none."""
    return None if metric.thesis is None else getattr(condition.thesis, metric.thesis)


@dataclass(frozen=True, kw_only=True)
class Nearness:
    """How near one definition comes to a column of the thesis's table."""

    metric: Metric
    errors: Mapping[str, float]
    """by condition: (ours - thesis's) / thesis's"""
    mean_error: float
    """of their sizes"""
    order: float | None
    """Spearman's correlation with the thesis over the conditions; None for fewer than three"""
    factor: float
    """by which all of ours would have to be multiplied to come nearest"""
    left_error: float
    """the mean size of the errors after that"""


def nearness_of(plan: Plan, estimates: Estimates, column: str) -> list[Nearness]:
    """Each definition of a column, the nearest first."""
    found = []
    for metric in METRICS:
        if metric.thesis != column:
            continue
        pairs = {
            condition.id: (estimates[condition.id][metric.name].mean, printed[0])
            for condition in plan.condition
            if condition.id in estimates and (printed := thesis_of(condition, metric)) is not None
        }
        if pairs:
            errors = {each: ours / theirs - 1 for each, (ours, theirs) in pairs.items()}
            mean = sum(map(abs, errors.values())) / len(errors)
            order = spearman(*zip(*pairs.values(), strict=True)) if len(pairs) > 2 else None
            factor = float(np.exp(-np.mean(np.log([1 + error for error in errors.values()]))))
            left = sum(abs(factor * (1 + error) - 1) for error in errors.values()) / len(errors)
            found.append(
                Nearness(
                    metric=metric,
                    errors=errors,
                    mean_error=mean,
                    order=order,
                    factor=factor,
                    left_error=left,
                )
            )
    return sorted(found, key=lambda each: each.mean_error)


def spearman(one: Sequence[float], other: Sequence[float]) -> float:
    """The correlation of the ranks; numbers that are equal are ranked in their order."""
    ranks = [np.argsort(np.argsort(values, kind="stable"), kind="stable") for values in (one, other)]
    return float(np.asarray(np.corrcoef(ranks))[0, 1])


def is_near(ours: float, theirs: float) -> bool:
    """Whether a number lies within 20 % of the thesis's."""
    return abs(ours / theirs - 1) <= NEAR


def plus_minus(mean: float, deviation: float | None, digits: int) -> str:
    """Such as "15.87 ± 0.81"."""
    if deviation is None:
        return f"{mean:,.{digits}f}"
    return f"{mean:,.{digits}f} ± {deviation:,.{digits}f}"


def short_heads() -> list[str]:
    """Of the columns of the short table."""
    return [head for name in SHOWN for head in ([BY_NAME[name].head] + ["thesis"] * (name in BESIDE))]


def short_cells(condition: Condition, found: Mapping[str, Estimate] | None) -> list[str]:
    """A condition's row of the short table; found is None where it has no run."""
    cells = []
    for metric in (BY_NAME[name] for name in SHOWN):
        one = None if found is None else found[metric.name]
        cells.append("-" if one is None else plus_minus(one.mean, one.deviation, metric.digits))
        if metric.name in BESIDE:
            printed = thesis_of(condition, metric)
            cells.append("-" if printed is None else plus_minus(*printed, metric.digits))
    return cells


def table_lines(plan: Plan, estimates: Estimates) -> list[str]:
    """The study's table beside the thesis's, in plain text: a line per condition."""
    rows = [["", *short_heads()]]
    rows += [
        [f"{condition.id} {condition.title}", *short_cells(condition, estimates.get(condition.id))]
        for condition in plan.condition
    ]
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            cell.ljust(width) if place == 0 else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]
