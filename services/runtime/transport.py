"""How Zenoh is configured, as plain data: limits, times, encryption; nothing here imports zenoh.

The values are those that measurements showed to matter: a lease of 1 s, no multicast, no gossip, no
shared memory, a stated size limit; in the router 16 receiving threads, and a stuck client is cut off
after 400 ms, well before a healthy client's lease ends.
"""

import base64
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Self

from protocol.keys import MAX_FRAME_BYTES, ROOT
from services.runtime.credentials import Credential
from services.runtime.errors import BusError

LEASE_MS = 1000
"""A process that is silent for so long is gone to the others; each side announces its own."""
CUT_OFF_US = 400_000
"""Router only; must be shorter than the lease, or a stuck subscriber costs its publishers their links."""
ENVELOPE_BYTES = 64 << 10
"""Room for key and header, so that a frame of exactly MAX_FRAME_BYTES is not silently dropped."""
ROUTER_THREADS = (
    "(rx: (worker_threads: 16), net: (worker_threads: 4), tx: (worker_threads: 8), acc: (worker_threads: 4))"
)
RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}
MAX_SESSIONS = 2048
"""Router only: connections at a time; a process has two, so 1024 processes."""
MAX_PENDING = 64
"""Router only: connections at a time that have not said yet who they are."""
ACCEPT_TIMEOUT_MS = 3000
"""Router only: a stranger who connects and says nothing, or nothing sensible, is let go after so long."""
PROTOCOLS = ("tcp", "tls")
MOST_PORT = 65535
DOOR = f"{ROOT}/@door"
"""The question that the router answers to whoever has any right; others hear nothing."""

Settings = dict[str, object]
"""Path in Zenoh's configuration to value."""


@dataclass(frozen=True)
class Address:
    """An endpoint such as "tls/router.lan:7447" in its parts."""

    protocol: str
    host: str
    """a name or an address; IPv6 without brackets"""
    port: int


def parse_address(endpoint: str) -> Address:
    """The parts of an endpoint. Raises `BusError` unless it looks like tcp/HOST:PORT or tls/HOST:PORT."""
    protocol, _, rest = endpoint.partition("/")
    host, _, port = rest.split("?")[0].split("#")[0].rpartition(":")
    if protocol not in PROTOCOLS or not host or not port.isdecimal() or int(port) > MOST_PORT:
        raise BusError(
            f"{endpoint!r} is not an address; it must look like tcp/127.0.0.1:7447 or tls/router.lan:7447"
        )
    return Address(protocol, host.removeprefix("[").removesuffix("]"), int(port))


@dataclass(frozen=True)
class RouterLink:
    """One client's connection, as the router sees it; a process has two."""

    identity: str | None
    """the common name of the client's certificate; None on plain TCP"""
    host: str
    port: int

    @classmethod
    def of(cls, identity: str | None, endpoint: str) -> Self:
        """The connection with the client's end, such as "tls/10.1.2.3:40000"."""
        address = parse_address(endpoint)
        return cls(identity, address.host, address.port)


def client_settings(endpoint: str, credential: Credential | None) -> Settings:
    """Of a process that connects to the router at `endpoint`. Raises `BusError` for no address."""
    protocol = parse_address(endpoint).protocol
    settings: Settings = {
        "mode": "client",
        "connect/endpoints": [endpoint],
        "listen/endpoints": [],
        "connect/retry": RETRY,
        **_common(protocol),
    }
    if credential is not None:
        settings["transport/link/tls"] = {
            **_trust(credential),
            "connect_private_key_base64": _base64(credential.key_pem),
            "connect_certificate_base64": _base64(credential.certificate_pem),
            "verify_name_on_connect": True,
        }
    return settings


def router_settings(
    endpoint: str, credential: Credential | None, access: Mapping[str, object] | None
) -> Settings:
    """Of a router that listens at `endpoint`. Raises `BusError` for no address."""
    protocol = parse_address(endpoint).protocol
    limited = f"{endpoint}#tls_handshake_timeout_ms={ACCEPT_TIMEOUT_MS}" if protocol == "tls" else endpoint
    settings: Settings = {
        "mode": "router",
        "listen/endpoints": [limited],
        "connect/endpoints": [],
        "adminspace/enabled": True,
        "transport/link/tx/queue/congestion_control/block/wait_before_close": CUT_OFF_US,
        "transport/unicast/max_sessions": MAX_SESSIONS,
        "transport/unicast/max_links": 1,
        "transport/unicast/accept_pending": MAX_PENDING,
        "transport/unicast/accept_timeout": ACCEPT_TIMEOUT_MS,
        **_common(protocol),
    }
    if credential is not None:
        settings["transport/link/tls"] = {
            **_trust(credential),
            "listen_private_key_base64": _base64(credential.key_pem),
            "listen_certificate_base64": _base64(credential.certificate_pem),
        }
    if access is not None:
        settings["access_control"] = dict(access)
    return settings


def _common(protocol: str) -> Settings:
    return {
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "transport/shared_memory/enabled": False,
        "transport/link/protocols": [protocol],
        "transport/link/tx/lease": LEASE_MS,
        "transport/link/rx/max_message_size": MAX_FRAME_BYTES + ENVELOPE_BYTES,
    }


def _trust(credential: Credential) -> dict[str, object]:
    """Both sides show a certificate and ask for one, of the same authority, valid all the time."""
    return {
        "root_ca_certificate_base64": _base64(credential.authority_pem),
        "enable_mtls": True,
        "close_link_on_expiration": True,
    }


def _base64(pem: bytes) -> str:
    return base64.b64encode(pem).decode()
