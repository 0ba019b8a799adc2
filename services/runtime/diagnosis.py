"""Why a router could not be reached, in one sentence: Zenoh itself says only that time was up.

Knocks at the address once more with plain sockets and Python's own TLS, and reads from what comes
back who refused whom. A sentence names files and hosts; nothing of a key ever gets into one.
"""

import socket
import ssl
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from services.runtime.credentials import Credential
from services.runtime.transport import MAX_SESSIONS, Address, parse_address

KNOCK_SECS = 2.0
"""For each step of a knock."""
ALERT_SECS = 1.0
"""In TLS 1.3 a client thinks that all is well before the router has judged it: so long it listens on."""
NOT_YET_VALID, HAS_EXPIRED, WRONG_PURPOSE, WRONG_NAMES = {9}, {10}, {26}, {62, 64}
"""OpenSSL's verification errors (X509_V_ERR_*) that mean more than "signed by somebody else"."""
MOST_NAMES = 8
QUIET_SECS = 3.0
"""A router that does not let a process in cuts its connections sooner than that."""
CUTS_OF_A_RESTART = 2
"""A router that is started again cuts both connections of a process once."""
SHORT_SECS, SHORT_VISITS = 3.0, 3
AGAIN_SECS = 60.0
"""A process that is turned away again and again says so once in so long."""


@dataclass(frozen=True)
class Finding:
    """What was found at an address."""

    cause: str
    """what is wrong, and after a semicolon what to do"""
    lasting: bool
    """waiting does not help: somebody must change a file or an address first"""


_NO_TLS = Finding(
    "what listens there does not speak TLS; check the address, or let that router listen at a tls/ address",
    lasting=False,
)
_SILENT = Finding(
    f"what listens there says nothing of TLS within {KNOCK_SECS:.0f} s; it is busy or does not encrypt, so "
    "look into the router's log, or check the address",
    lasting=False,
)
_NO_SESSION = Finding(
    f"something listens there, but it is no router, or one that is full ({MAX_SESSIONS} connections) or "
    "overloaded; check the address and the router's log",
    lasting=False,
)


def diagnose(endpoint: str, credential: Credential | None) -> Finding:
    """Why nothing could be had from `endpoint`, found in a few seconds.

    Raises `BusError` if the endpoint is no address.
    """
    address = parse_address(endpoint)
    try:
        return _knock(address) if credential is None else _knock_encrypted(address, credential)
    except socket.gaierror:
        cause = f"the name {address.host} is not known here; check it, or give an IP address"
    except ConnectionRefusedError:
        cause = "nobody listens there; start one with `python -m services.router` or check the address"
    except TimeoutError:
        cause = f"{address.host} does not answer; check the address, and whether a firewall is in between"
    except OSError as error:
        cause = f"{address.host} cannot be reached ({error.strerror or error}); check the network"
    return Finding(cause, lasting=False)


def turned_away(endpoint: str, credential: Credential) -> str:
    """What to say when a router accepts the certificate and cuts the connection all the same."""
    who = f"the router at {endpoint} cuts {credential.identity} off at once"
    if not credential.host:
        return f"{who}, for what it did before; see the router's log"
    return (
        f"{who}: the host {credential.host} is not on its list, or is kept out for what it did, as the "
        "router's log says; wait, or put the host on the list with `babble certs add` (under a new label if "
        f"{credential.host} was revoked)"
    )


def _knock(address: Address) -> Finding:
    """At a tcp/ address. Raises OSError if nobody opens."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    with _connected(address) as connection:
        try:
            context.wrap_socket(connection).close()
        except OSError as error:
            if not _alert(error):
                return _NO_SESSION
    cause = "the router there encrypts; use its tls/ address with a --credential of `babble certs`"
    return Finding(cause, lasting=True)


def _knock_encrypted(address: Address, credential: Credential) -> Finding:
    """At a tls/ address. Raises OSError if nobody opens."""
    try:
        context = _context(credential)
    except OSError:
        return Finding(f"the credential {credential.path} cannot be read any more; put it back", lasting=True)
    with _connected(address) as connection:
        try:
            encrypted = context.wrap_socket(connection, server_hostname=address.host)
        except ssl.SSLCertVerificationError as error:
            return Finding(_our_objection(error.verify_code, address, credential), lasting=True)
        except TimeoutError:
            return _SILENT
        except (ssl.SSLEOFError, ConnectionError):
            return _NO_SESSION
        except OSError as error:
            return _their_objection(error, credential) or _NO_TLS
        with encrypted:
            encrypted.settimeout(ALERT_SECS)
            try:
                encrypted.recv(1)
            except OSError as error:
                return _their_objection(error, credential) or _NO_SESSION
    return _NO_SESSION


def _our_objection(verify_code: int, address: Address, credential: Credential) -> str:
    """Why we do not believe that a router is there."""
    theirs = "the certificate of the router there"
    if verify_code in HAS_EXPIRED:
        return f"{theirs} has expired; renew it with `babble certs renew router` and start the router again"
    if verify_code in NOT_YET_VALID:
        return f"{theirs} is not valid yet by this machine's clock; set the clock right"
    if verify_code in WRONG_PURPOSE:
        return "who answers there shows a certificate, but not a router's; check the address"
    if verify_code in WRONG_NAMES:
        return (
            f"{theirs} is not for {address.host} but for {_names(address, credential)}; connect to one of "
            "those, or say with `babble certs renew router --host` all names that it has"
        )
    return (
        f"{theirs} is of another authority than the credential {credential.path}; check the address, or "
        "use a credential made by the same `babble certs` as the router's"
    )


def _their_objection(error: OSError, credential: Credential) -> Finding | None:
    """Why the router does not believe that we are who we say; None if it did not object."""
    alert = _alert(error)
    if not alert:
        return None
    shown = f"the credential {credential.path} of {credential.identity}"
    if "CERTIFICATE_EXPIRED" in alert:
        cause = (
            f"{shown}, valid until {credential.not_after:%Y-%m-%d}, is not valid by the router's clock; "
            "compare the clocks of both hosts"
        )
    elif "UNKNOWN_CA" in alert or "DECRYPT_ERROR" in alert:
        cause = (
            f"{shown} is of another authority than the router's; use one made by the same `babble certs` as "
            "the router's"
        )
    else:
        what = alert.rpartition("ALERT_")[2].replace("_", " ").lower()
        cause = f"the router refused {shown} ({what}); use one that `babble certs` made for this process"
    return Finding(cause, lasting=True)


def _alert(error: OSError) -> str:
    """OpenSSL's name of what the other side objected to; "" if it did not."""
    reason = (error.reason or "") if isinstance(error, ssl.SSLError) else ""
    return reason if "ALERT" in reason else ""


def _names(address: Address, credential: Credential) -> str:
    """The host names and addresses in the router's certificate, asked once more without minding them."""
    context = _context(credential)
    context.check_hostname = False
    try:
        with _connected(address) as connection, context.wrap_socket(connection) as encrypted:
            shown: dict[str, Any] = dict(encrypted.getpeercert() or {})
    except OSError:
        return "others"
    names = [name for _, name in shown.get("subjectAltName", ())]
    return ", ".join(names[:MOST_NAMES]) or "none"


def _context(credential: Credential) -> ssl.SSLContext:
    """As Zenoh does it: our certificate is shown, our authority alone is believed."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.load_verify_locations(cadata=credential.authority_pem.decode())
    context.load_cert_chain(credential.path)
    return context


def _connected(address: Address) -> socket.socket:
    connection = socket.create_connection((address.host, address.port), KNOCK_SECS)
    connection.settimeout(KNOCK_SECS)
    return connection


def let_in(ask: Callable[[], bool], cuts: Callable[[], int]) -> bool:
    """Whether a router lets this process stay: False if its door is silent, and it cuts connections.

    `ask` at the door; `cuts` so far. A router of another kind has no door and lets connections be.
    """
    before = seen = cuts()
    quiet_since = time.monotonic()
    while not ask():
        if cuts() - before > CUTS_OF_A_RESTART:
            return False
        if cuts() != seen:
            seen, quiet_since = cuts(), time.monotonic()
        if time.monotonic() - quiet_since > QUIET_SECS:
            return True
        time.sleep(0.05)
    return True


class ShortVisits:
    """Notices that a router lets this process connect and cuts it off at once, again and again."""

    def __init__(self) -> None:
        self._came_secs = float("-inf")
        self._in_a_row = 0
        self._told_secs = float("-inf")

    def note(self, up: bool, now_secs: float) -> bool:
        """Take a change of the link; True when SHORT_VISITS in a row were cut short, once in AGAIN_SECS."""
        if up:
            self._came_secs = now_secs
            return False
        self._in_a_row = self._in_a_row + 1 if now_secs - self._came_secs < SHORT_SECS else 0
        if self._in_a_row < SHORT_VISITS or now_secs - self._told_secs < AGAIN_SECS:
            return False
        self._told_secs = now_secs
        return True
