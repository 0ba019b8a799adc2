"""`babble up`: from the command line to the scores."""

import argparse
import signal
import sys
import time
from collections.abc import Mapping
from contextlib import nullcontext
from pathlib import Path

from services.launcher import dashboard
from services.launcher.address import CERTS, Address, address_of
from services.launcher.conclusion import left_out_by, print_scores, say_how_to_see_it, write_and_say
from services.launcher.config import at_least, check_world, scenario_settings
from services.launcher.dashboard import GRPC_PORT, WEB_PORT, Choice, Ports
from services.launcher.display import display_for
from services.launcher.interrupts import Interrupts
from services.launcher.lines import cpu_table
from services.launcher.run_folder import RunFolder
from services.launcher.service import Launcher, Outcome
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings

MOST_PORT = 65535


def run(arguments: argparse.Namespace) -> int:
    """Start a run, or go on with one; returns the exit code.

    Raises `UserError` before anything has started.
    """
    if arguments.resume is not None:
        return _resume(arguments)
    if arguments.scenario is None:
        raise UserError("give a scenario, for example `babble up cuboid`, or --resume RUN")
    settings = scenario_settings(
        arguments.scenario, actors=arguments.actors, seed=arguments.seed, record=arguments.record
    )
    address = _address(arguments, settings)
    choice = _choice(arguments)
    with dashboard.ports_for(choice) or nullcontext() as ports:
        folder = RunFolder.create(settings, arguments.run_dir, sys.argv)
        return _go(folder, settings, address, choice, ports)


def _resume(arguments: argparse.Namespace) -> int:
    told = {"SCENARIO": arguments.scenario, "--actors": arguments.actors, "--seed": arguments.seed}
    told |= {"--run-dir": arguments.run_dir, "--record": arguments.record}
    if extra := [name for name, value in told.items() if value is not None]:
        raise UserError(
            f"--resume goes on with the settings in the run's folder; leave out {', '.join(extra)}"
        )
    folder = RunFolder.find(arguments.resume)
    settings = folder.settings()
    check_world(settings, origin=str(folder.path / "config.toml"))
    if folder.result():
        print(f"the run {folder.shown} is completed already:\n")
        print_scores(folder)
        say_how_to_see_it(folder)
        return 0
    address, choice = _address(arguments, settings), _choice(arguments)
    with dashboard.ports_for(choice) or nullcontext() as ports:
        return _go(folder, settings, address, choice, ports)


def _address(arguments: argparse.Namespace, settings: RunSettings) -> Address:
    """Where the router is to be. Raises `UserError`."""
    records = settings.recording.every_steps > 0
    return address_of(arguments.listen, certs=arguments.certs, plain=arguments.plain, records=records)


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
            return _conclude(folder, settings, outcome)
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
    with left_out_by(signal.SIGINT, folder=folder, code=code):
        write_and_say(folder, rollouts=rollouts)


def _conclude(folder: RunFolder, settings: RunSettings, outcome: Outcome) -> int:
    cpu_secs = {**outcome.cpu_secs, "launcher": time.process_time()}
    folder.finish({"scores_secs": round(outcome.scores_secs, 2), "cpu_secs": _rounded(cpu_secs)})
    print_scores(folder)
    last = "the last step" if settings.phases.open_loop else "the scores"
    print(f"\n{outcome.scores_secs:.1f} s from the start of the processes to {last}")
    print("CPU seconds:", *cpu_table(cpu_secs), sep="\n")
    print("\nwriting the report (Ctrl-C leaves it out)", flush=True)
    _report(folder, outcome.code, rollouts=True)
    return outcome.code


def _rounded(cpu_secs: Mapping[str, float]) -> dict[str, float]:
    return {name: round(secs, 2) for name, secs in cpu_secs.items()}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble up`."""
    parser.add_argument(
        "scenario", nargs="?", metavar="SCENARIO", help="a TOML file, or the bare name of one in scenarios/"
    )
    parser.add_argument(
        "--actors", type=at_least(1), metavar="N", help="actors to start (default: the scenario's)"
    )
    parser.add_argument(
        "--seed", type=at_least(0), metavar="S", help="seed of the run (default: the scenario's)"
    )
    parser.add_argument(
        "--record",
        type=at_least(1),
        nargs="?",
        const=1,
        metavar="N",
        help="record the state of each N-th environment step, 1 without N (default: the scenario's)",
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
    _add_addresses(parser)


def _add_addresses(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--listen",
        metavar="ADDRESS",
        help="address of the router, such as tls/0.0.0.0:7447 for further hosts, or tcp/127.0.0.1:7447 "
        "(default: a free port of this machine alone)",
    )
    parser.add_argument(
        "--certs", type=Path, metavar="DIR", help=f"folder of `babble certs`, for tls/ (default: {CERTS})"
    )
    parser.add_argument(
        "--plain", action="store_true", help="nobody else reaches the network, so listen on it without TLS"
    )
    parser.add_argument("--no-dashboard", action="store_true", help="start no dashboard")
    parser.add_argument(
        "--dashboard-port",
        type=at_least(0, MOST_PORT),
        metavar="N",
        help=f"port of the dashboard's page, 0 for any free one (default: {WEB_PORT} if it is free)",
    )
    parser.add_argument(
        "--dashboard-grpc-port",
        type=at_least(0, MOST_PORT),
        metavar="N",
        help=f"port from which the page gets its data (default: {GRPC_PORT} if it is free)",
    )
