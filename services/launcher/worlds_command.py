"""`babble worlds`: what there is to live in, and what its parts are called."""

import argparse
import textwrap
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from math import prod
from pathlib import Path

from babble.worlds import WORLDS, World, WorldEntry, WorldError, make
from services.launcher.config import scenario_path
from services.runtime.settings import SettingsError, load

WIDTH = 100
INDENT = " " * 14


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble worlds`."""
    parser.add_argument(
        "world",
        nargs="?",
        metavar="WORLD",
        help="show the names that blocks choose from, of a world or of a scenario's world",
    )


def run(arguments: argparse.Namespace) -> int:
    """Print the worlds, or the names of one; returns 0. Raises `SettingsError` for one there is not."""
    if arguments.world is None:
        print("\n\n".join("\n".join(world_lines(entry)) for entry in WORLDS.values()))
    else:
        print("\n".join(name_lines(_built(arguments.world))))
    return 0


def name_lines(world: World) -> list[str]:
    """The actuators and, by sense, the components of the observation, for the patterns of blocks."""
    lines = [f"{world.id} has {world.action_size} actuators, which blocks drive:"]
    lines += _listed(world.action_names)
    lines += ["", f"and {world.observation_size:,} components of the observation, which blocks observe:"]
    by_sense: dict[str, list[str]] = {}
    for name in world.observation_names:
        sense, _, component = name.partition("/")
        by_sense.setdefault(sense, []).append(component)
    for sense, components in by_sense.items():
        lines += [f"  {sense}/", *_listed(components)]
    return lines


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


def _built(name: str) -> World:
    """One copy of a world as it is by default, or as a scenario has it."""
    try:
        if name in WORLDS:
            return make(name, {}, columns=1, seed=0)
        chosen = load(_scenario(name)).world
        return make(chosen.id, chosen.parameters, columns=1, seed=0)
    except WorldError as error:
        raise SettingsError(str(error)) from None


def _scenario(name: str) -> Path:
    try:
        return scenario_path(name)
    except SettingsError as error:
        raise SettingsError(
            f"there is no world {name!r}; the worlds are {', '.join(WORLDS)}; and {error}"
        ) from None


def _listed(names: Sequence[str]) -> list[str]:
    """Names, each once, with how many numbers it stands for where these are more than one."""
    known = [name if times == 1 else f"{name} ({times:,})" for name, times in Counter(names).items()]
    kept = ", ".join(name.replace(" ", "\N{NO-BREAK SPACE}") for name in known)
    lines = textwrap.wrap(
        kept, WIDTH, initial_indent="    ", subsequent_indent="    ", break_on_hyphens=False
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
