"""`babble up`: from the command line to the scores."""

import argparse
import os
import shutil
import signal
import sys
import textwrap
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext, suppress
from pathlib import Path

from services.launcher import dashboard
from services.launcher.config import Address, address_of, check_world, scenario_settings
from services.launcher.dashboard import GRPC_PORT, WEB_PORT, Choice, Ports
from services.launcher.display import display_for
from services.launcher.lines import best_words, brief, cpu_table, score_table
from services.launcher.run_folder import RunFolder
from services.launcher.service import Interrupts, Launcher, Outcome
from services.runtime.checkpoint import DRAFT_SUFFIX
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings

MOST_COLUMNS = 100
MOST_ITERATIONS = 20
"""Of each block, in the table of scores at the end; the one that is kept is shown besides."""
MOST_PORT = 65535


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
    choice = _choice(arguments)
    with dashboard.ports_for(choice) or nullcontext() as ports:
        folder = RunFolder.create(settings, arguments.run_dir, sys.argv)
        return _go(folder, settings, address, choice, ports)


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
        _say_how_to_see_it(folder)
        return 0
    address, choice = address_of(arguments.listen), _choice(arguments)
    with dashboard.ports_for(choice) or nullcontext() as ports:
        return _go(folder, settings, address, choice, ports)


def _choice(arguments: argparse.Namespace) -> Choice:
    """What is said of the dashboard. Raises `UserError` if that is not of one mind."""
    web_port, grpc_port = arguments.dashboard_port, arguments.dashboard_grpc_port
    if arguments.no_dashboard and (web_port is not None or grpc_port is not None):
        raise UserError("--no-dashboard leaves no dashboard to give a port to; leave out one or the other")
    return Choice(wanted=not arguments.no_dashboard, web_port=web_port, grpc_port=grpc_port)


def _go(
    folder: RunFolder, settings: RunSettings, address: Address, choice: Choice, ports: Ports | None
) -> int:
    with folder.locked():
        print(f"run        {folder.shown}\nrouter     {address.connect}", flush=True)
        print(f"dashboard  {dashboard.words(choice, ports)}", flush=True)
        with Interrupts() as interrupts:
            launcher = Launcher(folder, settings, address, display_for(sys.stdout), ports)
            outcome = launcher.run(interrupts)
        if outcome.completed:
            return _conclude(folder, outcome)
    if outcome.sentence:
        print(f"babble up: {outcome.sentence}", file=sys.stderr, flush=True)
    print(f"stopped; go on with: babble up --resume {folder.shown}", flush=True)
    # The folder is free again, so that the report does not take the run for one that is going on.
    if outcome.code != 128 + signal.SIGTERM:
        _report_so_far(folder, outcome.code)
    return outcome.code


def _report_so_far(folder: RunFolder, code: int) -> None:
    """The report of a run that ended early.

    Not after SIGTERM: a machine that shuts down waits for nobody.
    """
    print("writing a report of what there is so far (Ctrl-C leaves it out)", flush=True)
    try:
        _report(folder, code, rollouts=False)
    except UserError as error:
        print(f"it was not written ({error}); babble report {folder.shown} does it later")


def _report(folder: RunFolder, code: int, *, rollouts: bool) -> None:
    """Write the report, which Ctrl-C leaves out. Raises `UserError`."""
    with _left_out_by_ctrl_c(folder, code):
        from services.launcher.report import write_report

        report = write_report(folder.path, rollouts=rollouts)
        print(f"all files are in {folder.shown}; read {report.name} first")
        _say_how_to_see_it(folder)


@contextmanager
def _left_out_by_ctrl_c(folder: RunFolder, code: int) -> Iterator[None]:
    """Ctrl-C ends this process at once, without half-written files; afterwards it no longer does anything.

    No KeyboardInterrupt, because libraries turn one that hits them while they are imported into errors and
    tracebacks of their own.
    """

    def leave(*_: object) -> None:
        sentence = f"\nthe report was not written; babble report {folder.shown} does it later\n"
        with suppress(OSError):
            for draft in folder.path.rglob(f".*.{os.getpid()}{DRAFT_SUFFIX}"):
                draft.unlink()
        with suppress(OSError):
            os.write(sys.stdout.fileno(), sentence.encode())
        os._exit(code or 128 + signal.SIGINT)

    sys.stdout.flush()
    signal.signal(signal.SIGINT, leave)
    try:
        yield
    finally:
        # All is said and done but the interpreter's own end, which would answer with a traceback.
        signal.signal(signal.SIGINT, signal.SIG_IGN)


def _say_how_to_see_it(folder: RunFolder) -> None:
    if folder.recorded():
        print(f"see it again with: babble view {folder.shown}", flush=True)


def _conclude(folder: RunFolder, outcome: Outcome) -> int:
    cpu_secs = {**outcome.cpu_secs, "launcher": time.process_time()}
    folder.finish({"scores_secs": round(outcome.scores_secs, 2), "cpu_secs": _rounded(cpu_secs)})
    _print_scores(folder)
    print(f"\n{outcome.scores_secs:.1f} s from the start of the processes to the scores")
    print("CPU seconds:", *cpu_table(cpu_secs), sep="\n")
    print("\nwriting the report (Ctrl-C leaves it out)", flush=True)
    _report(folder, outcome.code, rollouts=True)
    return outcome.code


def _print_scores(folder: RunFolder) -> None:
    rows, best = folder.scores(), folder.best()
    shown = brief(rows, best, MOST_ITERATIONS)
    print("\n".join(score_table(shown)))
    if len(shown) < len(rows):
        print(f"{len(rows) - len(shown):,} older rows are in {folder.shown}/scores.jsonl")
    width = min(MOST_COLUMNS, shutil.get_terminal_size().columns)
    for sentence in best_words(best):
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
    parser.add_argument("--no-dashboard", action="store_true", help="start no dashboard")
    parser.add_argument(
        "--dashboard-port",
        type=_at_least(0, MOST_PORT),
        metavar="N",
        help=f"port of the dashboard's page, 0 for any free one (default: {WEB_PORT} if it is free)",
    )
    parser.add_argument(
        "--dashboard-grpc-port",
        type=_at_least(0, MOST_PORT),
        metavar="N",
        help=f"port from which the page gets its data (default: {GRPC_PORT} if it is free)",
    )


def _at_least(least: int, most: int | None = None) -> Callable[[str], int]:
    bounds = f"of at least {least}" if most is None else f"from {least} to {most}"

    def parse(text: str) -> int:
        if not text.isdecimal() or int(text) < least or (most is not None and int(text) > most):
            raise argparse.ArgumentTypeError(f"must be a whole number {bounds}, got {text!r}")
        return int(text)

    return parse
