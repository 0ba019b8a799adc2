"""Processes that a test starts, listens to, freezes, kills and is sure to end: its own, by process id."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Self, TypeVar

ROOT = Path(__file__).resolve().parents[2]
END_SECS = 20.0
T = TypeVar("T")


def wait_for(what: str, look: Callable[[], T | bool | None], within_secs: float = 20.0) -> T:
    """The first true value of `look`, asked every few milliseconds; at the deadline AssertionError."""
    deadline = time.monotonic() + within_secs
    while time.monotonic() < deadline:
        found = look()
        if found:
            return found  # type: ignore[return-value]
        time.sleep(0.005)
    raise AssertionError(f"waited {within_secs:.1f} s in vain for {what}")


def free_port() -> int:
    """A TCP port of this machine that nobody had a moment ago."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


class Process:
    """One child process; its output is collected line by line."""

    def __init__(
        self, name: str, arguments: Sequence[str], environment: Mapping[str, str] | None = None
    ) -> None:
        self.name = name
        self.started_secs = time.monotonic()
        self.out: list[str] = []
        self.err: list[str] = []
        settings = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        self._child = subprocess.Popen(
            [sys.executable, *arguments],
            cwd=ROOT,
            env={**os.environ, **settings, **(environment or {})},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        assert self._child.stdout is not None
        assert self._child.stderr is not None
        self._readers = [
            _collect(self._child.stdout, self.out),
            _collect(self._child.stderr, self.err),
        ]

    @property
    def pid(self) -> int:
        """The process id."""
        return self._child.pid

    def running(self) -> bool:
        """True until it has ended."""
        return self._child.poll() is None

    def expect(self, text: str, within_secs: float = 20.0) -> str:
        """The first line on stdout that contains the text; fails early if the process ends without it."""

        def look() -> str | None:
            ended = not self.running()
            if ended:
                self._join()
            for line in list(self.out):
                if text in line:
                    return line
            assert not ended, (
                f"{self.name} ended with {self._child.returncode} before {text!r}: {self.report()}"
            )
            return None

        return wait_for(f"{text!r} from {self.name}", look, within_secs)

    def interrupt(self, number: int = signal.SIGTERM) -> None:
        """Send a signal, by default to end in order."""
        if self.running():
            os.kill(self.pid, number)

    def freeze(self) -> None:
        """Stop it as a debugger would (SIGSTOP)."""
        self.interrupt(signal.SIGSTOP)

    def thaw(self) -> None:
        """Let a frozen one go on."""
        self.interrupt(signal.SIGCONT)

    def kill(self) -> None:
        """kill -9, and wait until it is gone."""
        self.interrupt(signal.SIGKILL)
        self.ended(END_SECS)

    def ended(self, within_secs: float = END_SECS) -> int:
        """The exit code; AssertionError if it has not ended in time."""
        try:
            code = self._child.wait(within_secs)
        except subprocess.TimeoutExpired:
            raise AssertionError(f"{self.name} did not end within {within_secs} s: {self.report()}") from None
        self._join()
        return code

    def report(self) -> str:
        """What it said last, for a failed assertion."""
        return "\n".join([*self.out[-10:], *self.err[-30:]])

    def discard(self) -> None:
        """End it whatever its state, and close its pipes."""
        if self.running():
            self.thaw()
            self.kill()
        self._join()

    def _join(self) -> None:
        for reader in self._readers:
            reader.join(END_SECS)


class Owner:
    """Starts processes for one test and ends them all, only them."""

    def __init__(self) -> None:
        self._started: list[Process] = []

    def start(self, name: str, *arguments: str, environment: Mapping[str, str] | None = None) -> Process:
        """Start `python <arguments>` from the root of the repository."""
        process = Process(name, arguments, environment)
        self._started.append(process)
        return process

    def start_service(self, service: str, *arguments: str) -> Process:
        """Start `python -m services.<service> <arguments>`."""
        return self.start(service, "-m", f"services.{service}", *arguments)

    def start_code(self, name: str, code: str, *arguments: str) -> Process:
        """Start a short program given as text."""
        return self.start(name, "-c", code, *arguments)

    def router(self, endpoint: str | None = None) -> "RunningRouter":
        """Start a router and wait until it is ready."""
        return RunningRouter(self, endpoint or f"tcp/127.0.0.1:{free_port()}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for process in reversed(self._started):
            process.discard()


class RunningRouter:
    """A router process that is ready; it can be killed and started again at the same address."""

    def __init__(self, owner: Owner, endpoint: str) -> None:
        self.endpoint = endpoint
        self._owner = owner
        self.process = self._start()

    def kill(self) -> None:
        """kill -9."""
        self.process.kill()

    def start_again(self) -> None:
        """A new router at the old address, ready."""
        self.process = self._start()

    def _start(self) -> Process:
        process = self._owner.start_service("router", "--listen", self.endpoint)
        process.expect("ready")
        return process


def _collect(stream: IO[str], lines: list[str]) -> threading.Thread:
    def read() -> None:
        with stream:
            for line in stream:
                lines.append(line.rstrip("\n"))

    reader = threading.Thread(target=read, daemon=True)
    reader.start()
    return reader
