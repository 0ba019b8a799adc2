"""Who a process is where a router asks for it: one PEM file, made by `babble certs`.

A credential holds a private key, its certificate, and the certificate of the run's own authority.
The certificate's common name is the identity: a role, or `actor.<host>`. The package cryptography
takes 0.1 s and 22 MB, so it is imported only where there is a credential to read.
"""

import argparse
import logging
import os
import re
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import TYPE_CHECKING

from services.runtime.errors import UserError

if TYPE_CHECKING:
    from cryptography.x509 import Certificate

log = logging.getLogger(__name__)

CREDENTIAL_VARIABLE = "BABBLE_CREDENTIAL"
"""The environment variable with the path of the credential, for hosts and containers."""
WARN_DAYS = 30
"""A credential that expires within so many days is warned of at each start."""
ACTOR = "actor"
ROUTER = "router"
ROLES = (ROUTER, "coordinator", "encoder_learner", "policy_learner", "dashboard", "launcher", "recorder")
"""The identities of which there is one; the others are `actor.<host>`."""
HOST_PATTERN = "[a-z0-9_]{1,24}"
"""No hyphens, so that the lives `actor-lab-*` are never those of another host."""
LARGEST_FILE_BYTES = 1 << 16

_BLOCK = re.compile(rb"-----BEGIN ([A-Z0-9 ]+)-----\r?\n.*?-----END \1-----(?:\r?\n|\Z)", re.DOTALL)


class CredentialError(UserError):
    """A credential that is missing, cannot be used, or is another process's; the text is one sentence."""


@dataclass(frozen=True)
class Credential:
    """A process's proof of who it is, checked to be whole and valid now."""

    path: Path
    identity: str
    role: str
    host: str
    """The label of an actor's host; "" for the other roles."""
    not_after: datetime
    """When it expires, with its time zone."""
    certificate_pem: bytes
    authority_pem: bytes
    key_pem: bytes = field(repr=False)


def add_credential_option(parser: argparse.ArgumentParser) -> None:
    """The option `--credential FILE`, by default what the environment says; a `Path` or None."""
    given = os.environ.get(CREDENTIAL_VARIABLE)
    parser.add_argument(
        "--credential",
        type=Path,
        default=Path(given) if given else None,
        metavar="FILE",
        help=f"this process's file of `babble certs`, for tls/ addresses (default: ${CREDENTIAL_VARIABLE})",
    )


def role_and_host(identity: str) -> tuple[str, str] | None:
    """The role and the host label ("" if it has none) of an identity; None if it is no identity."""
    if identity in ROLES:
        return identity, ""
    role, _, host = identity.partition(".")
    return (role, host) if role == ACTOR and re.fullmatch(HOST_PATTERN, host) else None


def credential_for(service: str, endpoint: str, path: Path | None) -> Credential | None:
    """What the service shows at the router's address; None where plain TCP needs nothing.

    Warns in the log if it expires soon. Raises `CredentialError` where address, file and service do
    not fit one another.
    """
    encrypted = endpoint.startswith("tls/")
    if path is None:
        if encrypted:
            raise CredentialError(
                f"{endpoint} needs a credential; give --credential FILE (or {CREDENTIAL_VARIABLE}=FILE) with "
                "a file that `babble certs` made"
            )
        return None
    if not encrypted:
        raise CredentialError(
            f"the credential {path} would not be used at {endpoint}, which is not encrypted; use a "
            "tls/ address, or leave the credential out"
        )
    credential = read_credential(path)
    if credential.role != service:
        raise CredentialError(
            f"{path} is the credential of {credential.identity}, and this process is the {service}; give it "
            f"{_usual_file(service)}"
        )
    left = credential.not_after - datetime.now(UTC)
    if left < timedelta(days=WARN_DAYS):
        log.warning(
            "the credential %s expires on %s, in %d days; renew it with `babble certs renew %s`",
            path,
            _day(credential.not_after),
            left.days,
            credential.identity,
        )
    return credential


def read_credential(path: Path, *, now: datetime | None = None) -> Credential:
    """The credential in the file, valid at the time `now` (aware; by default the present).

    Raises `CredentialError` if it is not there, not readable, not whole, or not valid at that time.
    """
    credential = load_credential(path)
    _check_time(credential, now or datetime.now(UTC))
    return credential


def load_credential(path: Path) -> Credential:
    """The credential in the file, whether or not this is its time. Raises `CredentialError`."""
    key_pem, certificate_pem, authority_pem = _parts(path, _read(path))
    certificate, authority = _checked(path, key_pem, certificate_pem, authority_pem)
    identity = _common_name(certificate)
    named = role_and_host(identity)
    if named is None:
        raise CredentialError(
            f"{path} is a certificate of {identity!r}, which is no role of a run; give a file that "
            "`babble certs` made"
        )
    role, host = named
    not_after = min(certificate.not_valid_after_utc, authority.not_valid_after_utc)
    return Credential(path, identity, role, host, not_after, certificate_pem, authority_pem, key_pem)


def _read(path: Path) -> bytes:
    try:
        with path.open("rb") as file:
            held = file.read(LARGEST_FILE_BYTES + 1)
    except FileNotFoundError:
        raise CredentialError(
            f"there is no credential {path}; make it with `babble certs` where ca.key is and copy it here"
        ) from None
    except IsADirectoryError:
        raise CredentialError(
            f"{path} is a folder and not a credential, as Docker makes one where a mounted file is missing; "
            "remove the folder and put the file there"
        ) from None
    except PermissionError:
        raise CredentialError(_unreadable(path)) from None
    except OSError as error:
        raise CredentialError(f"cannot read the credential {path}: {error.strerror}; copy it anew") from None
    if len(held) > LARGEST_FILE_BYTES:
        raise CredentialError(f"{path} is too large for a credential; give a file that `babble certs` made")
    return held


def _unreadable(path: Path) -> str:
    try:
        found = path.stat()
        whose = f", which belongs to user {found.st_uid} with mode {found.st_mode & 0o777:o}"
    except OSError:
        whose = ", or may not enter its folder"
    uid = os.getuid()
    return f"user {uid} may not read the credential {path}{whose}; give it to them with `chown {uid} {path}`"


def _parts(path: Path, held: bytes) -> tuple[bytes, bytes, bytes]:
    """The PEM blocks of key, certificate and authority. Raises `CredentialError`."""
    blocks = [(found[1].decode(), found[0].rstrip() + b"\n") for found in _BLOCK.finditer(held)]
    keys = [block for label, block in blocks if label.endswith("PRIVATE KEY")]
    certificates = [block for label, block in blocks if label == "CERTIFICATE"]
    if len(keys) != 1 or len(certificates) != 2:
        raise CredentialError(
            f"{path} is no credential: it holds {len(keys)} private keys and {len(certificates)} "
            "certificates where 1 and 2 belong; give a file that `babble certs` made, whole"
        )
    return keys[0], certificates[0], certificates[1]


def _checked(
    path: Path, key_pem: bytes, certificate_pem: bytes, authority_pem: bytes
) -> tuple["Certificate", "Certificate"]:
    """Certificate and authority, which fit the key and each other. Raises `CredentialError`."""
    from cryptography import x509
    from cryptography.exceptions import InvalidSignature, UnsupportedAlgorithm
    from cryptography.hazmat.primitives.serialization import load_pem_private_key

    again = "copy it anew, or make it anew with `babble certs renew`"
    try:
        key = load_pem_private_key(key_pem, password=None)
        certificate = x509.load_pem_x509_certificate(certificate_pem)
        authority = x509.load_pem_x509_certificate(authority_pem)
        fits = key.public_key() == certificate.public_key()
    except (ValueError, TypeError, UnsupportedAlgorithm, x509.InvalidVersion):
        raise CredentialError(
            f"{path} is damaged: its key or a certificate cannot be read; {again}"
        ) from None
    if not fits:
        raise CredentialError(f"the private key in {path} is not that of its certificate; {again}")
    try:
        certificate.verify_directly_issued_by(authority)
    except (ValueError, TypeError, InvalidSignature, UnsupportedAlgorithm):
        raise CredentialError(
            f"the certificate in {path} is not signed by the authority in the same file; {again}"
        ) from None
    return certificate, authority


def _common_name(certificate: "Certificate") -> str:
    from cryptography.x509.oid import NameOID

    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if len(names) == 1 else ""


def _check_time(credential: Credential, now: datetime) -> None:
    from cryptography.x509 import load_pem_x509_certificate

    what = f"the credential {credential.path} of {credential.identity}"
    start = load_pem_x509_certificate(credential.certificate_pem).not_valid_before_utc
    if now < start:
        raise CredentialError(
            f"{what} is valid from {start:%Y-%m-%d %H:%M} UTC on, and this machine's clock says "
            f"{now.astimezone(UTC):%Y-%m-%d %H:%M} UTC; set the clock right"
        )
    if now >= credential.not_after:
        raise CredentialError(
            f"{what} expired on {_day(credential.not_after)}; renew it with "
            f"`babble certs renew {credential.identity}` where ca.key is, and copy it here"
        )


def _usual_file(service: str) -> str:
    return {ACTOR: "actor.HOST.pem", ROUTER: "router/router.pem"}.get(service, f"{service}.pem")


def _day(moment: datetime) -> str:
    return f"{moment.astimezone(UTC):%Y-%m-%d}"
