"""The worlds a Composer can live in: `WORLDS` lists them, `make` builds a batch of one."""

import importlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import gymnasium
import numpy as np

from babble.worlds.batch import Start, Step, World

__all__ = ["WORLDS", "Start", "Step", "World", "WorldEntry", "WorldError", "make"]


class WorldError(ValueError):
    """A world that cannot be built; the text is one sentence for a person."""


class Maker(Protocol):
    """A world's Gymnasium environment, which also makes batches."""

    def __init__(self, **parameters: Any) -> None: ...

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """The parameters and their default values."""
        ...

    def world(self, columns: int, rng: np.random.Generator) -> World:
        """`columns` copies of the environment, stepped together."""
        ...


@dataclass(frozen=True)
class WorldEntry:
    """A world on the list."""

    id: str
    description: str
    diameter: str
    """the formula of the diameter, in words"""
    module: str
    """where the class of this id is; loaded when it is needed, since MuJoCo takes its time"""

    @property
    def gymnasium_id(self) -> str:
        """Its name for `gymnasium.make`."""
        return f"babble/{self.id}-v0"

    @property
    def maker(self) -> type[Maker]:
        """The environment's class. Raises `WorldError` where its packages do not load."""
        try:
            module = importlib.import_module(self.module)
        except (ImportError, AttributeError, OSError, RuntimeError) as error:
            raise WorldError(f"{self.id} cannot be loaded: {error}{gl_advice()}") from error
        found: type[Maker] = getattr(module, self.id)
        return found

    @property
    def defaults(self) -> dict[str, Any]:
        """Its parameters and their default values."""
        return self.maker.defaults()


def gl_advice() -> str:
    """What to say where MuJoCo does not load: it fails as a whole if MUJOCO_GL asks for what is not there."""
    chosen = os.environ.get("MUJOCO_GL", "")
    return f"; MUJOCO_GL={chosen} may ask for a renderer that does not work here: unset it" if chosen else ""


_JOINTS = "2 * sqrt(joints), each from -1 to 1"
_SHAPES = "babble.worlds.shapes"
_MIMO = "babble.worlds.mimo"
WORLDS: dict[str, WorldEntry] = {
    entry.id: entry
    for entry in (
        WorldEntry("Cuboid", "a point in a box", "2 * |half_sizes|", _SHAPES),
        WorldEntry("Ellipsoid", "a point in an ellipsoid", "2 * the longest of semi_axes", _SHAPES),
        WorldEntry(
            "Dumbbell",
            "a point in two balls joined by a bridge",
            "2 * (lobe_centre + lobe_radius)",
            _SHAPES,
        ),
        WorldEntry("MimoFinger", "one finger of MIMo's hand, the rest held", _JOINTS, f"{_MIMO}.finger"),
        WorldEntry("MimoHand", "MIMo's five fingers on a held palm", _JOINTS, f"{_MIMO}.hand"),
        WorldEntry("MimoRollover", "MIMo lying on the floor, free to roll", _JOINTS, f"{_MIMO}.rollover"),
        WorldEntry(
            "MimoStandUp", "MIMo with its hands on a bar, rewarded for height", _JOINTS, f"{_MIMO}.stand_up"
        ),
        WorldEntry("MimoReach", "MIMo's right arm and an object to touch", _JOINTS, f"{_MIMO}.reach"),
        WorldEntry("MimoKick", "MIMo supine, a leg tied to a mobile", _JOINTS, f"{_MIMO}.kick"),
        WorldEntry("Mjcf", "any MuJoCo model file", _JOINTS, "babble.worlds.mjcf"),
    )
}

for _entry in WORLDS.values():
    gymnasium.register(id=_entry.gymnasium_id, entry_point=f"{_entry.module}:{_entry.id}")


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
        return entry.maker(**parameters).world(columns, np.random.default_rng(seed))
    except (ValueError, TypeError, OverflowError) as error:
        raise WorldError(f"{id}: {error}") from None
