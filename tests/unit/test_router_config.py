"""What a router is told: bounded numbers, and no open door on a network without being told so."""

from pathlib import Path

import pytest

from services.router.config import Limits, RouterConfig, check_address, parse
from services.runtime.errors import UserError
from services.runtime.transport import MAX_SESSIONS


@pytest.fixture(autouse=True)
def _no_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("LISTEN", "CREDENTIAL", "PLAIN", "UNTIL_DONE", "MOST_LIVES", "MOST_MB_PER_SEC"):
        monkeypatch.delenv(f"BABBLE_{name}", raising=False)


def test_by_default_it_listens_to_this_machine_only() -> None:
    config = parse([])
    assert config == RouterConfig(listen="tcp/127.0.0.1:7447", limits=Limits())
    check_address(config)


def test_the_list_of_hosts_is_beside_the_credential_unless_said_otherwise() -> None:
    assert parse(["--credential", "certs/router/router.pem"]).hosts == Path("certs/router/hosts")
    assert parse(["--credential", "a/router.pem", "--hosts", "b/list"]).hosts == Path("b/list")
    assert parse([]).hosts is None


def test_limits_come_from_options_and_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("BABBLE_MOST_LIVES", "12")
    monkeypatch.setenv("BABBLE_MOST_MB_PER_SEC", "7.5")
    limits = parse(["--most-messages-per-sec", "300", "--most-lives", "14"]).limits
    assert limits == Limits(mb_per_sec=7.5, messages_per_sec=300, garbage=20, lives=14)


def test_one_client_never_may_take_all_connections() -> None:
    assert Limits(lives=12).connections == 24
    assert Limits(lives=10_000).connections < MAX_SESSIONS


@pytest.mark.parametrize(
    ("option", "text"),
    [
        ("--most-lives", "0"),
        ("--most-lives", "2.5"),
        ("--most-mb-per-sec", "nan"),
        ("--most-mb-per-sec", "-1"),
        ("--most-garbage", "many"),
        ("--most-messages-per-sec", "inf"),
    ],
)
def test_a_number_out_of_bounds_is_refused_with_the_option(
    capsys: pytest.CaptureFixture[str], option: str, text: str
) -> None:
    with pytest.raises(SystemExit) as end:
        parse([option, text])
    assert end.value.code == 2
    said = capsys.readouterr().err.splitlines()[-1]
    assert option in said
    assert repr(text) in said


@pytest.mark.parametrize(("text", "flag"), [("1", True), ("true", True), ("0", False), ("", False)])
def test_flags_can_be_set_by_the_environment(monkeypatch: pytest.MonkeyPatch, text: str, flag: bool) -> None:
    monkeypatch.setenv("BABBLE_PLAIN", text)
    monkeypatch.setenv("BABBLE_UNTIL_DONE", text)
    config = parse([])
    assert (config.plain, config.until_done) == (flag, flag)


@pytest.mark.parametrize(
    "listen", ["tcp/0.0.0.0:7447", "tcp/[::]:7447", "tcp/router:7447", "tcp/192.168.1.5:7447"]
)
def test_plain_tcp_for_others_must_be_asked_for(listen: str) -> None:
    with pytest.raises(UserError, match=r"without a certificate.*--credential.*--plain"):
        check_address(RouterConfig(listen=listen))
    check_address(RouterConfig(listen=listen, plain=True))


@pytest.mark.parametrize("listen", ["tcp/127.0.0.1:1", "tcp/[::1]:1", "tcp/localhost:1", "tls/0.0.0.0:7447"])
def test_this_machine_and_tls_need_no_word(listen: str) -> None:
    check_address(RouterConfig(listen=listen))


@pytest.mark.parametrize(
    "listen", ["ws/127.0.0.1:7447", "udp/0.0.0.0:7447", "tls/0.0.0.0:7447#enable_mtls=false"]
)
def test_there_is_no_way_around_the_door_by_another_protocol(listen: str) -> None:
    with pytest.raises(UserError, match="cannot listen at"):
        check_address(RouterConfig(listen=listen))
