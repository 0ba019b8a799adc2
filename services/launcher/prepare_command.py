"""`babble prepare`: a run's folder for processes that somebody else starts, such as containers."""

import argparse
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from services.launcher.config import at_least, scenario_settings
from services.launcher.run_folder import RUNS, RunFolder, RunFolderError
from services.runtime.errors import StorageError
from services.runtime.process import run_name
from services.runtime.settings import RunSettings

LONGEST_VALUE = 60


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble prepare`; an empty number is one that is not given, as compose passes it."""
    parser.add_argument(
        "scenario", metavar="SCENARIO", help="a TOML file, or the bare name of one in scenarios/"
    )
    parser.add_argument(
        "--run", required=True, type=run_name, metavar="NAME", help="the run's name, and its folder's"
    )
    parser.add_argument(
        "--runs", type=Path, default=RUNS, metavar="DIR", help=f"where run folders are (default: {RUNS})"
    )
    parser.add_argument(
        "--seed", type=_or_none(0), metavar="S", help="seed of the run (default: the scenario's)"
    )
    parser.add_argument(
        "--actors", type=_or_none(1), metavar="N", help="actors of `babble up` (default: the scenario's)"
    )


def run(arguments: argparse.Namespace) -> int:
    """Make the run's folder, or say that the one there is goes on or is completed; returns 0.

    Raises `UserError` if the folder is another run's, cannot be written, or the scenario is no scenario.
    """
    name: str = arguments.run
    settings = scenario_settings(arguments.scenario, actors=arguments.actors, seed=arguments.seed)
    path = arguments.runs / name
    if os.path.exists(path / "run.json"):
        print(_found(RunFolder.find(str(path)), name, settings, arguments.seed), flush=True)
        return 0
    _check_writable(path)
    if os.path.isdir(path) and any(path.iterdir()):
        raise RunFolderError(
            f"{path} holds something, and no run; choose another name with --run (BABBLE_RUN), or empty it"
        )
    folder = RunFolder.create(settings, path, sys.argv, run=name)
    print(
        f"made the run {name} in {folder.shown}: scenario {settings.scenario}, seed {settings.seed}",
        flush=True,
    )
    return 0


def _found(folder: RunFolder, name: str, wanted: RunSettings, seed: int | None) -> str:
    """What is said of a run that is there already. Raises `RunFolderError` if it is another one."""
    if folder.run != name:
        raise RunFolderError(
            f"{folder.shown} holds the run {folder.run}, which was moved there; "
            "choose another name with --run (BABBLE_RUN)"
        )
    there = folder.settings()
    # A run has the seed it was begun with, also where nobody says it again.
    wanted = wanted if seed is not None else wanted.model_copy(update={"seed": there.seed})
    if difference := _difference(there, wanted):
        raise RunFolderError(
            f"the run {name} in {folder.shown} was begun with other settings: {difference}; begin another "
            "run with another name (--run or BABBLE_RUN), or give this one its old settings"
        )
    if folder.completed():
        return (
            f"the run {name} in {folder.shown} is completed already; "
            f"begin anew with another name: BABBLE_RUN={_another(name)} (or --run)"
        )
    if folder.in_use():
        raise RunFolderError(
            f"the run {name} in {folder.shown} is going on in `babble up`; end that first, or choose another "
            "name with --run (BABBLE_RUN)"
        )
    _check_writable(folder.path)
    return f"the run {name} in {folder.shown} goes on where it was (seed {there.seed})"


def _difference(there: RunSettings, wanted: RunSettings) -> str:
    """The first setting that differs, with both values; empty if none does.

    How many actors `babble up` starts is nothing that the run depends on.
    """
    old, new = (
        _flat(each.model_dump(mode="json", exclude={"actors": {"count"}})) for each in (there, wanted)
    )
    for key in [*new, *old]:
        if old.get(key) != new.get(key):
            return f"{key} is {_shown(old.get(key))} there and {_shown(new.get(key))} here"
    return ""


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    """Leaf values by dotted name; entries of lists of tables are numbered."""
    if isinstance(value, list) and any(isinstance(each, dict) for each in value):
        value = dict(enumerate(value, start=1))
    if not isinstance(value, dict) or not value:
        return {name: value}
    flat: dict[str, Any] = {}
    for key, inner in value.items():
        flat |= _flat(inner, f"{name}.{key}" if name else str(key))
    return flat


def _shown(value: object) -> str:
    text = "missing" if value is None else str(value)
    return text if len(text) <= LONGEST_VALUE else f"{text[:LONGEST_VALUE]}..."


def _another(name: str) -> str:
    """The name with its number raised, or with one."""
    stem, _, number = name.rpartition("-")
    return (
        f"{stem}-{int(number) + 1}" if stem and number.isdecimal() and len(number) < 4 else f"{name[:60]}-2"
    )


def _check_writable(path: Path) -> None:
    """Raise `StorageError` where this user could not make or change the folder."""
    # os.path, because a Path that may not be looked into raises.
    there = next(folder for folder in (path, *path.absolute().parents) if os.path.exists(folder))
    if not os.path.isdir(there):
        raise StorageError(f"{there} is a file, so that {path} cannot be made; choose another --runs")
    if not os.access(there, os.W_OK | os.X_OK):
        user = os.getuid()
        raise StorageError(
            f"user {user} cannot write into {there}, where {path} belongs; make it (the volume) writable for "
            f"this user, for example with `chown -R {user} {there}`"
        )


def _or_none(least: int) -> Callable[[str], int | None]:
    number = at_least(least)
    return lambda text: number(text) if text else None
