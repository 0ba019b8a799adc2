"""The command line of `babble`; a command's module is imported only when it is asked for."""

import importlib
import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

from services.runtime.parser import OneLineParser

COMMANDS = {
    "up": ("services.launcher.up", "train a scenario on this machine and show how it goes"),
    "actor": ("services.launcher.actor_command", "join a run of another host with actors of this one"),
    "prepare": ("services.launcher.prepare_command", "make a run's folder, or go on with the one there is"),
    "watch": ("services.launcher.watch_command", "follow a run until it is done, wherever it goes on"),
    "status": ("services.launcher.status_command", "how a run is going"),
    "view": ("services.launcher.view_command", "see the recording of a run in a browser"),
    "report": ("services.launcher.report_command", "write the report of a run anew, with its figures"),
    "coverage": ("services.launcher.coverage_command", "what a run has explored, of its recorded states"),
    "study": ("services.launcher.study_command", "run the conditions of a study and compare them"),
    "score": ("services.launcher.score_command", "score the saved models of a run in fresh worlds"),
    "worlds": ("services.launcher.worlds_command", "the worlds, with their parameters"),
    "certs": ("services.launcher.certs_command", "certificates for runs over several hosts"),
    "doctor": ("services.launcher.doctor", "what is missing on this machine, and what to install"),
}
OURS = ("babble", "protocol", "services")


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code: 0, 1 for a failure, 2 for what a person must mend."""
    arguments_given = list(sys.argv[1:] if argv is None else argv)
    command = arguments_given[0] if arguments_given and arguments_given[0] in COMMANDS else None
    name = "babble" if command is None else f"babble {command}"
    try:
        return _run(command, arguments_given)
    except ModuleNotFoundError as error:
        package = (error.name or "").partition(".")[0]
        if package in OURS:
            raise
        return _refuse(f"{name}: {package} is not installed here; see what to install with `babble doctor`")
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    except BrokenPipeError:
        # Whoever read our output has gone; the interpreter must not complain about it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 128 + signal.SIGPIPE


def _run(command: str | None, given: list[str]) -> int:
    parser = OneLineParser(
        prog="babble", description="The Composer, trained as a distributed actor-learner service."
    )
    parser.add_argument("--version", action="store_true", help="say the version and exit")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", title="commands")
    module: Any = None
    for name, (path, words) in COMMANDS.items():
        subparser = subparsers.add_parser(name, help=words, description=words.capitalize() + ".")
        if name == command:
            module = importlib.import_module(path)
            module.add_arguments(subparser)
    arguments = parser.parse_args(given)
    if arguments.version:
        from importlib import metadata

        print(f"babble {metadata.version('babble')}")
        return 0
    if module is None:
        parser.print_help()
        return 0
    from services.runtime.errors import UserError

    try:
        return int(module.run(arguments))
    except UserError as error:
        return _refuse(f"babble {command}: {error}")


def _refuse(sentence: str) -> int:
    print(sentence, file=sys.stderr)
    return 2
