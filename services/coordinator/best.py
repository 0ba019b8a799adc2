"""Which iteration of a block is kept (pure): scores may dip from one iteration to the next and recover."""

from collections.abc import Iterable

from services.coordinator.words import ScoreRow

BAR = 0.9
"""Success as thesis ch. 4 is measured here; what it is asked of, see `measures`."""


def measures(row: ScoreRow) -> tuple[float, ...]:
    """What success is asked of.

    Where the body has landmarks (an open and a closed hand), z_min and each landmark. Elsewhere separation,
    z_min and, where there is a bridge, crossing: how far apart two named postures are is the body's affair.
    services/launcher/evaluate.py judges by the same.
    """
    if row.landmarks:
        return row.z_min, *row.landmarks.values()
    crossing = () if row.crossing is None else (row.crossing,)
    return row.separation, row.z_min, *crossing


def weakest(row: ScoreRow) -> float:
    """The least of what success is asked of."""
    return min(measures(row))


def meets_bar(row: ScoreRow) -> bool:
    """Whether all that success is asked of is high enough."""
    return weakest(row) >= BAR


def best(rows: Iterable[ScoreRow]) -> ScoreRow | None:
    """The best of one block's rows, None of none; in whatever order they come.

    The mean policy is preferred to the sampled one, a row over the bar to one below it, then the one
    with the larger weakest score, then with the larger sum of them, then the later iteration.
    """
    return max(rows, key=_merit, default=None)


def reason(row: ScoreRow) -> str:
    """Why this row is the best, for a person."""
    if meets_bar(row):
        return f"iteration {row.iteration} meets every bar of {BAR}; its weakest score is {weakest(row):.3f}"
    return (
        f"no iteration meets every bar of {BAR}; nearest is iteration {row.iteration} with {weakest(row):.3f}"
    )


def _merit(row: ScoreRow) -> tuple[bool, bool, float, float, int]:
    return row.policy == "mean", meets_bar(row), weakest(row), sum(measures(row)), row.iteration
