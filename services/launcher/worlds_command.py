"""`babble worlds`: what there is to live in."""

import argparse
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from math import prod

from babble.worlds import WORLDS, World, WorldEntry, WorldError, make

WIDTH = 100
INDENT = " " * 14


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble worlds`: none."""


def run(arguments: argparse.Namespace) -> int:
    """Print the worlds; returns 0."""
    print("\n\n".join("\n".join(world_lines(entry)) for entry in WORLDS.values()))
    return 0


def world_lines(entry: WorldEntry) -> list[str]:
    """A world, its parameters with their defaults, and what it is made of with those."""
    parameters = ", ".join(
        f"{name} (required)" if value is MISSING else f"{name} = {_toml(value)}"
        for name, value in entry.defaults.items()
    )
    try:
        facts = _facts(entry, make(entry.id, {}, columns=1, seed=0))
    except WorldError as error:
        facts = {"diameter": entry.diameter, "as it is": f"cannot be built: {error}"}
    facts = {"parameters": parameters, **facts, "gymnasium": entry.gymnasium_id}
    lines = [f"{entry.id}: {entry.description}"]
    for name, value in facts.items():
        together = value.replace(" = ", "\N{NO-BREAK SPACE}=\N{NO-BREAK SPACE}")
        lines += textwrap.wrap(
            together, WIDTH, initial_indent=f"  {name:<12}", subsequent_indent=INDENT, break_on_hyphens=False
        )
    return [line.replace("\N{NO-BREAK SPACE}", " ") for line in lines]


def _facts(entry: WorldEntry, world: World) -> dict[str, str]:
    senses = ", ".join(f"{name} {_sizes(shape)}" for name, shape in world.senses.items())
    landmarks = ", ".join(landmark.name for landmark in world.landmarks)
    return {
        "diameter": f"{entry.diameter} = {world.diameter:.4g}",
        "senses": f"{senses}; {sum(map(prod, world.senses.values())):,} numbers in all",
        "actions": f"{world.action_size} numbers",
        **({"landmarks": landmarks} if landmarks else {}),
    }


def _sizes(shape: Sequence[int]) -> str:
    return " x ".join(map(str, shape))


def _toml(value: object) -> str:
    match value:
        case bool():
            return str(value).lower()
        case str():
            return f'"{value}"'
        case Mapping():
            inner = ", ".join(f"{name} = {_toml(each)}" for name, each in value.items())
            return f"{{ {inner} }}" if inner else "{}"
        case list() | tuple():
            return f"[{', '.join(map(_toml, value))}]"
        case _:
            return str(value)
