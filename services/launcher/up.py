"""`babble up`: from the command line to the scores."""

import argparse
import shutil
import sys
import textwrap
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from services.launcher.config import Address, address_of, check_world, scenario_settings
from services.launcher.display import display_for
from services.launcher.lines import best_words, cpu_table, score_table
from services.launcher.run_folder import RunFolder
from services.launcher.service import Interrupts, Launcher, Outcome
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings

MOST_COLUMNS = 100


def run(arguments: argparse.Namespace) -> int:
    """Start a run, or go on with one; returns the exit code.

    Raises `UserError` before anything has started.
    """
    if arguments.resume is not None:
        return _resume(arguments)
    if arguments.scenario is None:
        raise UserError("give a scenario, for example `babble up cuboid`, or --resume RUN")
    settings = scenario_settings(arguments.scenario, actors=arguments.actors, seed=arguments.seed)
    address = address_of(arguments.listen)
    folder = RunFolder.create(settings, arguments.run_dir, sys.argv)
    return _go(folder, settings, address)


def _resume(arguments: argparse.Namespace) -> int:
    told = {"SCENARIO": arguments.scenario, "--actors": arguments.actors, "--seed": arguments.seed}
    told["--run-dir"] = arguments.run_dir
    if extra := [name for name, value in told.items() if value is not None]:
        raise UserError(
            f"--resume goes on with the settings in the run's folder; leave out {', '.join(extra)}"
        )
    folder = RunFolder.find(arguments.resume)
    settings = folder.settings()
    check_world(settings, origin=str(folder.path / "config.toml"))
    if folder.result():
        print(f"the run {folder.shown} is completed already; its scores:\n")
        _print_scores(folder)
        return 0
    return _go(folder, settings, address_of(arguments.listen))


def _go(folder: RunFolder, settings: RunSettings, address: Address) -> int:
    with folder.locked():
        print(f"run     {folder.shown}\nrouter  {address.connect}", flush=True)
        with Interrupts() as interrupts:
            outcome = Launcher(folder, settings, address, display_for(sys.stdout)).run(interrupts)
        if outcome.completed:
            return _conclude(folder, outcome)
    if outcome.sentence:
        print(f"babble up: {outcome.sentence}", file=sys.stderr)
    print(f"stopped; go on with: babble up --resume {folder.shown}")
    return outcome.code


def _conclude(folder: RunFolder, outcome: Outcome) -> int:
    cpu_secs = {**outcome.cpu_secs, "launcher": time.process_time()}
    folder.finish({"scores_secs": round(outcome.scores_secs, 2), "cpu_secs": _rounded(cpu_secs)})
    _print_scores(folder)
    print(f"\n{outcome.scores_secs:.1f} s from the start of the processes to the scores")
    print("CPU seconds:", *cpu_table(cpu_secs), sep="\n", flush=True)
    from services.launcher.report import write_report

    report = write_report(folder.path)
    print(f"\nall files are in {folder.shown}; read {report.name} first")
    return outcome.code


def _print_scores(folder: RunFolder) -> None:
    print("\n".join(score_table(folder.scores())))
    width = min(MOST_COLUMNS, shutil.get_terminal_size().columns)
    for sentence in best_words(folder.best()):
        print(textwrap.fill(sentence, width, subsequent_indent="  "), flush=True)


def _rounded(cpu_secs: Mapping[str, float]) -> dict[str, float]:
    return {name: round(secs, 2) for name, secs in cpu_secs.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble up`."""
    parser.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="a TOML file, or the bare name of one in scenarios/"
    )
    parser.add_argument(
        "--actors", type=_at_least(1), metavar="N", help="actors to start (default: the scenario's)"
    )
    parser.add_argument(
        "--seed", type=_at_least(0), metavar="S", help="seed of the run (default: the scenario's)"
    )
    parser.add_argument(
        "--run-dir",
        type=Path,
        metavar="D",
        help="the run's folder, new or empty (default: a new one in runs/)",
    )
    parser.add_argument(
        "--resume", metavar="RUN", help="go on with a run: its folder, or its name under runs/"
    )
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        help="address of the router, such as tcp/127.0.0.1:7447 (default: a free port)",
    )


def _at_least(least: int) -> Callable[[str], int]:
    def parse(text: str) -> int:
        if not text.isdecimal() or int(text) < least:
            raise argparse.ArgumentTypeError(f"must be a whole number of at least {least}, got {text!r}")
        return int(text)

    return parse
