"""Processes of this repository, started, watched and ended by their ids."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from bench.scene import ROOT

TICKS_PER_SEC = os.sysconf("SC_CLK_TCK")
END_SECS = 10.0
READY_SECS = 30.0


@dataclass
class Child:
    """A child process; its output goes to `log`."""

    name: str
    log: Path
    popen: subprocess.Popen[bytes]
    started_secs: float
    """`time.monotonic()` just before it was started."""
    cpu_secs: float = 0.0
    """User and system time, once it has ended."""

    def cpu_so_far_secs(self) -> float:
        """User and system time until now, in steps of 10 ms."""
        try:
            fields = Path(f"/proc/{self.popen.pid}/stat").read_text().rpartition(")")[2].split()
        except (OSError, IndexError):
            return self.cpu_secs
        return (int(fields[11]) + int(fields[12])) / TICKS_PER_SEC

    def peak_mb(self) -> float:
        """Most resident memory so far in MB (10^6 bytes), 0 once it has ended.

        Unlike ru_maxrss it holds nothing of the parent's.
        """
        try:
            lines = Path(f"/proc/{self.popen.pid}/status").read_text().splitlines()
        except OSError:
            return 0.0
        return sum(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6

    def running(self) -> bool:
        """False once it has ended, with `cpu_secs` known."""
        if self.popen.returncode is None:
            pid, status, usage = os.wait4(self.popen.pid, os.WNOHANG)
            if pid:
                self.popen.returncode = os.waitstatus_to_exitcode(status)
                self.cpu_secs = usage.ru_utime + usage.ru_stime
        return self.popen.returncode is None

    def end(self) -> None:
        """Ask it to end, and kill it if it does not."""
        for number in (signal.SIGTERM, signal.SIGKILL):
            deadline = time.monotonic() + END_SECS
            if self.running():
                self.popen.send_signal(number)
            while self.running() and time.monotonic() < deadline:
                time.sleep(0.005)


def start(name: str, folder: Path, *arguments: str, core: int | None = None) -> Child:
    """Start `python <arguments>` with one thread per library, on one core if that is given."""
    log = folder / f"{name}.log"
    settings = {"OMP_NUM_THREADS": "1", "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
    command = [sys.executable, *arguments]
    if core is not None:
        command = ["taskset", "-c", str(core), *command]
    with log.open("wb") as output:
        began = time.monotonic()
        popen = subprocess.Popen(
            command,
            cwd=ROOT,
            env={**os.environ, **settings},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
        )
    return Child(name, log, popen, began)


def service(name: str, folder: Path, endpoint: str, *, index: int = 0, core: int | None = None) -> Child:
    """Start a service of the run in the folder."""
    run = ["--run-dir", str(folder), "--connect", endpoint]
    run += ["--index", str(index)] if name == "actor" else []
    title = f"{name}-{index}" if name == "actor" else name
    return start(title, folder, "-m", f"services.{name}", *run, core=core)


@contextmanager
def router(folder: Path) -> Iterator[tuple[str, Child]]:
    """A router that is ready: its endpoint, and its process. Raises RuntimeError if it does not get ready."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{probe.getsockname()[1]}"
    child = start("router", folder, "-m", "services.router", "--listen", endpoint)
    try:
        wait_for_line(child, "ready at")
        yield endpoint, child
    finally:
        child.end()


def wait_for_line(child: Child, text: str, within_secs: float = READY_SECS) -> str:
    """The first line of its log with the text. Raises RuntimeError at its end or at the deadline."""
    deadline = time.monotonic() + within_secs
    while True:
        alive = child.running()
        for line in child.log.read_text(errors="replace").splitlines():
            if text in line:
                return line
        if not alive or time.monotonic() > deadline:
            raise RuntimeError(
                f"{child.name} never said {text!r}; its log is {child.log.read_text()[-2000:]}"
            )
        time.sleep(0.005)
