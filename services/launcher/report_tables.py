"""Tables of a report, in Markdown."""

from collections.abc import Iterable, Sequence


def table_head(names: Sequence[str]) -> list[str]:
    """The two lines above the rows."""
    return [table_row(names), table_row(["---"] * len(names))]


def table_row(cells: Iterable[str]) -> str:
    """One line."""
    return f"| {' | '.join(cells)} |"
