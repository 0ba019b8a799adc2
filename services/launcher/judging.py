"""What success is asked of, and what rows of scores say of a block and of a whole tree (pure)."""

from collections.abc import Iterable, Mapping, Sequence

from babble.scores import REACHED
from protocol.messages import Score


def measures(row: Score) -> dict[str, float]:
    """What success is asked of.

    Where the body has landmarks, z_min and each landmark; elsewhere separation, z_min and, where there
    are two halves or sides, crossing. services/coordinator/best.py decides by the same.
    """
    if row.landmarks:
        return {"z_min": row.z_min, **row.landmarks}
    crossing = {} if row.crossing is None else {"crossing": row.crossing}
    return {"separation": row.separation, "z_min": row.z_min, **crossing}


def score_columns(rows: Sequence[Score]) -> dict[str, list[float | None]]:
    """Measure -> its value in each row; a measure that no row has is left out."""
    fields = ("separation", "separation_worst", "z_min", "z_goal", "switch_success", "crossing")
    landmarks = list(dict.fromkeys(name for row in rows for name in row.landmarks))
    columns = {name: [getattr(row, name) for row in rows] for name in fields}
    columns |= {name: [row.landmarks.get(name) for row in rows] for name in landmarks}
    columns["external_reward"] = [row.external_reward for row in rows]
    return {name: values for name, values in columns.items() if any(value is not None for value in values)}


def shortfalls(row: Score) -> list[str]:
    """What keeps a row from counting as success, for a person: "z_min 0.83 < 0.9"; empty when it is one."""
    return [
        f"{name} {_below_bar(value)} < {REACHED}" for name, value in measures(row).items() if value < REACHED
    ]


def weakest(rows: Iterable[Score]) -> Score:
    """The row whose least measure is the least. Raises ValueError for none."""
    return min(rows, key=lambda row: min(measures(row).values()))


def tree_words(blocks: Sequence[str], rows: Mapping[str, Score]) -> str:
    """How many blocks of a tree reach their bars, and which do not; `rows` by block, as far as evaluated."""
    missing = {block: shortfalls(rows[block]) for block in blocks if block in rows}
    reached = sum(not words for words in missing.values())
    verb = "reaches its bar" if reached == 1 else "reach their bars"
    below = [f"{block} ({', '.join(words)})" for block, words in missing.items() if words]
    later = [block for block in blocks if block not in rows]
    return "; ".join(
        [
            f"tree: {reached} of {len(blocks)} blocks {verb}",
            *([f"not: {', '.join(below)}"] if below else []),
            *([f"not evaluated yet: {', '.join(later)}"] if later else []),
        ]
    )


def _below_bar(value: float) -> str:
    """The value with as many digits as it takes to see that it is below the bar."""
    texts = (f"{value:.{digits}f}" for digits in (2, 3, 4, 6))
    return next((text for text in texts if float(text) < REACHED), repr(value))
