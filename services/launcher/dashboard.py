"""Whether and where a run has a dashboard: its two ports, chosen and kept before any process starts."""

import errno
import fcntl
import importlib.util
import os
import socket
import tempfile
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from services.runtime.errors import UserError

HOST = "127.0.0.1"
WEB_PORT = 9090
GRPC_PORT = 9876
MOST_TRIES = 8
"""A port that the kernel calls free may be locked by another run that is only just starting."""
PACKAGE = "rerun"
MISSING = (
    "none, because rerun-sdk is not installed here; `babble doctor` says how to get it (extra `dashboard`)"
)


class PortError(UserError):
    """A port that was asked for and cannot be had."""


@dataclass(frozen=True, kw_only=True)
class Choice:
    """What the command line says of the dashboard; a port is None for the usual one, 0 for any free one."""

    wanted: bool = True
    web_port: int | None = None
    grpc_port: int | None = None


class Ports:
    """The dashboard's ports of this machine, kept from other launchers until it is left (a context manager).

    A dashboard needs seconds before it listens, so a port that looks free may be another starting run's. The
    launchers of one user therefore lock a file per port (flock), which ends with the process that holds it.
    """

    def __init__(self, choice: Choice) -> None:
        """Usual ports that are taken give way to free ones. Raises `PortError` if one was asked for."""
        self._locks: list[int] = []
        self.web = self.grpc = 0
        try:
            # What was asked for comes first, so that a usual port does not take it away.
            if choice.web_port is not None:
                self.web = self._asked("--dashboard-port", choice.web_port)
            if choice.grpc_port is not None:
                self.grpc = self._asked("--dashboard-grpc-port", choice.grpc_port)
            self.web = self.web or self._usual(WEB_PORT)
            self.grpc = self.grpc or self._usual(GRPC_PORT)
        except BaseException:
            self.close()
            raise
        self.moved = choice.web_port is None and self.web != WEB_PORT
        """True if the usual port of the page was taken"""

    @property
    def url(self) -> str:
        """Where a browser of this machine finds the dashboard."""
        return f"http://{HOST}:{self.web}"

    def close(self) -> None:
        """Let the ports go."""
        while self._locks:
            os.close(self._locks.pop())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _asked(self, option: str, port: int) -> int:
        try:
            return self._take(port)
        except OSError as error:
            raise PortError(
                f"{option} {port}: cannot listen at {HOST}:{port} ({error.strerror}); choose another port, "
                "or leave the option out for a free one"
            ) from None

    def _usual(self, port: int) -> int:
        try:
            return self._take(port)
        except OSError:
            try:
                return self._take(0)
            except OSError as error:
                raise PortError(
                    f"there is no free port at {HOST} ({error.strerror}); go without with --no-dashboard"
                ) from None

    def _take(self, port: int) -> int:
        """Lock a port that is free, or any one for 0. Raises OSError."""
        for _ in range(0 if port else MOST_TRIES - 1):
            with suppress(OSError):
                return self._try(0)
        return self._try(port)

    def _try(self, port: int) -> int:
        with socket.socket() as probe:
            # As servers bind: a port that is only waiting out its last connections is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind((HOST, port))
            found = int(probe.getsockname()[1])
        self._lock(found)
        return found

    def _lock(self, port: int) -> None:
        folder = Path(tempfile.gettempdir()) / f"babble-ports-{os.getuid()}"
        try:
            folder.mkdir(mode=0o700, exist_ok=True)
            handle = os.open(folder / str(port), os.O_RDWR | os.O_CREAT, 0o600)
        except OSError:
            return  # nowhere to lock; two runs that start in the same seconds may then meet at a port
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            os.close(handle)
            raise OSError(errno.EADDRINUSE, os.strerror(errno.EADDRINUSE)) from None
        self._locks.append(handle)


def ports_for(choice: Choice) -> Ports | None:
    """The ports of the dashboard; None if none is wanted or it is not installed. Raises `PortError`."""
    return Ports(choice) if choice.wanted and installed() else None


def installed() -> bool:
    """True if the dashboard's package is there; importing it would cost half a second."""
    return importlib.util.find_spec(PACKAGE) is not None


def words(choice: Choice, ports: Ports | None) -> str:
    """What is said of the dashboard at the start of a run."""
    if ports is not None:
        return f"{ports.url} (port {WEB_PORT} is taken)" if ports.moved else ports.url
    return MISSING if choice.wanted else "none (--no-dashboard)"
