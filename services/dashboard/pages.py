"""What the web server answers, apart from the files of the viewer: hosts, headers, the page, its facts.

Only pages that were opened under a name of ours are served: a web site whose name was made to point
at this machine (DNS rebinding) gets nothing.
"""

import html
import ipaddress
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import urlsplit

from services.runtime.errors import UserError

PAGE = Path(__file__).with_name("page")
MEDIA_TYPES = {
    ".css": "text/css; charset=utf-8",
    ".html": "text/html; charset=utf-8",
    ".ico": "image/x-icon",
    ".js": "text/javascript; charset=utf-8",
    ".json": "application/json",
    ".rrd": "application/octet-stream",
    ".txt": "text/plain; charset=utf-8",
    ".wasm": "application/wasm",
}
LOOPBACK = "127.0.0.1"
ANYWHERE = "0.0.0.0"
OURS = frozenset({LOOPBACK, "localhost"})
HOST = re.compile(r"([a-z0-9](?:[a-z0-9.-]{0,251}[a-z0-9])?)(?::(\d{1,5}))?")
"""A name or an IPv4 address, and a port."""


class AddressError(UserError):
    """An address at which nothing can be served."""


@dataclass(frozen=True)
class Hosts:
    """The host names under which the page may be opened."""

    names: frozenset[str]

    @classmethod
    def of(cls, bind: str, allow_origin: Iterable[str]) -> "Hosts":
        """The loopback names, the address that is bound, and those allowed. Raises `AddressError`."""
        bound = check_bind(bind)
        return cls(OURS | ({bound} - {ANYWHERE}) | {_allowed(origin) for origin in allow_origin})

    def of_request(self, header: str) -> str | None:
        """The name in a Host header, if it is one of ours."""
        found = HOST.fullmatch(header.strip().lower())
        return found[1] if found is not None and found[1] in self.names else None


def check_bind(bind: str) -> str:
    """The address, if it is one. Raises `AddressError`.

    IPv4 only: rerun's stream listens there, and a content security policy cannot name IPv6 addresses.
    """
    try:
        return str(ipaddress.IPv4Address(bind))
    except ValueError:
        raise AddressError(
            f"--bind {bind!r} is not an IPv4 address; give {LOOPBACK} for this machine alone, "
            f"{ANYWHERE} for all of its networks, or the address of one of them"
        ) from None


def stream_origins(bind: str, allow_origin: Sequence[str]) -> list[str]:
    """Patterns of the origins that the gRPC server must let read the stream (its `cors_allow_origin`).

    rerun lets localhost and 127.0.0.1 read it anyway. Raises `AddressError`.
    """
    return [f"http://{name}:*" for name in sorted(Hosts.of(bind, allow_origin).names - OURS)]


def stream_host(host: str) -> str:
    """Where a page that was opened at `host` finds the stream: on the same host, by IPv4."""
    return LOOPBACK if host == "localhost" else host


def security_headers(host: str, grpc_port: int | None) -> dict[str, str]:
    """The page may load from us and talk to us and the stream's port, and to nobody else."""
    stream = "" if grpc_port is None else f" http://{stream_host(host)}:{grpc_port}"
    policy = (
        "default-src 'none'; script-src 'self' 'wasm-unsafe-eval'; style-src 'self' 'unsafe-inline'; "
        f"img-src 'self' data: blob:; font-src 'self'; connect-src 'self' data: blob:{stream}; "
        "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
    )
    return {
        "Content-Security-Policy": policy,
        "Cross-Origin-Resource-Policy": "same-origin",
        "Referrer-Policy": "no-referrer",
        "X-Content-Type-Options": "nosniff",
    }


def page(run: str) -> dict[str, bytes]:
    """Path -> contents of the page's own files, for this run."""
    index = (PAGE / "index.html").read_text(encoding="utf-8").replace("{run}", html.escape(run))
    named = {f"/{name}": (PAGE / name).read_bytes() for name in ("page.css", "page.js")}
    return {"/": index.encode(), **named}


def media_type(path: str) -> str:
    """What a file is, by the end of its name."""
    return MEDIA_TYPES[Path(path).suffix or ".html"]


def _allowed(origin: str) -> str:
    """The host of `http://name:port` or `name`. Raises `AddressError`."""
    given = origin.strip().lower()
    host = urlsplit(given).netloc if "://" in given else given
    found = HOST.fullmatch(host)
    if found is None or (given != host and given.rstrip("/") != f"http://{host}"):
        raise AddressError(
            f"--allow-origin {origin!r} is not the address of a page; give the host under which "
            "you open it, such as http://lab-machine:9090 or lab-machine"
        )
    return found[1]
