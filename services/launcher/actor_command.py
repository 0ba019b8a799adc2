"""`babble actor`: actors of this host for a run of another one, of which only the name is known."""

import argparse
import importlib.util
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import suppress
from functools import partial

from services.launcher.child import child_environment
from services.launcher.crew import Crew
from services.launcher.interrupts import Interrupts
from services.runtime.credentials import add_credential_option, credential_for
from services.runtime.errors import UserError
from services.runtime.process import DEFAULT_ENDPOINT, ENDPOINT_VARIABLE, RUN_VARIABLE, run_name
from services.runtime.tether import tethered

NEEDED = ("zenoh", "onnxruntime", "gymnasium", "mujoco")
"""What an actor imports of other packages; looked for here, before each of them fails on its own."""
MOST_ACTORS = 1024
POLL_SECS = 0.1
STOP_SECS = 5.0
"""Actors asked to stop have so long."""
KILL_SECS = 1.0
LONGEST_LINE = 1 << 16
VOICE = "actor: "
"""What an actor's sentence for a person begins with; all else that it says are lines of its log."""
AUTO = "auto"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble actor`."""
    parser.add_argument(
        "--run",
        type=run_name,
        default=os.environ.get(RUN_VARIABLE) or None,
        metavar="NAME",
        help=f"the run's name, as `babble status` says it where the run is (default: ${RUN_VARIABLE})",
    )
    parser.add_argument(
        "--connect",
        default=os.environ.get(ENDPOINT_VARIABLE) or DEFAULT_ENDPOINT,
        metavar="ADDRESS",
        help=f"the router, such as tls/HOST:7447 (default: ${ENDPOINT_VARIABLE}, else {DEFAULT_ENDPOINT})",
    )
    add_credential_option(parser)
    parser.add_argument(
        "--count",
        type=_count,
        default=1,
        metavar="N",
        help=f"actors to start (default: 1); one per core is sensible, and here are {os.cpu_count()}",
    )
    parser.add_argument(
        "--index",
        default=AUTO,
        type=_index,
        metavar="I",
        help="number of the first actor in the run, the others follow; people are shown those below the "
        "run's view.shown_actors (default: auto, which is beyond them)",
    )


def run(arguments: argparse.Namespace) -> int:
    """Join a run until it is done, or until told to stop; returns the exit code.

    Raises `UserError` for what a person must mend.
    """
    if arguments.run is None:
        raise UserError(f"give the run's name with --run NAME (or {RUN_VARIABLE}=NAME)")
    for package in NEEDED:
        if importlib.util.find_spec(package) is None:
            raise ModuleNotFoundError(f"No module named {package!r}", name=package)
    credential_for("actor", arguments.connect, arguments.credential)
    crew = Crew(
        [partial(Actor, f"actor {number + 1}", told(arguments, number)) for number in range(arguments.count)]
    )
    many = "an actor" if arguments.count == 1 else f"{arguments.count} actors"
    with Interrupts() as interrupts:
        _say(f"{many} for run {arguments.run} at {arguments.connect}; Ctrl-C ends")
        _look_after(crew, interrupts)
        if interrupts.numbers:
            _say(f"left run {arguments.run}")
            return 128 + interrupts.numbers[0]
    if crew.fatal_code == 2 and crew.fatal:
        raise UserError(crew.fatal)
    _say(crew.fatal or f"all actors have ended in order, for run {arguments.run} is done")
    return crew.fatal_code if crew.fatal else 0


def _look_after(crew: Crew, interrupts: Interrupts) -> None:
    """Until no actor is left; whatever happens, none is left behind."""
    try:
        while not (crew.over() or crew.fatal or interrupts.numbers):
            for sentence in crew.poll(time.monotonic()):
                _say(sentence)
            time.sleep(POLL_SECS)
        _end(crew, interrupts)
    finally:
        crew.stop(signal.SIGKILL)


def told(arguments: argparse.Namespace, number: int) -> list[str]:
    """What follows `python` on the command line of one of the actors."""
    index = AUTO if arguments.index == AUTO else str(arguments.index + number)
    command = [
        "-m",
        "services.actor",
        "--run",
        arguments.run,
        "--connect",
        arguments.connect,
        "--index",
        index,
    ]
    if arguments.credential is not None:
        command += ["--credential", str(arguments.credential)]
    return command


class Actor:
    """An actor as a child process, whose log is passed on to this terminal."""

    def __init__(self, name: str, command: Sequence[str]) -> None:
        """Starts it. Raises `UserError` if the operating system refuses."""
        self.name, self.last_words = name, ""
        try:
            # On Linux it dies with the thread that calls here, which is the main thread. In a session of its
            # own, so that Ctrl-C reaches the launcher alone.
            self._child = subprocess.Popen(
                tethered([sys.executable, *command]),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                env=child_environment(),
                start_new_session=True,
                text=True,
                errors="replace",
            )
        except OSError as error:
            raise UserError(f"cannot start {name}: {error.strerror}") from None
        self._ear = threading.Thread(target=self._pass_on, name=name, daemon=True)
        self._ear.start()

    def poll(self) -> int | None:
        """See `Hand.poll`; by then all that it said has been passed on."""
        code = self._child.poll()
        if code is not None:
            self._ear.join(KILL_SECS)
        return code

    def send(self, number: signal.Signals) -> None:
        """See `Hand.send`."""
        self._child.send_signal(number)

    def _pass_on(self) -> None:
        assert self._child.stdout is not None
        with self._child.stdout as lines, suppress(BrokenPipeError):
            while line := lines.readline(LONGEST_LINE):
                if line.startswith(VOICE):
                    self.last_words = line.removeprefix(VOICE).strip()
                else:
                    print(line, end="", file=sys.stderr, flush=True)


def _end(crew: Crew, interrupts: Interrupts) -> None:
    """Let all end in order; at another signal at once."""
    heard = len(interrupts.numbers)
    for number, secs in ((signal.SIGTERM, STOP_SECS), (signal.SIGKILL, KILL_SECS)):
        crew.stop(number)
        deadline_secs = time.monotonic() + secs
        while not crew.over() and time.monotonic() < deadline_secs:
            if number is signal.SIGTERM and len(interrupts.numbers) > heard:
                break
            time.sleep(POLL_SECS)
            crew.poll(time.monotonic())


def _count(text: str) -> int:
    if not (text.isascii() and text.isdecimal() and 1 <= int(text) <= MOST_ACTORS):
        raise argparse.ArgumentTypeError(f"must be a whole number from 1 to {MOST_ACTORS}, got {text!r}")
    return int(text)


def _index(text: str) -> int | str:
    if text != AUTO and not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 0, or auto; got {text!r}")
    return text if text == AUTO else int(text)


def _say(sentence: str) -> None:
    with suppress(BrokenPipeError):
        print(f"babble actor: {sentence}", file=sys.stderr, flush=True)
