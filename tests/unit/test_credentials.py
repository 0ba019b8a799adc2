"""Credentials: what one is, what each wrong one is told, and what certificates of ours are good for."""

import logging
import os
import re
import ssl
import subprocess
import sys
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from cryptography import x509
from cryptography.hazmat.primitives.serialization import Encoding, load_pem_private_key

from services.launcher.authority import Authority, issue, make_authority
from services.runtime.credentials import (
    ROLES,
    CredentialError,
    credential_for,
    read_credential,
    role_and_host,
)

AUTHORITY = make_authority()
NOW = datetime.now(UTC)
LAB = issue(AUTHORITY, "actor.lab")
ROUTER = issue(AUTHORITY, "router", names=["lab.example", "127.0.0.1"])


def parts(credential_pem: bytes) -> tuple[bytes, bytes, bytes]:
    """Key, certificate, authority."""
    key, *certificates = credential_pem.split(b"-----BEGIN CERTIFICATE-----")
    certificate, authority = (b"-----BEGIN CERTIFICATE-----" + each for each in certificates)
    return key, certificate, authority


def written(folder: Path, content: bytes, name: str = "actor.lab.pem") -> Path:
    path = folder / name
    path.write_bytes(content)
    return path


def secret_lines(key_pem: bytes) -> list[str]:
    return [line for line in key_pem.decode().splitlines() if not line.startswith("-----")]


def assert_one_sentence(text: str) -> None:
    assert "\n" not in text
    assert not text.endswith(".")


@pytest.mark.parametrize(
    ("identity", "role", "host"),
    [("actor.lab", "actor", "lab"), ("actor.a_1", "actor", "a_1"), *((role, role, "") for role in ROLES)],
)
def test_a_credential_tells_who_one_is(tmp_path: Path, identity: str, role: str, host: str) -> None:
    end = (NOW + timedelta(days=3)).replace(microsecond=0)
    held = issue(AUTHORITY, identity, not_after=end)
    credential = read_credential(written(tmp_path, held))
    assert (credential.identity, credential.role, credential.host) == (identity, role, host)
    assert credential.not_after == end
    assert credential.key_pem + credential.certificate_pem + credential.authority_pem == held


def test_windows_line_ends_and_words_around_the_blocks_do_no_harm(tmp_path: Path) -> None:
    changed = b"# the lab\r\n" + LAB.replace(b"\n", b"\r\n") + b"\r\nthat was all\r\n"
    assert read_credential(written(tmp_path, changed)).identity == "actor.lab"


@pytest.mark.parametrize(
    "identity",
    ["actor", "actor.", "actor.a-b", "actor.Lab", "actor.a.b", "actor.*", "admin", "", "router.lab"],
)
def test_an_identity_that_is_none_is_refused(tmp_path: Path, identity: str) -> None:
    assert role_and_host(identity) is None
    if identity:
        with pytest.raises(CredentialError, match="which is no role of a run; give a file"):
            read_credential(written(tmp_path, issue(AUTHORITY, identity)))


def test_labels_are_at_most_24_long_and_whole_lines_are_looked_at() -> None:
    assert role_and_host("actor." + "a" * 24) is not None
    assert role_and_host("actor." + "a" * 25) is None
    assert role_and_host("actor.lab\n") is None


def spoilt_key(held: bytes) -> bytes:
    return held.replace(held.splitlines()[1], b"A" * 64)


OTHERS = issue(make_authority(), "actor.lab")
DAMAGES: dict[str, tuple[Callable[[bytes], bytes], str]] = {
    "empty": (lambda held: b"", "holds 0 private keys and 0 certificates where 1 and 2 belong"),
    "no key": (lambda held: b"".join(parts(held)[1:]), "holds 0 private keys and 2 certificates"),
    "cut off": (lambda held: held[: len(held) // 2], "is no credential"),
    "two": (lambda held: held + held, "holds 2 private keys and 4 certificates"),
    "large": (lambda held: held + b"#" * 70_000, "is too large for a credential"),
    "spoilt key": (spoilt_key, "is damaged: its key or a certificate cannot be read"),
    "locked key": (lambda held: held.replace(b" PRIVATE", b" ENCRYPTED PRIVATE"), "is damaged"),
    "another's key": (
        lambda held: parts(OTHERS)[0] + b"".join(parts(held)[1:]),
        "the private key in .* is not that of its certificate",
    ),
    "another's authority": (
        lambda held: b"".join(parts(held)[:2]) + parts(OTHERS)[2],
        "is not signed by the authority in the same file",
    ),
    "binary": (lambda held: bytes(range(256)), "is no credential"),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_what_is_not_whole_is_told_in_one_sentence_without_secrets(tmp_path: Path, damage: str) -> None:
    change, sentence = DAMAGES[damage]
    path = written(tmp_path, change(LAB))
    with pytest.raises(CredentialError, match=sentence) as refused:
        read_credential(path)
    said = str(refused.value)
    assert_one_sentence(said)
    assert str(path) in said
    assert not any(line in said for line in secret_lines(parts(LAB)[0]))


@pytest.mark.filterwarnings("ignore:Parsed a serial number")
def test_whatever_byte_is_spoilt_it_is_one_sentence_at_most(tmp_path: Path) -> None:
    key, *certificates = parts(LAB)
    for number, pem in enumerate(certificates):
        der = x509.load_pem_x509_certificate(pem).public_bytes(Encoding.DER)
        for at in range(0, len(der), 2):
            spoilt = der[:at] + bytes([der[at] ^ 0x35]) + der[at + 1 :]
            blocks = [*certificates]
            blocks[number] = ssl.DER_cert_to_PEM_cert(spoilt).encode()
            try:
                read_credential(written(tmp_path, b"".join([key, *blocks])))
            except CredentialError as error:
                assert_one_sentence(str(error))


def test_a_missing_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(CredentialError, match=r"there is no credential .*nothing\.pem; make it with `babble"):
        read_credential(tmp_path / "nothing.pem")


def test_a_folder_where_docker_missed_a_file_is_told(tmp_path: Path) -> None:
    with pytest.raises(CredentialError, match="is a folder and not a credential, as Docker makes one"):
        read_credential(tmp_path)


def test_a_file_of_another_user_is_told_with_both_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = written(tmp_path, LAB)
    path.chmod(0o600)
    owner = path.stat().st_uid

    def refuse(*given: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(os, "getuid", lambda: 1234)
    expected = (
        rf"user 1234 may not read .* belongs to user {owner} with mode 600; .*`chown 1234 .*actor.lab.pem`"
    )
    with pytest.raises(CredentialError, match=expected):
        read_credential(path)


def test_a_file_beneath_a_file_is_told(tmp_path: Path) -> None:
    path = written(tmp_path, LAB) / "actor.lab.pem"
    with pytest.raises(CredentialError, match=r"cannot read the credential .*: Not a directory"):
        read_credential(path)


def test_an_expired_one_says_when_and_how_to_renew_it(tmp_path: Path) -> None:
    held = issue(AUTHORITY, "actor.lab", not_after=datetime(2026, 3, 4, 12, tzinfo=UTC))
    path = written(tmp_path, held)
    with pytest.raises(
        CredentialError, match=r"of actor\.lab expired on 2026-03-04; renew .*renew actor\.lab`"
    ):
        read_credential(path, now=datetime(2026, 3, 4, 12, tzinfo=UTC))
    assert read_credential(path, now=datetime(2026, 3, 4, 11, 59, tzinfo=UTC)).host == "lab"


def test_one_of_the_future_speaks_of_the_clock(tmp_path: Path) -> None:
    path = written(tmp_path, LAB)
    with pytest.raises(
        CredentialError, match=r"this machine's clock says 2001-02-03 04:05 UTC; set the clock"
    ):
        read_credential(path, now=datetime(2001, 2, 3, 4, 5, tzinfo=UTC))


def test_a_clock_that_is_half_a_day_slow_is_no_hindrance(tmp_path: Path) -> None:
    assert read_credential(written(tmp_path, LAB), now=NOW - timedelta(hours=12)).role == "actor"


def test_nothing_outlives_its_authority(tmp_path: Path) -> None:
    old = make_authority(days=10)
    credential = read_credential(written(tmp_path, issue(old, "launcher", days=365)))
    assert credential.not_after == old.certificate.not_valid_after_utc
    # Routers and other programs look at the certificate alone.
    certificate = x509.load_pem_x509_certificate(credential.certificate_pem)
    assert certificate.not_valid_after_utc == old.certificate.not_valid_after_utc


def test_only_the_authority_signs_and_only_directly() -> None:
    held = {"authority": AUTHORITY.certificate, "actor": x509.load_pem_x509_certificate(parts(LAB)[1])}
    found = {
        name: each.extensions.get_extension_for_class(x509.BasicConstraints) for name, each in held.items()
    }
    assert (found["authority"].value.ca, found["authority"].value.path_length) == (True, 0)
    assert not found["actor"].value.ca
    assert all(each.critical for each in found.values())


def test_an_encrypted_address_needs_a_credential_and_a_plain_one_refuses_it(tmp_path: Path) -> None:
    assert credential_for("actor", "tcp/127.0.0.1:7447", None) is None
    with pytest.raises(CredentialError, match=r"tls/lab:7447 needs a credential; give --credential FILE"):
        credential_for("actor", "tls/lab:7447", None)
    path = written(tmp_path, LAB)
    with pytest.raises(CredentialError, match=r"would not be used at tcp/lab:7447, which is not encrypted"):
        credential_for("actor", "tcp/lab:7447", path)
    credential = credential_for("actor", "tls/lab:7447", path)
    assert credential is not None
    assert credential.identity == "actor.lab"


@pytest.mark.parametrize(
    ("service", "file"),
    [
        ("coordinator", "coordinator.pem"),
        ("router", "router/router.pem"),
        ("encoder_learner", "encoder_learner"),
    ],
)
def test_another_process_s_credential_is_refused(tmp_path: Path, service: str, file: str) -> None:
    expected = rf"is the credential of actor\.lab, and this process is the {service}; give it {file}"
    with pytest.raises(CredentialError, match=expected):
        credential_for(service, "tls/lab:7447", written(tmp_path, LAB))


@pytest.mark.parametrize(("days", "warned"), [(10.5, True), (29.5, True), (31, False)])
def test_one_that_expires_soon_is_warned_of(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, days: float, warned: bool
) -> None:
    path = written(
        tmp_path, issue(AUTHORITY, "dashboard", not_after=datetime.now(UTC) + timedelta(days=days))
    )
    with caplog.at_level(logging.INFO):
        credential_for("dashboard", "tls/lab:7447", path)
    assert [record.levelname for record in caplog.records] == ["WARNING"] * warned
    if warned:
        assert f"in {int(days)} days; renew it with `babble certs renew dashboard`" in caplog.text


def test_keys_are_in_no_repr_and_no_log(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = written(tmp_path, issue(AUTHORITY, "dashboard", days=5))
    with caplog.at_level(logging.DEBUG):
        credential = credential_for("dashboard", "tls/lab:7447", path)
    assert credential is not None
    shown = f"{credential} {credential!r} {AUTHORITY} {AUTHORITY!r} {caplog.text}"
    assert "certificate" in shown
    assert "PRIVATE" not in shown
    assert "PrivateKey" not in shown
    for key in (credential.key_pem, AUTHORITY.key_pem):
        assert not any(line in shown for line in secret_lines(key))


def test_a_process_without_a_credential_does_not_pay_for_cryptography() -> None:
    program = (
        "import sys; from services.runtime.credentials import credential_for; "
        "credential_for('actor', 'tcp/127.0.0.1:7447', None); sys.exit('cryptography' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", program], timeout=60, check=False).returncode == 0


# What follows asks OpenSSL, by real handshakes in memory, as a second opinion on the certificates.


def handshake(folder: Path, server: bytes, client: bytes, name: str = "127.0.0.1") -> str:
    """The identity that the server proved to itself. Raises ssl.SSLError where one refuses the other."""
    contexts = []
    for purpose, held in ((ssl.PROTOCOL_TLS_SERVER, server), (ssl.PROTOCOL_TLS_CLIENT, client)):
        context = ssl.SSLContext(purpose)
        context.verify_mode = ssl.CERT_REQUIRED
        context.load_verify_locations(cadata=AUTHORITY.certificate_pem.decode())
        context.load_cert_chain(written(folder, held, "shown.pem"))
        contexts.append(context)
    up, down = ssl.MemoryBIO(), ssl.MemoryBIO()
    ends = [
        contexts[1].wrap_bio(down, up, server_hostname=name),
        contexts[0].wrap_bio(up, down, server_side=True),
    ]
    waiting = [0, 1]
    for _ in range(10):
        for index in list(waiting):
            try:
                ends[index].do_handshake()
                waiting.remove(index)
            except ssl.SSLWantReadError:
                pass
    assert not waiting
    shown = ends[1].getpeercert()
    assert shown is not None
    return dict(pair for group in shown["subject"] for pair in group)["commonName"]  # type: ignore[union-attr, misc]


@pytest.mark.parametrize("name", ["127.0.0.1", "lab.example"])
def test_router_and_actor_take_each_other(tmp_path: Path, name: str) -> None:
    assert handshake(tmp_path, ROUTER, LAB, name) == "actor.lab"


def forged() -> bytes:
    """A coordinator's credential, signed with the key of an actor's."""
    key, certificate, authority = parts(LAB)
    signer = Authority(x509.load_pem_x509_certificate(certificate), load_pem_private_key(key, None))  # type: ignore[arg-type]
    return issue(signer, "coordinator") + authority


REFUSALS = {
    "another authority's actor": (
        ROUTER,
        OTHERS,
        "127.0.0.1",
        "self-signed certificate in certificate chain",
    ),
    "another authority's router": (
        issue(make_authority(), "router", names=["127.0.0.1"]),
        LAB,
        "127.0.0.1",
        "self-signed certificate in certificate chain",
    ),
    "an expired actor": (
        ROUTER,
        issue(AUTHORITY, "actor.lab", not_after=NOW - timedelta(minutes=1)),
        "127.0.0.1",
        "expired",
    ),
    "an actor signed by an actor": (ROUTER, forged(), "127.0.0.1", "invalid CA certificate"),
    "a router of another name": (ROUTER, LAB, "elsewhere.example", "Hostname mismatch"),
    "an actor that plays the router": (
        issue(AUTHORITY, "actor.lab", names=["127.0.0.1"]),
        LAB,
        "127.0.0.1",
        "unsuitable certificate purpose|unsupported certificate purpose",
    ),
    "the router as a client": (ROUTER, ROUTER, "127.0.0.1", "(unsuitable|unsupported) certificate purpose"),
}


@pytest.mark.parametrize("case", REFUSALS)
def test_what_the_certificates_are_not_good_for(tmp_path: Path, case: str) -> None:
    server, client, name, reason = REFUSALS[case]
    with pytest.raises(ssl.SSLError, match=re.compile(reason, re.IGNORECASE)):
        handshake(tmp_path, server, client, name)
