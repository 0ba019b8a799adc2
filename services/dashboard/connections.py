"""HTTP over sockets with bounds: connections, bytes and seconds of a request, seconds of a part of an answer.

One request per connection, without a body; the standard library parses it.
"""

import gzip
import io
import logging
import socket
import socketserver
import sys
import threading
import time
from collections.abc import Iterator
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler
from typing import Any

from services.dashboard.answers import Answer, Answers, Body, Packed, Stored

log = logging.getLogger(__name__)

MOST_CONNECTIONS = 64
"""Browsers open six per page."""
LONGEST_REQUEST_BYTES = 16_384
REQUEST_SECS = 10.0
"""So long may a request take to arrive."""
SEND_SECS = 30.0
"""So long may a browser take for one part of an answer."""
PART_BYTES = 65_536
LINGER_SECS = 0.5
BLANK_LINE = b"\r\n\r\n"
TOO_BUSY = b"HTTP/1.1 503 Service Unavailable\r\nConnection: close\r\nContent-Length: 0\r\n\r\n"


class Server(socketserver.ThreadingMixIn, socketserver.TCPServer):
    """Listens at once; `serve_forever` answers."""

    allow_reuse_address = True
    daemon_threads = True
    block_on_close = False
    request_queue_size = MOST_CONNECTIONS

    def __init__(self, address: tuple[str, int], answers: Answers) -> None:
        """Raises OSError or OverflowError if the address cannot be had."""
        self.answers = answers
        self.refused = 0
        self._free = threading.Semaphore(MOST_CONNECTIONS)
        super().__init__(address, _Connection)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Give the connection a thread, or turn it away."""
        if self._free.acquire(blocking=False):
            try:
                super().process_request(request, client_address)
            except RuntimeError:
                # No thread could be started, so none will give the place back.
                self._free.release()
                raise
            return
        self.refused += 1
        try:
            request.settimeout(LINGER_SECS)
            request.sendall(TOO_BUSY)
        except OSError as error:
            log.debug("turned away, and gone: %s", error)
        self.shutdown_request(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, on the connection's thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: Any, client_address: Any) -> None:
        """A browser that went away is no error of ours."""
        if isinstance(sys.exception(), OSError):
            log.debug("a connection ended early: %s", sys.exception())
        else:
            log.exception("a request was not answered")


class _Connection(BaseHTTPRequestHandler):
    """One request and its answer."""

    protocol_version = "HTTP/1.1"
    server_version = "babble"
    sys_version = ""
    server: Server
    connection: socket.socket

    def handle(self) -> None:
        """Read the request within its bounds, answer it, and be done."""
        self.close_connection = True
        request = self._read_request()
        if request is None:
            return
        self.rfile = io.BufferedReader(io.BytesIO(request))
        self.raw_requestline = self.rfile.readline(LONGEST_REQUEST_BYTES)
        self.connection.settimeout(SEND_SECS)
        if len(request) > LONGEST_REQUEST_BYTES:
            self.requestline, self.request_version, self.command = "", self.protocol_version, ""
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)
        elif self.parse_request():
            self._send(self.server.answers.answer(self.command, self.path, self.headers))
        self._linger()

    def log_message(self, format: str, *args: Any) -> None:
        """A page asks every two seconds; that is nothing for a log."""
        log.debug(format, *args)

    def _read_request(self) -> bytes | None:
        """Bytes up to the blank line or beyond the longest request; None if they did not come."""
        request, deadline_secs = b"", time.monotonic() + REQUEST_SECS
        while BLANK_LINE not in request and len(request) <= LONGEST_REQUEST_BYTES:
            self.connection.settimeout(max(0.001, deadline_secs - time.monotonic()))
            part = self.connection.recv(LONGEST_REQUEST_BYTES)
            if not part:
                return None
            request += part
        return request

    def _send(self, answer: Answer) -> None:
        self.send_response(answer.status)
        for name, value in answer.headers.items():
            self.send_header(name, value)
        if answer.status is not HTTPStatus.NOT_MODIFIED:
            self.send_header("Content-Length", str(answer.size_bytes))
        self.send_header("Connection", "close")
        self.end_headers()
        if self.command != "HEAD":
            for part in _parts(answer.body):
                self.connection.sendall(part)

    def _linger(self) -> None:
        """Let the answer arrive: closing with unread bytes would take it back."""
        self.connection.shutdown(socket.SHUT_WR)
        deadline_secs = time.monotonic() + LINGER_SECS
        self.connection.settimeout(LINGER_SECS)
        while self.connection.recv(PART_BYTES) and time.monotonic() < deadline_secs:
            pass


def _parts(body: Body) -> Iterator[bytes]:
    """The body in pieces, never more of it than was announced."""
    left_bytes = len(body) if isinstance(body, bytes) else body.size_bytes
    with _opened(body) as file:
        while left_bytes > 0 and (part := file.read(min(PART_BYTES, left_bytes))):
            left_bytes -= len(part)
            yield part


def _opened(body: Body) -> io.BufferedIOBase:
    match body:
        case Stored(path=path):
            return path.open("rb")
        case Packed(gzipped=gzipped):
            return gzip.open(io.BytesIO(gzipped))
        case _:
            return io.BytesIO(body)
