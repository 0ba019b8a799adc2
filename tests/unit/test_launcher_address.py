"""Where `babble up` lets its router listen, and what its processes show there."""

import json
import socket
from pathlib import Path

import pytest

from services.launcher.address import (
    IDENTITIES,
    Address,
    address_of,
    credential_file,
    launcher_credential,
)
from services.launcher.authority import Authority, issue, make_authority
from services.launcher.run_folder import RunFolder
from services.launcher.service import parts_of
from services.runtime.credentials import CredentialError
from services.runtime.errors import BusError
from services.runtime.settings import RunSettings


@pytest.fixture
def authority() -> Authority:
    return make_authority()


@pytest.fixture
def certs(tmp_path: Path, authority: Authority) -> Path:
    """A folder as `babble certs init` makes it, with a router that is called localhost and 127.0.0.1."""
    folder = tmp_path / "certs"
    (folder / "router").mkdir(parents=True)
    for identity in IDENTITIES:
        names = ("localhost", "127.0.0.1") if identity == "router" else ()
        credential_file(folder, identity).write_bytes(issue(authority, identity, names=names))
    return folder


def port_of(address: Address) -> str:
    return address.listen.rpartition(":")[2]


def test_by_default_the_router_listens_to_this_machine_on_a_free_port() -> None:
    address = address_of(None)
    assert address.listen == address.connect
    host, port = address.listen.removeprefix("tcp/").split(":")
    assert host == "127.0.0.1"
    with socket.socket() as probe:
        probe.bind((host, int(port)))


def test_an_address_for_other_hosts_is_reached_by_loopback_here(certs: Path) -> None:
    for listen, more in (("tls/0.0.0.0:0", {"certs": certs}), ("tcp/0.0.0.0:0", {"plain": True})):
        address = address_of(listen, **more)
        protocol, port = listen[:3], port_of(address)
        assert address.listen == f"{protocol}/0.0.0.0:{port}"
        assert address.connect == f"{protocol}/127.0.0.1:{port}"


def test_a_busy_port_is_refused_with_what_to_do() -> None:
    with socket.socket() as holder:
        holder.bind(("127.0.0.1", 0))
        holder.listen()
        port = holder.getsockname()[1]
        with pytest.raises(BusError, match=f"127.0.0.1:{port}.*in use.*--listen"):
            address_of(f"tcp/127.0.0.1:{port}")


@pytest.mark.parametrize(
    "address",
    ["7447", "tcp/127.0.0.1", "tcp/:7447", "udp/127.0.0.1:7447", "tcp/a:70000", "tls/0.0.0.0", "tcp/a:x"],
)
def test_what_is_no_address_is_refused(address: str) -> None:
    with pytest.raises(BusError, match=r"must look like tcp/127\.0\.0\.1:7447"):
        address_of(address)


@pytest.mark.parametrize("host", ["0.0.0.0", "192.0.2.1", "[::]", "lab.example"])
def test_an_open_door_is_refused_unless_somebody_says_that_nobody_comes(host: str) -> None:
    with pytest.raises(
        BusError, match=r"anybody .* could take part .* `babble certs init` .* --plain"
    ) as refused:
        address_of(f"tcp/{host}:7447")
    assert f"--listen tls/{host}:7447" in str(refused.value)


@pytest.mark.parametrize("host", ["127.0.0.1", "127.0.0.5", "localhost"])
def test_loopback_is_no_open_door(host: str) -> None:
    assert address_of(f"tcp/{host}:0").connect.startswith(f"tcp/{host}:")


def test_each_process_shows_its_own_credential(certs: Path, tmp_path: Path) -> None:
    address = address_of("tls/127.0.0.1:0", certs=certs)
    folder = RunFolder(tmp_path / "run", "r")
    told = {part.name: part.arguments for part in parts_of(folder, RunSettings(scenario="s"), address)}
    shown = {
        name: Path(given[given.index("--credential") + 1]).relative_to(certs) for name, given in told.items()
    }
    assert {name: str(path) for name, path in shown.items()} == {
        "router": "router/router.pem",
        "coordinator": "coordinator.pem",
        "encoder_learner": "encoder_learner.pem",
        "policy_learner": "policy_learner.pem",
        "actor-0": "actor.local.pem",
        "actor-1": "actor.local.pem",
    }
    credential = address.credential()
    assert credential is not None
    assert credential.identity == "launcher"


def test_without_encryption_nothing_is_shown(tmp_path: Path) -> None:
    address = address_of("tcp/0.0.0.0:0", plain=True)
    parts = parts_of(RunFolder(tmp_path / "run", "r"), RunSettings(scenario="s"), address)
    assert not any("--credential" in part.arguments for part in parts)
    assert [part.name for part in parts if "--plain" in part.arguments] == ["router"]
    assert address.credential() is None


def test_certificates_for_an_address_without_encryption_are_refused(certs: Path) -> None:
    for listen in (None, "tcp/127.0.0.1:0"):
        with pytest.raises(BusError, match="--certs is of use for a tls/ address only"):
            address_of(listen, certs=certs)


def test_without_certificates_it_says_how_to_make_them(
    certs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path / "certs" / "router")
    with pytest.raises(
        CredentialError, match=r"there are no certificates in certs; .*`babble certs init --host"
    ):
        address_of("tls/0.0.0.0:0")
    (certs / "policy_learner.pem").unlink()
    with pytest.raises(CredentialError, match=r"without .*policy_learner\.pem.*`babble certs init`"):
        address_of("tls/0.0.0.0:0", certs=certs)


def test_an_expired_credential_is_found_before_anything_starts(certs: Path, authority: Authority) -> None:
    (certs / "dashboard.pem").write_bytes(issue(authority, "dashboard", days=-1))
    with pytest.raises(CredentialError, match=r"dashboard.* expired on"):
        address_of("tls/0.0.0.0:0", certs=certs)


def test_a_router_that_is_not_certified_for_its_address_is_found_before_anything_starts(certs: Path) -> None:
    with pytest.raises(CredentialError, match=r"is for localhost, 127\.0\.0\.1 and not for 127\.0\.0\.2"):
        address_of("tls/127.0.0.2:0", certs=certs)


def test_commands_find_the_usual_credential(certs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(certs.parent)
    found = launcher_credential("tls/127.0.0.1:7447", None)
    assert found is not None
    assert found.path == Path("certs/launcher.pem")
    assert launcher_credential("tcp/127.0.0.1:7447", None) is None, "nothing is shown where nobody asks"
    with pytest.raises(CredentialError, match="credential of dashboard, and this process is the launcher"):
        launcher_credential("tls/127.0.0.1:7447", certs / "dashboard.pem")
    monkeypatch.chdir(certs)
    with pytest.raises(CredentialError, match="needs a credential"):
        launcher_credential("tls/127.0.0.1:7447", None)


def test_a_folder_that_cannot_be_one_is_told(tmp_path: Path) -> None:
    with pytest.raises(CredentialError, match="there are no certificates in"):
        address_of("tls/127.0.0.1:0", certs=tmp_path / ("x" * 300))


@pytest.mark.parametrize("name", ["LocalHost", "localhost"])
def test_names_are_the_same_in_any_case(certs: Path, name: str) -> None:
    assert address_of(f"tls/{name}:0", certs=certs).connect.startswith(f"tls/{name}:")


def test_a_folder_of_another_user_is_told(certs: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def closed(path: Path, mode: str) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.chdir(certs.parent)
    monkeypatch.setattr("os.access", lambda path, mode: path != Path("certs"))
    monkeypatch.setattr(Path, "open", closed)
    with pytest.raises(CredentialError, match=r"may not read the credential certs/launcher\.pem"):
        launcher_credential("tls/127.0.0.1:7447", None)
    with pytest.raises(CredentialError, match=r"may not read the credential certs/router/router\.pem"):
        address_of("tls/127.0.0.1:0", certs=Path("certs"))


def test_a_key_is_never_printed(certs: Path) -> None:
    credential = address_of("tls/127.0.0.1:0", certs=certs).credential()
    assert "PRIVATE" not in repr(credential)
    assert "PRIVATE" not in json.dumps(repr(address_of("tls/127.0.0.1:0", certs=certs)))
