"""What the command line says of a run, checked before any process starts: the scenario's settings."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path

from services.runtime.settings import RunSettings, SettingsError, load, parse

ROOT = Path(__file__).resolve().parents[2]
"""The repository, where this is an editable install of one."""
SUFFIX = ".toml"


def scenario_path(scenario: str) -> Path:
    """The TOML file of a scenario, given by its path or by the bare name of a file in scenarios/.

    Raises `SettingsError` that names the known ones.
    """
    given = Path(os.path.expanduser(scenario))
    if os.path.isfile(given):
        return given
    known = known_scenarios()
    name = scenario.removesuffix(SUFFIX)
    if name in known:
        return known[name]
    names = ", ".join(sorted(known)) or "none (there is no folder scenarios/ here)"
    raise SettingsError(
        f"there is no scenario {scenario!r}; give the path of a TOML file, or one of: {names}"
    )


def known_scenarios() -> dict[str, Path]:
    """Bare name -> file of the scenarios of the working directory, else of the repository."""
    for folder in (Path("scenarios"), ROOT / "scenarios"):
        if found := {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}:
            return found
    return {}


def scenario_settings(
    scenario: str, *, actors: int | None, seed: int | None, record: int | None = None
) -> RunSettings:
    """The whole settings of a run, with its world and tree of blocks tried out. Raises `SettingsError`.

    `record`: each `record`-th environment step is recorded.
    """
    path = scenario_path(scenario)
    settings = load(path) if seed is None else load(path, seed=seed)
    for option, name, key, value in (
        ("--actors", "actors", "count", actors),
        ("--record", "recording", "every_steps", record),
    ):
        if value is not None:
            table = settings.model_dump()
            table[name][key] = value
            settings = parse(table, origin=option)
    check_world(settings, origin=str(path))
    return settings


def check_world(settings: RunSettings, *, origin: str) -> None:
    """Raise `SettingsError` if the world or the tree of blocks cannot be built.

    What several blocks leave out or share of the observation is told on standard error.
    """
    from babble.bodies import make_body, remarks

    world_id, parameters = settings.world.id, settings.world.parameters
    try:
        world, tree = make_body(world_id, parameters, settings.block, columns=1, seed=0)
    except (ValueError, TypeError) as error:
        raise SettingsError(f"{origin}: {error}") from None
    for remark in remarks(tree, world):
        print(f"{origin}: {remark}", file=sys.stderr)


def at_least(least: int, most: int | None = None) -> Callable[[str], int]:
    """What argparse makes of a whole number on the command line."""
    bounds = f"of at least {least}" if most is None else f"from {least} to {most}"

    def number(text: str) -> int:
        if not text.isdecimal() or int(text) < least or (most is not None and int(text) > most):
            raise argparse.ArgumentTypeError(f"must be a whole number {bounds}, got {text!r}")
        return int(text)

    return number
