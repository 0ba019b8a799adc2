"""What a benchmark found, as a table for a terminal or for a Markdown page."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass

WIDTH = 100


@dataclass(frozen=True)
class Table:
    """Rows under column names, with sentences below that say how to read them."""

    title: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def plain(self) -> str:
        """For a terminal: the first column to the left, the others to the right."""
        lines = [self.columns, *self.rows]
        widths = [max(len(line[i]) for line in lines) for i in range(len(self.columns))]
        head, *body = [_aligned(line, widths) for line in lines]
        notes = [
            textwrap.fill(note, WIDTH, initial_indent="  ", subsequent_indent="    ") for note in self.notes
        ]
        return "\n".join([self.title, "", head, "-" * len(head), *body, *notes, ""])

    def markdown(self) -> str:
        """For a page: a pipe table under a heading of level 3."""
        rule = ["---", *["---:"] * (len(self.columns) - 1)]
        head = [f"### {self.title}", "", _pipes(self.columns), _pipes(rule)]
        notes = ["", *(f"- {note}" for note in self.notes)] if self.notes else []
        return "\n".join([*head, *(_pipes(row) for row in self.rows), *notes, ""])


def _aligned(cells: Sequence[str], widths: Sequence[int]) -> str:
    others = [cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True)]
    return "  ".join([cells[0].ljust(widths[0]), *others])


def _pipes(cells: Sequence[str]) -> str:
    return f"| {' | '.join(cells)} |"


def secs(value: float) -> str:
    """Seconds with two digits."""
    return f"{value:.2f}"


def ratio(value: float) -> str:
    """A ratio with two digits."""
    return f"{value:.2f}x"


def count(value: float) -> str:
    """A whole number with thousands apart."""
    return f"{value:,.0f}"
