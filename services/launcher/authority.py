"""The run's own small certificate authority: keys and certificates as values, no files.

ECDSA P-256 throughout. The authority signs identities directly (path length 0). Only the router's
certificate is good for a server, and only the others' for a client, so no actor can play the router.
"""

import ipaddress
import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta

from cryptography import x509
from cryptography.exceptions import UnsupportedAlgorithm
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import (
    Encoding,
    NoEncryption,
    PrivateFormat,
    load_pem_private_key,
)
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from services.runtime.credentials import ROUTER

AUTHORITY_DAYS = 3650
CREDENTIAL_DAYS = 365
SKEW = timedelta(days=1)
"""Certificates begin so long before they are made: clocks and time zones of other hosts may be wrong."""


@dataclass(frozen=True)
class Authority:
    """What signs credentials; whoever has its key can be anybody."""

    certificate: x509.Certificate
    key: ec.EllipticCurvePrivateKey = field(repr=False)

    @property
    def certificate_pem(self) -> bytes:
        """What everybody may know."""
        return self.certificate.public_bytes(Encoding.PEM)

    @property
    def key_pem(self) -> bytes:
        """What nobody else may know."""
        return _key_pem(self.key)


def make_authority(*, now: datetime | None = None, days: int = AUTHORITY_DAYS) -> Authority:
    """A new authority, of a name of its own, valid for `days` from `now` (aware) on."""
    start = now or datetime.now(UTC)
    key = ec.generate_private_key(ec.SECP256R1())
    name = _name(f"babble authority {secrets.token_hex(4)}")
    built = (
        _builder(name, name, key.public_key(), start - SKEW, start + timedelta(days=days))
        .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
        .add_extension(_key_usage(signs_certificates=True), critical=True)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
    )
    return Authority(built.sign(key, hashes.SHA256()), key)


def load_authority(certificate_pem: bytes, key_pem: bytes) -> Authority:
    """The authority of the two PEM texts. Raises ValueError if they are damaged or do not fit."""
    try:
        certificate = x509.load_pem_x509_certificate(certificate_pem)
        key = load_pem_private_key(key_pem, password=None)
        fits = key.public_key() == certificate.public_key()
    except (TypeError, UnsupportedAlgorithm, x509.InvalidVersion) as error:
        raise ValueError(str(error)) from None
    if not isinstance(key, ec.EllipticCurvePrivateKey) or not fits:
        raise ValueError("the key is not that of the certificate")
    return Authority(certificate, key)


def issue(
    authority: Authority,
    identity: str,
    *,
    names: Sequence[str] = (),
    days: int = CREDENTIAL_DAYS,
    not_before: datetime | None = None,
    not_after: datetime | None = None,
) -> bytes:
    """The file of a new credential: key, certificate, authority, as PEM.

    `names`: the router's host names and IP addresses. `not_before` and `not_after` (aware) stand for
    the usual times, `days` from now; it never outlives the authority. Any `identity` is signed.
    """
    now = datetime.now(UTC)
    end = min(not_after or now + timedelta(days=days), authority.certificate.not_valid_after_utc)
    start = not_before or min(now, end) - SKEW
    key = ec.generate_private_key(ec.SECP256R1())
    usage = ExtendedKeyUsageOID.SERVER_AUTH if identity == ROUTER else ExtendedKeyUsageOID.CLIENT_AUTH
    signer = authority.key.public_key()
    built = (
        _builder(_name(identity), authority.certificate.subject, key.public_key(), start, end)
        .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
        .add_extension(_key_usage(signs_certificates=False), critical=True)
        .add_extension(x509.ExtendedKeyUsage([usage]), critical=False)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False)
        .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(signer), critical=False)
    )
    if names:
        alternatives = x509.SubjectAlternativeName([_general_name(name) for name in names])
        built = built.add_extension(alternatives, critical=False)
    certificate = built.sign(authority.key, hashes.SHA256())
    return _key_pem(key) + certificate.public_bytes(Encoding.PEM) + authority.certificate_pem


def names_of(credential_pem: bytes) -> list[str]:
    """The host names and IP addresses that a credential is good for, in the order they were given.

    Raises ValueError if it holds no certificate.
    """
    certificate = x509.load_pem_x509_certificates(credential_pem)[0]
    try:
        extension = certificate.extensions.get_extension_for_class(x509.SubjectAlternativeName)
    except x509.ExtensionNotFound:
        return []
    return [str(name.value) for name in extension.value]


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    public_key: ec.EllipticCurvePublicKey,
    start: datetime,
    end: datetime,
) -> x509.CertificateBuilder:
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(public_key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start)
        .not_valid_after(end)
    )


def _key_usage(*, signs_certificates: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs_certificates,
        key_cert_sign=signs_certificates,
        crl_sign=signs_certificates,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _name(common_name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])


def _general_name(name: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(name))
    except ValueError:
        return x509.DNSName(name)


def _key_pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption())
