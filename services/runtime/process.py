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
from services.runtime.bus import Bus, Wakeup
from services.runtime.clock import Clock, RealClock
from services.runtime.errors import UserError

log = logging.getLogger(__name__)

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
ENDPOINT_VARIABLE = "BABBLE_CONNECT"
"""The environment variable with the router's address, for hosts and containers."""
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
    life: str
    wakeup: Wakeup
    index: int = 0
    """Which actor of the run this is; 0 for the services of which there is one."""
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
) -> int:
    """Run a service as this process until it is finished or told to stop; returns the exit code.

    `add_options` adds the service's own options to its command line.
    """
    arguments = _parse(service, argv, add_options)
    life = new_life(service)
    log_to_stderr(life)
    signals = _Signals()
    signals.listen()
    return guarded(service, lambda: _run(service, life, build, arguments, signals))


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


def new_life(service: str) -> str:
    """A life name, new at each process start: `<service>-<8 hex digits>`."""
    return f"{service}-{secrets.token_hex(4)}"


def log_to_stderr(life: str) -> None:
    """One line per record: time (UTC), life, level, text. A broken pipe to the log is not an error."""
    line = f"%(asctime)s.%(msecs)03dZ {life} %(levelname)s %(message)s"
    formatter = logging.Formatter(line, "%Y-%m-%dT%H:%M:%S")
    formatter.converter = time.gmtime
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(formatter)
    logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
    logging.raiseExceptions = False


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


def _run(
    service: str,
    life: str,
    build: Callable[[Context], Service],
    arguments: argparse.Namespace,
    signals: _Signals,
) -> None:
    # Imported here so that a simulation, which takes only Context from this module, needs no zenoh.
    from services.runtime.zenoh_bus import ZenohBus

    run = read_run_name(arguments.run_dir)
    run_settings = settings.load(arguments.config or arguments.run_dir / "config.toml")
    if arguments.print_config:
        print(run_settings.model_dump_json(indent=2))
        return
    clock, wakeup = RealClock(), Wakeup()
    log.info("connecting to the router at %s", arguments.connect)
    bus = ZenohBus(arguments.connect, life, wakeup, run_settings.wire.connect_secs)
    try:
        context = Context(
            bus=bus,
            clock=clock,
            settings=run_settings,
            run=run,
            run_dir=arguments.run_dir,
            life=life,
            wakeup=wakeup,
            index=arguments.index,
            options=arguments,
        )
        polled = build(context)
        bus.announce(keys.alive(run, service, life))
        log.info("ready in run %s", run)
        signals.looping = True
        loop(polled, clock, wakeup, lambda: signals.received)
        log.info("finished")
    finally:
        signals.looping = True
        bus.close()


def _parse(
    service: str,
    argv: Sequence[str] | None,
    add_options: Callable[[argparse.ArgumentParser], None] | None,
) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog=f"python -m services.{service}", description=f"The {service} of a run, as this process."
    )
    parser.add_argument(
        "--run-dir", type=Path, required=True, help="the run's folder, with run.json and config.toml"
    )
    parser.add_argument("--config", type=Path, help="the settings (default: config.toml in the run's folder)")
    parser.add_argument(
        "--print-config", action="store_true", help="print all settings as JSON and end; needs no router"
    )
    parser.add_argument(
        "--connect",
        default=os.environ.get(ENDPOINT_VARIABLE, DEFAULT_ENDPOINT),
        help=f"the router's address (default: ${ENDPOINT_VARIABLE}, else {DEFAULT_ENDPOINT})",
    )
    parser.add_argument("--index", type=int, default=0, help="which actor this is; seeds its worlds")
    if add_options is not None:
        add_options(parser)
    return parser.parse_args(argv)


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
