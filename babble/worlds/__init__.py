"""The worlds a Composer can live in: `WORLDS` lists them, `make` builds a batch of one."""

import inspect
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np

from babble.worlds.batch import Start, Step, World
from babble.worlds.shapes import Cuboid, Dumbbell, Ellipsoid, Shape

__all__ = ["WORLDS", "Start", "Step", "World", "WorldEntry", "WorldError", "make"]


class WorldError(ValueError):
    """A world that cannot be built; the text is one sentence for a person."""


@dataclass(frozen=True)
class WorldEntry:
    """A world on the list."""

    id: str
    description: str
    diameter: str
    """the formula of the diameter, in words"""
    shape: type[Shape]

    @property
    def gymnasium_id(self) -> str:
        """Its name for `gymnasium.make`."""
        return f"babble/{self.id}-v0"

    @property
    def defaults(self) -> dict[str, Any]:
        """Its parameters and their default values."""
        return {name: given.default for name, given in inspect.signature(self.shape).parameters.items()}


WORLDS: dict[str, WorldEntry] = {
    entry.id: entry
    for entry in (
        WorldEntry("Cuboid", "a point in a box", "2 * |half_sizes|", Cuboid),
        WorldEntry("Ellipsoid", "a point in an ellipsoid", "2 * the longest of semi_axes", Ellipsoid),
        WorldEntry(
            "Dumbbell", "a point in two balls joined by a bridge", "2 * (lobe_centre + lobe_radius)", Dumbbell
        ),
    )
}

for _entry in WORLDS.values():
    gymnasium.register(id=_entry.gymnasium_id, entry_point=_entry.shape)


def make(id: str, parameters: Mapping[str, Any], columns: int, seed: int | Sequence[int]) -> World:
    """`columns` copies of the named world; `seed` decides their random starts.

    Raises `WorldError` for an unknown world or parameter, naming the known ones, and for a bad value.
    """
    entry = WORLDS.get(id)
    if entry is None:
        raise WorldError(f"there is no world {id!r}; the worlds are {', '.join(WORLDS)}")
    if unknown := sorted(set(parameters) - set(entry.defaults)):
        raise WorldError(
            f"{id} has no parameter {unknown[0]!r}; its parameters are {', '.join(entry.defaults)}"
        )
    try:
        return entry.shape(**parameters).world(columns, np.random.default_rng(seed))
    except ValueError as error:
        raise WorldError(f"{id}: {error}") from None
