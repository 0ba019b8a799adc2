"""The figures of MIMo's body: the tables beside this file, read, laid over one another and worked out.

`body.toml` holds what all bodies share and explains how to read it; `mitten.toml` and `five_finger.toml`
add hands and feet.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from babble.worlds.mimo.anatomy import Figures
from babble.worlds.mimo.regions import resolve
from babble.worlds.mimo.tables import FiguresError, Origins, Table, lay_over, read_toml

__all__ = ["HANDS", "Figures", "FiguresError", "Hands", "load", "load_file"]

Hands = Literal["mitten", "five_finger"]
HANDS: tuple[Hands, ...] = ("mitten", "five_finger")


def load(
    hands: Hands = "mitten", chest: bool | None = None, edits: Mapping[str, Any] | None = None
) -> Figures:
    """The figures of the body with these hands.

    chest: whether the chest is a body of its own with two joints; by default as MIMo published it (mitten
        hands with, five-finger hands without).
    edits: what is to be different, in the form of the tables: `{"arm": {"upper_arm": {"length": 0.15}}}`.
    Raises `FiguresError`, naming file and key, for figures that make no body.
    """
    if hands not in HANDS:
        raise FiguresError(f"hands must be one of {', '.join(HANDS)}, got {hands!r}")
    return _load(hands, chest, edits or {}, "the edits")


def load_file(path: Path) -> Figures:
    """The figures of a user's own table: a TOML file that states `hands` and what is to be different."""
    edits = read_toml(path)
    hands = edits.pop("hands", HANDS[0])
    if hands not in HANDS:
        raise FiguresError(f"{path}: hands must be one of {', '.join(HANDS)}, got {hands!r}")
    return _load(hands, None, edits, str(path))


def _load(hands: Hands, chest: bool | None, edits: Mapping[str, Any], source: str) -> Figures:
    values: dict[str, Any] = {}
    origins: Origins = {}
    for name in ("body.toml", f"{hands}.toml"):
        lay_over(values, read_toml(Path(__file__).with_name(name)), name, origins)
    lay_over(values, edits, source, origins)
    if chest is not None:
        values["settings"]["chest"] = chest
    return resolve(Table(values, origins))
