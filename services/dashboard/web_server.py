"""The web page of a run: serves the viewer, its page, and recordings if asked.

The viewer's files are made ready on a thread of their own, so that a dashboard need not wait for them.
"""

import errno
import logging
import threading
from collections.abc import Sequence
from pathlib import Path

from services.dashboard.answers import Answers
from services.dashboard.connections import Server
from services.dashboard.pages import ANYWHERE, LOOPBACK, AddressError, Hosts, check_bind
from services.dashboard.viewer_files import viewer_files
from services.runtime.errors import UserError

log = logging.getLogger(__name__)

CLOSE_SECS = 10.0
LOOK_SECS = 0.1
"""So soon is it noticed that the server is to close."""


class WebServer:
    """The web page of a run, with the viewer.

    It shows the stream of a gRPC server on the same host, or recordings if `grpc_port` is None.
    """

    def __init__(
        self,
        bind: str,
        port: int,
        grpc_port: int | None,
        run: str,
        life: str,
        allow_origin: Sequence[str] = (),
        *,
        recordings: Sequence[Path] = (),
        port_option: str = "--web-port",
        cache: Path | None = None,
    ) -> None:
        """Nothing is opened yet. `port` 0 is one that the kernel chooses, `cache` the folder to keep
        the viewer's files in (default: the user's).

        Raises `AddressError` for an address or origin that is none.
        """
        self._bind, self._port, self._cache = check_bind(bind), port, cache
        self._port_option = port_option
        self._answers = Answers(Hosts.of(bind, allow_origin), run, life, grpc_port, recordings)
        self._server: Server | None = None
        self._closing = threading.Event()
        self._threads: list[threading.Thread] = []

    @property
    def url(self) -> str:
        """Where the page is, for a browser on this machine."""
        host = LOOPBACK if self._bind == ANYWHERE else self._bind
        return f"http://{host}:{self._port}"

    @property
    def error(self) -> str:
        """Why the viewer's files cannot be served, in one sentence; empty as long as all is well."""
        return self._answers.error

    @property
    def ready(self) -> bool:
        """True when the viewer's files can be served."""
        return self._answers.viewer is not None

    @property
    def refused(self) -> int:
        """Connections turned away because too many were open."""
        return 0 if self._server is None else self._server.refused

    def start(self) -> None:
        """Begin to serve, on threads of its own. Raises `AddressError` if the port cannot be had."""
        try:
            self._server = Server((self._bind, self._port), self._answers)
        except (OSError, OverflowError) as error:
            raise AddressError(self._refusal(error)) from None
        self._port = int(self._server.server_address[1])
        serving = threading.Thread(target=self._server.serve_forever, args=(LOOK_SECS,), daemon=True)
        making = threading.Thread(target=self._make_ready, daemon=True)
        self._threads = [serving, making]
        for thread in self._threads:
            thread.start()

    def close(self) -> None:
        """Stop serving and free the port; returns within CLOSE_SECS. Open downloads end with the process."""
        self._closing.set()
        if self._server is not None:
            self._server.shutdown()
        for thread in self._threads:
            thread.join(CLOSE_SECS)
        if self._server is not None:
            self._server.server_close()

    def _make_ready(self) -> None:
        try:
            self._answers.viewer = viewer_files(self._closing, self._cache)
        except UserError as error:
            self._answers.error = str(error)
            if not self._closing.is_set():
                log.error("the page has no viewer: %s", error)

    def _refusal(self, error: Exception) -> str:
        where = f"{self._bind}:{self._port}"
        if isinstance(error, OSError) and error.errno == errno.EADDRINUSE:
            return f"the port of the web page, {where}, is in use; give another with {self._port_option}"
        reason = error.strerror if isinstance(error, OSError) else error
        return (
            f"the web page cannot be served at {where}: {reason}; give another port with {self._port_option}"
        )
