"""Who shows no certificate, or a wrong one, does not get in, and is told why in one sentence."""

import dataclasses
import logging
import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from protocol import keys
from services.launcher.authority import issue, make_authority
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.credentials import Credential
from services.runtime.errors import BusError
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.credentials_stage import CredentialsStage, GuardedRouter, stranger
from tests.processes.owned import Owner, free_port, wait_for

pytestmark = pytest.mark.processes

STATUSES = keys.status("r", "*", "*")
CONNECT_SECS = 0.5
TOLD_SECS = 15.0
"""Of any refusal; a router that is not there is waited for by CONNECT_SECS."""


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> CredentialsStage:
    """One authority for all."""
    return CredentialsStage(tmp_path_factory.mktemp("certs"))


@pytest.fixture(scope="module")
def guarded(stage: CredentialsStage) -> Iterator[GuardedRouter]:
    """A router behind TLS, one for all, that lets in actors of the host "lab"."""
    with Owner() as owner:
        yield stage.router(owner, ["lab"])


@pytest.fixture
def buses() -> Iterator[ExitStack]:
    """Closes at the end what a test connected."""
    with ExitStack() as stack:
        yield stack


def joined(buses: ExitStack, router: GuardedRouter, credential: Credential) -> ZenohBus:
    """Connected with a credential that is good."""
    bus = ZenohBus(router.endpoint, f"{credential.role}-1", Wakeup(), 10.0, credential)
    buses.callback(bus.close)
    return bus


def refusal(endpoint: str, credential: Credential | None, connect_secs: float = CONNECT_SECS) -> str:
    """The one sentence that a process is refused with, in time: where, what, and what to do."""
    began = time.monotonic()
    with pytest.raises(BusError) as refused:
        ZenohBus(endpoint, "actor-lab-1", Wakeup(), connect_secs, credential).close()
    assert time.monotonic() - began < TOLD_SECS
    sentence = str(refused.value)
    assert endpoint in sentence
    assert "\n" not in sentence
    assert re.search(r"; .+", sentence), "it must say what to do"
    return sentence


def of_another_authority(stage: CredentialsStage) -> Credential:
    """Whole in itself, and not of the router's authority."""
    return stage.credential("actor.lab", authority=make_authority())


def forged(stage: CredentialsStage, made: bytes) -> Credential:
    """What reading would refuse: another's key and certificate beside the authority of the router."""
    path = stage.folder / "forged.pem"
    path.write_bytes(made)
    good = stage.credential("actor.lab")
    key, certificate, _ = made.split(b"-----BEGIN CERTIFICATE-----")
    pem = b"-----BEGIN CERTIFICATE-----" + certificate
    return dataclasses.replace(good, path=path, key_pem=key, certificate_pem=pem)


def expired(stage: CredentialsStage) -> Credential:
    past = datetime.now(UTC) - timedelta(days=2)
    return forged(
        stage, issue(stage.authority, "actor.lab", not_before=past, not_after=past + timedelta(days=1))
    )


def test_a_credential_of_another_authority(stage: CredentialsStage, guarded: GuardedRouter) -> None:
    foreign = of_another_authority(stage)
    sentence = refusal(guarded.endpoint, foreign)
    assert f"is of another authority than the credential {foreign.path};" in sentence
    assert "babble certs" in sentence


def test_a_certificate_that_another_authority_signed_beside_the_right_authority(
    stage: CredentialsStage, guarded: GuardedRouter
) -> None:
    own = forged(stage, issue(make_authority(), "actor.lab"))
    sentence = refusal(guarded.endpoint, own)
    assert f"{own.path} of actor.lab is of another authority than the router's;" in sentence


def test_an_expired_certificate(stage: CredentialsStage, guarded: GuardedRouter) -> None:
    sentence = refusal(guarded.endpoint, expired(stage))
    assert "forged.pem of actor.lab, valid until" in sentence
    assert "is not valid by the router's clock; compare the clocks" in sentence


def test_the_routers_own_certificate_is_no_clients(stage: CredentialsStage, guarded: GuardedRouter) -> None:
    sentence = refusal(guarded.endpoint, stage.credential("router"))
    assert "the router refused the credential" in sentence
    assert "unsupported certificate" in sentence


def test_a_name_that_the_routers_certificate_does_not_have(owner: Owner, stage: CredentialsStage) -> None:
    router = stage.router(owner, ["lab"], names=["router.lan", "10.1.2.3"])
    sentence = refusal(router.endpoint, stage.credential("actor.lab"))
    assert "is not for 127.0.0.1 but for router.lan, 10.1.2.3;" in sentence


def test_plain_tcp_at_a_router_that_encrypts(guarded: GuardedRouter) -> None:
    sentence = refusal(guarded.endpoint.replace("tls/", "tcp/"), None)
    assert "the router there encrypts; use its tls/ address with a --credential" in sentence


def test_tls_at_a_router_that_does_not_encrypt(owner: Owner, stage: CredentialsStage) -> None:
    endpoint = owner.router().endpoint.replace("tcp/", "tls/")
    assert "it is busy or does not encrypt" in refusal(endpoint, stage.credential("actor.lab"))


def test_an_actors_credential_does_not_make_a_router(owner: Owner, stage: CredentialsStage) -> None:
    """Who steals an actor's credential cannot play the router to others."""
    endpoint = f"tls/127.0.0.1:{free_port()}"
    stolen = issue(stage.authority, "actor.lab", names=["127.0.0.1"])
    path = stage.folder / "stolen.pem"
    path.write_bytes(stolen)
    impostor = stranger(owner, endpoint, path, "impostor")
    impostor.expect("listening")
    sentence = refusal(endpoint, stage.credential("coordinator"))
    assert "shows a certificate, but not a router's;" in sentence


def test_nobody_there(stage: CredentialsStage) -> None:
    sentence = refusal(f"tls/127.0.0.1:{free_port()}", stage.credential("actor.lab"))
    assert "no router answered" in sentence
    assert "nobody listens there; start one with `python -m services.router`" in sentence


def test_no_such_name(stage: CredentialsStage) -> None:
    sentence = refusal("tls/no-such-host.invalid:7447", stage.credential("actor.lab"))
    assert "the name no-such-host.invalid is not known here;" in sentence


def test_a_host_that_does_not_answer(stage: CredentialsStage, buses: ExitStack) -> None:
    listener = buses.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
    address = listener.getsockname()
    for _ in range(3):
        filling = buses.enter_context(socket.socket())
        filling.setblocking(False)
        filling.connect_ex(address)
    sentence = refusal(f"tls/127.0.0.1:{address[1]}", stage.credential("actor.lab"))
    assert "127.0.0.1 does not answer; check the address, and whether a firewall is in between" in sentence


@pytest.mark.parametrize("protocol", ["tcp", pytest.param("tls", marks=pytest.mark.slow)])
def test_something_else_that_listens(protocol: str, stage: CredentialsStage, buses: ExitStack) -> None:
    listener = buses.enter_context(socket.create_server(("127.0.0.1", 0)))
    endpoint = f"{protocol}/127.0.0.1:{listener.getsockname()[1]}"
    sentence = refusal(endpoint, stage.credential("actor.lab") if protocol == "tls" else None)
    expected = (
        "it is busy or does not encrypt" if protocol == "tls" else "it is no router, or one that is full"
    )
    assert expected in sentence


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        (b"HTTP/1.1 400 Bad Request\r\n\r\n", "what listens there does not speak TLS;"),
        (b"", "it is no router, or one that is full"),
    ],
    ids=["a web server", "one that hangs up"],
)
def test_something_else_that_answers(stage: CredentialsStage, answer: bytes, said: str) -> None:
    """What is seen is said: a wrong answer, or none at all."""
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            with suppress(OSError):
                while True:
                    with listener.accept()[0] as connection:
                        connection.recv(4096)
                        connection.sendall(answer)

        threading.Thread(target=serve, daemon=True).start()
        endpoint = f"tls/127.0.0.1:{listener.getsockname()[1]}"
        assert said in refusal(endpoint, stage.credential("actor.lab"))


def test_who_has_no_certificate_gets_nothing_through(
    owner: Owner, stage: CredentialsStage, guarded: GuardedRouter, buses: ExitStack
) -> None:
    witness, inbox = joined(buses, guarded, stage.credential("coordinator")), Inbox()
    witness.subscribe("status", STATUSES, inbox)
    without = stage.folder / "without.pem"
    without.write_bytes(stage.authority.certificate_pem)
    attackers = [
        stranger(owner, guarded.endpoint, without, "client"),
        stranger(owner, guarded.endpoint.replace("tls/", "tcp/"), None, "client"),
        stranger(owner, guarded.endpoint, of_another_authority(stage).path, "client"),
        stranger(owner, guarded.endpoint, forged(stage, issue(make_authority(), "actor.lab")).path, "client"),
    ]
    for attacker in attackers:
        attacker.expect("refused")
    assert_only_the_honest_are_heard(joined(buses, guarded, stage.credential("actor.lab")), inbox)


def test_a_host_that_is_not_listed_is_told_so_and_gets_nothing_through(
    owner: Owner, stage: CredentialsStage, guarded: GuardedRouter, buses: ExitStack
) -> None:
    witness, inbox = joined(buses, guarded, stage.credential("coordinator")), Inbox()
    witness.subscribe("status", STATUSES, inbox)
    unlisted = stage.credential("actor.other")
    sentence = refusal(guarded.endpoint, unlisted, connect_secs=10.0)
    assert "cuts actor.other off at once: the host other is not on its list" in sentence
    assert "`babble certs add` (under a new label if other was revoked)" in sentence
    attacker = stranger(owner, guarded.endpoint, unlisted.path, "client")
    attacker.expect("said")
    attacker.expect("cut off")
    assert_only_the_honest_are_heard(joined(buses, guarded, stage.credential("actor.lab")), inbox)


def test_a_host_taken_off_the_list_is_cut_off_and_told_in_its_log(
    owner: Owner, tmp_path: Path, buses: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.WARNING)
    stage = CredentialsStage(tmp_path)
    guarded = stage.router(owner, ["lab", "other"])
    witness, inbox = joined(buses, guarded, stage.credential("coordinator")), Inbox()
    honest = joined(buses, guarded, stage.credential("actor.lab"))
    late = joined(buses, guarded, stage.credential("actor.other"))
    witness.subscribe("status", STATUSES, inbox)
    guarded.hosts.write_text("lab\n")

    def told() -> list[str]:
        return [record.getMessage() for record in caplog.records if "cuts actor.other off" in record.message]

    (first, *_) = wait_for("the sentence in the log", told, within_secs=30.0)
    assert "the host other is not on its list" in first
    wait_for("the honest one's return", honest.linked)
    inbox.take_all()
    late.publish("status", keys.status("r", "actor", "actor-other-1"), b"forged")
    assert_only_the_honest_are_heard(honest, inbox)


def test_a_certificate_that_expires_meanwhile_ends_the_connection(
    stage: CredentialsStage, guarded: GuardedRouter, buses: ExitStack
) -> None:
    honest = joined(buses, guarded, stage.credential("coordinator"))
    end = datetime.now(UTC) + timedelta(seconds=5)
    short = joined(buses, guarded, stage.credential("actor.lab", not_after=end))
    wait_for("the end of the short one", lambda: not short.linked(), within_secs=20.0)
    assert datetime.now(UTC) > end - timedelta(seconds=1)
    assert honest.linked()


def test_no_key_gets_into_a_sentence_or_a_log(
    stage: CredentialsStage, guarded: GuardedRouter, buses: ExitStack, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.set_level(logging.DEBUG)
    good, foreign = stage.credential("actor.lab"), of_another_authority(stage)
    joined(buses, guarded, good)
    said = refusal(guarded.endpoint, foreign) + refusal(
        f"tls/127.0.0.1:{free_port()}", good, connect_secs=1.5
    )
    said += caplog.text + repr(good) + guarded.process.report()
    assert "waiting for the router" in said
    for credential in (good, foreign):
        assert not [line for line in credential.key_pem.decode().splitlines() if line in said]


def test_strangers_who_connect_and_say_nothing_do_not_keep_others_out(
    stage: CredentialsStage, guarded: GuardedRouter, buses: ExitStack
) -> None:
    port = int(guarded.endpoint.rpartition(":")[2])
    for _ in range(200):
        buses.enter_context(socket.create_connection(("127.0.0.1", port)))
    bus = ZenohBus(guarded.endpoint, "actor-lab-1", Wakeup(), 20.0, stage.credential("actor.lab"))
    bus.close()


def assert_only_the_honest_are_heard(honest: ZenohBus, inbox: Inbox) -> None:
    """An honest status arrives after whatever was tried, and it is the only one."""
    key = keys.status("r", "actor", "actor-lab-1")

    def heard() -> list[Frame]:
        honest.publish("status", key, b"honest")
        return [arrival for arrival in inbox.take_all() if isinstance(arrival, Frame)]

    assert all(frame == Frame(key, b"honest") for frame in wait_for("the honest status", heard))
