"""The one loop: every service is an object that is polled here, with one way to start, stop and fail.

Exit codes: 0 finished or stopped, 2 something a person can mend (one sentence on stderr), 1 a bug
(traceback in the log).
"""

import argparse
import json
import logging
import os
import secrets
import signal
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from pydantic import TypeAdapter, ValidationError

from protocol import keys
from protocol.messages import Name
from services.runtime import settings
from services.runtime.announced import AnnouncedSettings
from services.runtime.bus import Bus, Wakeup
from services.runtime.clock import Clock, RealClock
from services.runtime.credentials import add_credential_option, credential_for
from services.runtime.errors import UserError
from services.runtime.parser import OneLineParser

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
ENDPOINT_VARIABLE = "BABBLE_CONNECT"
"""The environment variable with the router's address, for hosts and containers."""
RUN_VARIABLE = "BABBLE_RUN"
"""The environment variable with the run's name, for actors."""
LOG_VARIABLE = "BABBLE_LOG"
"""The environment variable with the least level of what is logged; without it, `info`."""
LOG_LEVELS = ("debug", "info", "warning", "error")
NO_FOLDER = Path(os.devnull)
"""The run folder of a process that has none: nothing can be read or written under it."""
LONGEST_SLEEP_SECS = 0.25
"""So soon is a signal noticed, whatever a service asked for."""
STOP_SECS = 4.0
"""A stopped service may go on so long to end in order."""


class Service(Protocol):
    """What the loop polls."""

    def poll(self, now_secs: float) -> float | None:
        """Do a bounded quantum of work; seconds until wanted again (0 = at once), None = finished."""
        ...

    def stop(self) -> None:
        """Begin to end: the coming polls put things in order, then return None."""
        ...


@dataclass(frozen=True, kw_only=True)
class Context:
    """What a service is given to live in."""

    bus: Bus
    clock: Clock
    settings: settings.RunSettings
    run: str
    run_dir: Path
    """`NO_FOLDER` for a process that was given the run's name only"""
    life: str
    wakeup: Wakeup
    index: int = 0
    """Which actor of the run, or learner of its kind, this is; 0 for services of which there is one."""
    options: argparse.Namespace = field(default_factory=argparse.Namespace)
    """The whole command line, for services with options of their own."""


@dataclass
class _Signals:
    """SIGTERM and SIGINT: before the loop they end the process, in the loop they ask it to stop."""

    looping: bool = False
    received: bool = False

    def listen(self) -> None:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, self._hear)

    def _hear(self, number: int, frame: object) -> None:
        self.received = True
        if not self.looping:
            raise SystemExit(0)


def run_process(
    service: str,
    build: Callable[[Context], Service],
    argv: Sequence[str] | None = None,
    *,
    add_options: Callable[[argparse.ArgumentParser], None] | None = None,
    by_name: bool = False,
) -> int:
    """Run a service as this process until it is finished or told to stop; returns the exit code.

    `add_options` adds the service's own options to its command line. `by_name`: it can do with the run's
    name instead of its folder; the settings then come from the coordinator, and when the coordinator
    announces others, this process begins anew.
    """
    arguments = _parse(service, argv, add_options, by_name)
    log_to_stderr(service)
    process = _Process(service, build, arguments)
    process.signals.listen()
    code = guarded(service, process.run)
    if process.outdated and code == 0 and not process.signals.received:
        os.execv(sys.executable, sys.orig_argv)
    return code


def guarded(what: str, main: Callable[[], None]) -> int:
    """Run `main`; returns the exit code after saying on stderr what went wrong, if anything did."""
    try:
        main()
        code = 0
    except UserError as error:
        _say(f"{what}: {error}")
        code = 2
    except (SystemExit, KeyboardInterrupt):
        code = 0
    except Exception as error:
        log.exception("stopped by a bug")
        _say(f"{what}: stopped by a bug ({type(error).__name__}: {error}); the traceback is in its log above")
        code = 1
    logging.shutdown()
    _forget_broken_pipes()
    return code


def new_life(service: str, host: str = "") -> str:
    """A life name, new at each process start: `<service>-<8 hex digits>`.

    With the host label of a credential `<service>-<host>-<8 hex digits>`: the router lets that host's
    processes use no other names.
    """
    return "-".join(filter(None, (service, host, secrets.token_hex(4))))


def log_to_stderr(life: str) -> None:
    """One line per record: time (UTC), life, level, text. A broken pipe to the log is not an error."""
    line = f"%(asctime)s.%(msecs)03dZ {life} %(levelname)s %(message)s"
    formatter = logging.Formatter(line, "%Y-%m-%dT%H:%M:%S")
    formatter.converter = time.gmtime
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    told = os.environ.get(LOG_VARIABLE) or "info"
    level = told if told in LOG_LEVELS else "info"
    logging.basicConfig(level=level.upper(), handlers=[handler], force=True)
    logging.raiseExceptions = False
    if level != told:
        log.warning("%s=%s is none of %s; taken as info", LOG_VARIABLE, told, ", ".join(LOG_LEVELS))


def read_run_name(run_dir: Path) -> str:
    """The run's name in the run folder's `run.json`. Raises `SettingsError`."""
    path = run_dir / "run.json"
    try:
        return TypeAdapter(Name).validate_python(json.loads(path.read_text(encoding="utf-8"))["run"])
    except OSError as error:
        raise settings.SettingsError(
            f"cannot read {path}: {error.strerror}; give --run-dir the folder that `babble up` made"
        ) from None
    except (ValueError, KeyError, TypeError, ValidationError):
        sentence = f'{path} must hold {{"run": "<name>"}} with a name in a-z, 0-9, - and _'
        raise settings.SettingsError(sentence) from None


def loop(service: Service, clock: Clock, wakeup: Wakeup, stopping: Callable[[], bool]) -> None:
    """Poll until the service is finished, or until STOP_SECS after `stopping` turned true."""
    deadline_secs = float("inf")
    asked = False
    delay_secs = service.poll(clock.now_secs())
    while delay_secs is not None:
        if asked and clock.now_secs() > deadline_secs:
            log.warning("not in order %.0f s after being asked to stop; ending all the same", STOP_SECS)
            return
        if not asked and stopping():
            log.info("asked to stop")
            asked, deadline_secs, delay_secs = True, clock.now_secs() + STOP_SECS, 0.0
            service.stop()
        if delay_secs > 0:
            wakeup.wait(min(delay_secs, LONGEST_SLEEP_SECS))
        delay_secs = service.poll(clock.now_secs())


class _Process:
    """One start of a service, from its command line to its end."""

    def __init__(
        self, service: str, build: Callable[[Context], Service], arguments: argparse.Namespace
    ) -> None:
        self.signals = _Signals()
        self.outdated = False
        """True if it ended because the settings that it was started with no longer hold."""
        self._service, self._build, self._arguments = service, build, arguments

    def run(self) -> None:
        """Live until finished, told to stop or outdated."""
        # Imported here so that a simulation, which takes only Context from this module, needs no zenoh.
        from services.runtime.zenoh_bus import ZenohBus

        arguments = self._arguments
        known = None if arguments.run_dir is None else _read_folder(arguments)
        if known is not None and arguments.print_config:
            _print(known[1])
            return
        credential = credential_for(self._service, arguments.connect, arguments.credential)
        life = new_life(self._service, "" if credential is None else credential.host)
        log_to_stderr(life)
        wire = settings.WireSettings() if known is None else known[1].wire
        wakeup = Wakeup()
        log.info("connecting to the router at %s", arguments.connect)
        bus = ZenohBus(arguments.connect, life, wakeup, wire.connect_secs, credential)
        try:
            if known is None:
                self._live_by_name(bus, life, wakeup, wire.connect_secs)
            else:
                self._live(bus, life, wakeup, *known, lambda: False)
        finally:
            self.signals.looping = True
            bus.close()

    def _live_by_name(self, bus: Bus, life: str, wakeup: Wakeup, within_secs: float) -> None:
        run, endpoint = self._arguments.run, self._arguments.connect
        announced = AnnouncedSettings(bus, run, RealClock(), wakeup)
        log.info("waiting for the settings of run %s", run)
        run_settings = announced.wait(endpoint, within_secs)
        if self._arguments.print_config:
            _print(run_settings)
            return
        self._live(bus, life, wakeup, run, run_settings, announced.replaced)
        if announced.replaced() and not self.signals.received:
            log.info("run %s was begun again or its settings changed; beginning anew", run)
            self.outdated = True

    def _live(
        self,
        bus: Bus,
        life: str,
        wakeup: Wakeup,
        run: str,
        run_settings: settings.RunSettings,
        replaced: Callable[[], bool],
    ) -> None:
        clock = RealClock()
        context = Context(
            bus=bus,
            clock=clock,
            settings=run_settings,
            run=run,
            run_dir=self._arguments.run_dir or NO_FOLDER,
            life=life,
            wakeup=wakeup,
            options=self._arguments,
        )
        polled = self._build(context)
        bus.announce(keys.alive(run, self._service, life))
        log.info("ready in run %s", run)
        self.signals.looping = True
        loop(polled, clock, wakeup, lambda: self.signals.received or replaced())
        log.info("finished")


def _read_folder(arguments: argparse.Namespace) -> tuple[str, settings.RunSettings]:
    """The run's name and its settings. Raises `SettingsError`."""
    run = read_run_name(arguments.run_dir)
    return run, settings.load(arguments.config or arguments.run_dir / "config.toml")


def _print(run_settings: settings.RunSettings) -> None:
    print(run_settings.model_dump_json(indent=2))


def _parse(
    service: str,
    argv: Sequence[str] | None,
    add_options: Callable[[argparse.ArgumentParser], None] | None,
    by_name: bool,
) -> argparse.Namespace:
    parser = OneLineParser(
        prog=f"python -m services.{service}", description=f"The {service} of a run, as this process."
    )
    which = parser.add_mutually_exclusive_group(required=not by_name)
    which.add_argument("--run-dir", type=Path, help="the run's folder, with run.json and config.toml")
    if by_name:
        which.add_argument(
            "--run",
            type=run_name,
            default=os.environ.get(RUN_VARIABLE) or None,
            help=f"the run's name; its coordinator tells the rest (default: ${RUN_VARIABLE})",
        )
    parser.add_argument("--config", type=Path, help="the settings (default: config.toml in the run's folder)")
    parser.add_argument(
        "--print-config",
        action="store_true",
        help="print all settings as JSON and end; with --run-dir it needs no router",
    )
    parser.add_argument(
        "--connect",
        default=os.environ.get(ENDPOINT_VARIABLE) or DEFAULT_ENDPOINT,
        help=f"the router's address (default: ${ENDPOINT_VARIABLE}, else {DEFAULT_ENDPOINT})",
    )
    add_credential_option(parser)
    if add_options is not None:
        add_options(parser)
    arguments = parser.parse_args(argv)
    if arguments.run_dir is None and arguments.run is None:
        parser.error("give --run NAME or --run-dir DIR")
    if arguments.run_dir is None and arguments.config is not None:
        parser.error("--config goes with --run-dir; by its name a run tells its settings itself")
    return arguments


def run_name(text: str) -> str:
    """A run's name on a command line. Raises `argparse.ArgumentTypeError`."""
    try:
        return TypeAdapter(Name).validate_python(text)
    except ValidationError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is no name of a run: 1 to 64 of a-z, 0-9, - and _, beginning with a letter or digit"
        ) from None


def _say(sentence: str) -> None:
    try:
        print(sentence, file=sys.stderr, flush=True)
    except BrokenPipeError:
        _forget_broken_pipes()


def _forget_broken_pipes() -> None:
    """Point closed outputs at /dev/null, or the interpreter ends with a complaint and code 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except (BrokenPipeError, ValueError):
            os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())
