"""Where the router of `babble up` listens, how its processes reach it, and what they show there."""

import ipaddress
import os
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from services.runtime.credentials import Credential, CredentialError, credential_for, read_credential
from services.runtime.errors import BusError
from services.runtime.transport import parse_address

CERTS = Path("certs")
"""Where `babble certs` puts its files."""
LOCAL_ACTOR = "actor.local"
IDENTITIES = (
    "router",
    "coordinator",
    "encoder_learner",
    "policy_learner",
    "dashboard",
    "launcher",
    LOCAL_ACTOR,
)
"""Whose credentials `babble up` needs for a tls/ address; where a run records, the recorder's too."""
EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Addresses to listen at, and how this machine reaches them."""


@dataclass(frozen=True, kw_only=True)
class Address:
    """Where the router listens, and how processes of this machine reach it."""

    listen: str
    connect: str
    certs: Path | None = None
    """the folder of `babble certs`; None where nothing is encrypted"""
    plain: bool = False
    """nobody else reaches the network, as far as a person has said"""

    def options(self, identity: str) -> tuple[str, ...]:
        """What a process of this identity is told on its command line of where it connects or listens."""
        where = ("--listen", self.listen) if identity == "router" else ("--connect", self.connect)
        shows = ("--credential", str(credential_file(self.certs, identity))) if self.certs else ()
        return (*where, *shows, *(("--plain",) if self.plain and identity == "router" else ()))

    def credential(self) -> Credential | None:
        """What the launcher itself shows. Raises `CredentialError`."""
        path = None if self.certs is None else credential_file(self.certs, "launcher")
        return credential_for("launcher", self.connect, path)


def address_of(
    listen: str | None, *, certs: Path | None = None, plain: bool = False, records: bool = False
) -> Address:
    """The address that was asked for, if it is free, else one of this machine alone on a free port.

    Raises `BusError` if it is no address, is taken or is open to anybody, and `CredentialError` if a
    credential that it needs cannot be used.
    """
    protocol, host, port = ("tcp", "127.0.0.1", 0) if listen is None else _parts(listen)
    if protocol == "tcp" and certs is not None:
        raise BusError(
            "--certs is of use for a tls/ address only; give --listen tls/0.0.0.0:7447, for example"
        )
    if protocol == "tcp" and not plain and not _is_loopback(host):
        raise BusError(
            f"anybody who reaches {listen} could take part in the run; make certificates with `babble certs "
            f"init` and use --listen tls/{_bracketed(host)}:{port}, or say with --plain that nobody else "
            "reaches that network"
        )
    reached = EVERYWHERE.get(host, host)
    if protocol == "tls":
        certs = certs or CERTS
        _check_credentials(certs, reached, (*IDENTITIES, "recorder") if records else IDENTITIES)
    port = _free_port(host, port, listen)
    return Address(
        listen=f"{protocol}/{_bracketed(host)}:{port}",
        connect=f"{protocol}/{_bracketed(reached)}:{port}",
        certs=certs,
        plain=plain,
    )


def launcher_credential(endpoint: str, given: Path | None) -> Credential | None:
    """What a command of the launcher shows at an address: the file that was given, else that in certs/.

    Raises `CredentialError`.
    """
    usual = credential_file(CERTS, "launcher")
    # os.path, because a folder that is closed to this user raises; then the usual file is told of.
    if given is None and endpoint.startswith("tls/"):
        closed = os.path.isdir(CERTS) and not os.access(CERTS, os.X_OK)
        given = usual if closed or os.path.isfile(usual) else None
    return credential_for("launcher", endpoint, given)


def credential_file(certs: Path, identity: str) -> Path:
    """Where `babble certs` puts a credential."""
    return certs / "router" / "router.pem" if identity == "router" else certs / f"{identity}.pem"


def _parts(listen: str) -> tuple[str, str, int]:
    try:
        address = parse_address(listen)
    except BusError as error:
        raise BusError(f"--listen: {error}") from None
    return address.protocol, address.host, address.port


def _check_credentials(certs: Path, host: str, identities: Sequence[str]) -> None:
    """Raise `CredentialError` unless all processes of this machine could connect at that host."""
    files = [credential_file(certs, identity) for identity in identities]
    if os.path.isdir(certs) and not os.access(certs, os.X_OK):
        read_credential(files[0])  # says whose folder that is
    missing = [str(path) for path in files if not os.path.exists(path)]
    if len(missing) == len(files):
        raise CredentialError(
            f"there are no certificates in {certs}; make them with `babble certs init --host NAME`, where "
            "NAME is how other hosts reach this one, or say with --certs where they are"
        )
    if missing:
        raise CredentialError(
            f"{certs} is without {', '.join(missing)}, which `babble certs init` made; bring back what was "
            "lost, or make it anew with `babble certs renew`"
        )
    for path in files:
        read_credential(path)
    _check_name(files[0], host)


def _check_name(router: Path, host: str) -> None:
    from services.launcher.authority import names_of

    names = names_of(router.read_bytes())
    if host.lower() not in names:
        raise CredentialError(
            f"the router's credential {router} is for {', '.join(names) or 'nobody'} and not for {host}; "
            f"listen at 0.0.0.0, or name it too with `babble certs renew router --host {host}`"
        )


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _free_port(host: str, port: int, asked: str | None) -> int:
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            # As the router binds: a port that is only waiting out its last connections is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
            return int(probe.getsockname()[1])
    except OSError as error:
        raise BusError(
            f"cannot listen at {asked or host} ({error.strerror}); "
            "choose another address with --listen, or leave it out for a free port"
        ) from None
