"""`babble certs`, as its user meets it: what it makes, says and refuses, and who may read the files."""

import errno
import fcntl
import os
import re
import stat
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from services.launcher import certs_folder
from services.launcher.authority import issue, load_authority, make_authority, names_of
from services.launcher.certs_folder import FIRST_ROLES
from services.launcher.cli import main
from services.runtime.credentials import Credential, CredentialError, read_credential

CERTS = Path("certs")
SECRET = re.compile("PRIVATE KEY")
Certs = Callable[..., str]


@pytest.fixture(autouse=True)
def at_home(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def certs(capsys: pytest.CaptureFixture[str]) -> Certs:
    """Runs `babble certs`; what it said on stdout, or with `code=2` its sentence."""

    def run(*given: str, code: int = 0) -> str:
        assert main(["certs", *given]) == code
        said = capsys.readouterr()
        assert not SECRET.search(said.out + said.err)
        if code == 0:
            assert said.err == ""
            return said.out
        assert said.out == ""
        assert said.err.count("\n") == 1
        return said.err

    return run


@pytest.fixture
def made(certs: Certs) -> Certs:
    """`certs`, with a folder that is there."""
    certs("init", "--host", "lab.example")
    return certs


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def files() -> dict[str, bytes]:
    return {str(path.relative_to(CERTS)): path.read_bytes() for path in CERTS.rglob("*") if path.is_file()}


def hosts() -> list[str]:
    return (CERTS / "router/hosts").read_text().splitlines()


def put(identity: str, *, days: float) -> None:
    """Lets a credential of the folder expire in so many days."""
    path = CERTS / ("router/router.pem" if identity == "router" else f"{identity}.pem")
    authority = load_authority((CERTS / "ca.pem").read_bytes(), (CERTS / "ca.key").read_bytes())
    names = names_of(path.read_bytes())
    end = datetime.now(UTC) + timedelta(days=days)
    path.write_bytes(issue(authority, identity, names=names, not_after=end))


def test_init_makes_what_each_process_needs(certs: Certs) -> None:
    said = certs("init", "--host", "Lab.Example", "--host", "10.0.0.5", "--host", "localhost", "--days", "90")
    assert "may be addressed as lab.example, 10.0.0.5, localhost, 127.0.0.1, router." in said
    paths = {identity: CERTS / f"{identity}.pem" for identity in (*FIRST_ROLES, "actor.local")}
    paths["router"] = CERTS / "router/router.pem"
    for identity, path in paths.items():
        credential = read_credential(path)
        assert credential.identity == identity
        assert credential.authority_pem == (CERTS / "ca.pem").read_bytes()
        assert 89 <= (credential.not_after - datetime.now(UTC)).days <= 90
        assert str(path.relative_to(CERTS)) in said
    assert set(files()) == {str(path.relative_to(CERTS)) for path in paths.values()} | {
        "ca.key",
        "ca.pem",
        "router/hosts",
    }
    assert hosts() == ["local"]
    assert names_of(paths["coordinator"].read_bytes()) == []


@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_only_the_owner_can_read_a_private_key(certs: Certs, umask: int) -> None:
    before = os.umask(umask)
    try:
        certs("init", "--host", "lab")
        certs("add", "attic")
        certs("renew", "--all")
    finally:
        os.umask(before)
    assert mode(CERTS) == mode(CERTS / "router") == 0o700
    for name, content in files().items():
        assert mode(CERTS / name) == (0o600 if SECRET.search(content.decode()) else 0o644), name


def test_an_authority_is_never_overwritten(made: Certs) -> None:
    before = files()
    assert "holds an authority already, which is never overwritten" in made("init", "--host", "x", code=2)
    assert files() == before


def test_init_takes_an_empty_folder_and_no_other(certs: Certs) -> None:
    CERTS.mkdir(mode=0o755)
    (CERTS / "notes").write_text("mine")
    assert "certs is not empty; give --dir a folder that is new or empty" in certs(
        "init", "--host", "x", code=2
    )
    (CERTS / "notes").unlink()
    certs("init", "--host", "x")
    assert mode(CERTS) == 0o700


@pytest.mark.parametrize("after", [0, 3, 6])
def test_an_interrupted_init_is_told_and_nothing_works_with_half_of_it(
    certs: Certs, monkeypatch: pytest.MonkeyPatch, after: int
) -> None:
    issued = []

    def issue_some(*given: object, **named: object) -> bytes:
        if len(issued) == after:
            raise KeyboardInterrupt
        issued.append(given)
        return b""

    with monkeypatch.context() as patch:
        patch.setattr(certs_folder, "issue", issue_some)
        assert main(["certs", "init", "--host", "x"]) == 130
    for given in (("init", "--host", "x"), ("add", "attic"), ("list",), ("renew", "--all")):
        said = certs(*given, code=2)
        assert "certs is not whole: it lacks router/router.pem and router/hosts; " in said
        assert "delete the folder and start it again" in said


def test_init_says_what_it_needs(certs: Certs) -> None:
    assert "say it with --host NAME_OR_ADDRESS" in certs("init", code=2)
    assert not CERTS.exists()


@pytest.mark.parametrize(
    "host",
    ["tls/lab:7447", "lab:7447", "10.0.0", "300.1.1.1", "a b", "-a", "a..b", "", "*.lab", "é", "a" * 64],
)
def test_a_host_name_that_is_none_is_refused(host: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["certs", "init", f"--host={host}"])
    assert ended.value.code == 2
    assert f"must be a host name or an IP address without a port, got {host!r}" in capsys.readouterr().err
    assert not CERTS.exists()


def test_add_admits_a_host_and_says_what_to_do_there(made: Certs) -> None:
    said = made("add", "attic")
    assert "  babble actor --connect tls/lab.example:7447 --run RUN --credential actor.attic.pem\n" in said
    assert read_credential(CERTS / "actor.attic.pem").host == "attic"
    assert hosts() == ["local", "attic"]
    made("add", "actor.cellar")
    assert hosts() == ["local", "attic", "cellar"]


def test_an_address_of_the_sixth_version_is_bracketed(certs: Certs) -> None:
    certs("init", "--host", "FD00::1")
    assert "--connect tls/[fd00::1]:7447 " in certs("add", "attic")


@pytest.mark.parametrize(
    ("label", "example"),
    [("lab-2", "lab_2"), ("Lab", "lab"), ("a" * 25, "a" * 24), ("../lab", "lab"), ("", "lab"), ("*", "lab")],
)
def test_a_label_that_is_none_is_refused_with_one_that_is(made: Certs, label: str, example: str) -> None:
    before = files()
    said = made("add", label, code=2)
    assert f"{label!r} cannot be the label of a host" in said
    assert said.endswith(f"for example {example}\n")
    assert files() == before


def test_a_host_is_added_once(made: Certs) -> None:
    made("add", "attic")
    before = files()
    assert (
        "attic is a host of certs already; renew its credential with `babble certs renew actor.attic`"
        in made("add", "attic", code=2)
    )
    assert files() == before


def test_a_host_that_is_half_there_is_not_added_anew(made: Certs) -> None:
    made("add", "attic")
    path, held = CERTS / "actor.attic.pem", (CERTS / "actor.attic.pem").read_bytes()
    path.unlink()
    assert "attic is a host of certs already; renew its credential with" in made("add", "attic", code=2)
    path.write_bytes(held)
    (CERTS / "router/hosts").write_text("local\n")
    said = made("add", "attic", code=2)
    assert "certs/actor.attic.pem is there, but attic is not in router/hosts; write the line attic" in said
    assert path.read_bytes() == held


def test_all_leaves_out_a_host_that_is_not_admitted(made: Certs) -> None:
    made("add", "attic")
    (CERTS / "router/hosts").write_text("local\n")
    said = made("renew", "--all")
    assert "actor.local until" in said
    assert "attic" not in said


def test_a_revoked_host_is_out_for_good(made: Certs) -> None:
    made("add", "attic")
    assert "attic is admitted no more by the router that reads certs/router/hosts" in made("revoke", "attic")
    assert hosts() == ["local"]
    assert not (CERTS / "actor.attic.pem").exists()
    assert (
        "its old credential would be admitted again; leave it out, or take another label, for example attic_2"
        in made("add", "attic", code=2)
    )
    assert "there is no 'actor.attic' in certs" in made("renew", "actor.attic", code=2)
    assert "hosts revoked: attic\n" in made("list")
    made("add", "attic_2")
    assert hosts() == ["local", "attic_2"]


def test_only_hosts_that_are_there_can_be_revoked(made: Certs) -> None:
    assert "attic is no host of certs; the hosts there are: local" in made("revoke", "attic", code=2)
    assert "coordinator is a role, and only hosts can be revoked; make a new authority" in made(
        "revoke", "coordinator", code=2
    )


def test_what_the_operator_wrote_into_the_list_of_hosts_stays(made: Certs) -> None:
    (CERTS / "router/hosts").write_text("# the house\nlocal\nattic # under the roof")
    assert "hosts admitted: local, attic\n" in made("list")
    made("add", "cellar")
    made("revoke", "attic")
    assert hosts() == ["# the house", "local", "cellar"]


def test_renewing_gives_a_new_key_to_the_same_identity(made: Certs) -> None:
    before = {name: read_credential(CERTS / name) for name in ("dashboard.pem", "router/router.pem")}
    names = names_of((CERTS / "router/router.pem").read_bytes())
    untouched = (CERTS / "coordinator.pem").read_bytes()
    put("dashboard", days=-3)
    said = made("renew", "dashboard", "router", "--days", "700")
    assert re.search(r"certs/dashboard\.pem: dashboard until 20\d\d-\d\d-\d\d\n", said)
    for name, old in before.items():
        new: Credential = read_credential(CERTS / name)
        assert new.identity == old.identity
        assert new.key_pem != old.key_pem
        assert (new.not_after - datetime.now(UTC)).days in (699, 700)
    assert names_of((CERTS / "router/router.pem").read_bytes()) == names
    assert (CERTS / "coordinator.pem").read_bytes() == untouched


def test_the_router_can_be_given_new_names(made: Certs) -> None:
    made("renew", "router", "--host", "10.0.0.9")
    names = names_of((CERTS / "router/router.pem").read_bytes())
    assert names == ["10.0.0.9", "localhost", "127.0.0.1", "router"]
    assert "babble certs renew router --host NAME" in made("renew", "dashboard", "--host", "a", code=2)


def test_soon_renews_what_expires_soon_and_all_renews_all(made: Certs) -> None:
    assert made("renew", "--soon") == "nothing in certs expires within 30 days\n"
    put("dashboard", days=29)
    put("launcher", days=-1)
    before = files()
    made("renew", "--soon")
    assert {name for name, held in files().items() if held != before[name]} == {
        "dashboard.pem",
        "launcher.pem",
    }
    before = files()
    made("renew", "--all")
    unchanged = {name for name, held in files().items() if held == before[name]}
    assert unchanged == {"ca.key", "ca.pem", "router/hosts"}


def test_a_role_without_a_file_gets_one_by_renewing(made: Certs) -> None:
    (CERTS / "dashboard.pem").unlink()
    assert re.search(r"^dashboard +dashboard\.pem +- +- +not here$", made("list"), re.MULTILINE)
    made("renew", "dashboard", "recorder")
    assert read_credential(CERTS / "dashboard.pem").role == "dashboard"
    assert read_credential(CERTS / "recorder.pem").role == "recorder"


def test_renew_wants_to_know_which(made: Certs) -> None:
    for given in ([], ["--all", "--soon"], ["router", "--all"]):
        assert "say which to renew: identities as `babble certs list` shows them" in made(
            "renew", *given, code=2
        )
    for unknown in ("attic", "actor.attic", "../ca", "actor.a-b"):
        assert f"there is no {unknown!r} in certs; see who there is" in made("renew", unknown, code=2)


def test_list_marks_what_needs_care(made: Certs) -> None:
    for host in ("attic", "cellar", "shed"):
        made("add", host)
    put("launcher", days=12.5)
    put("dashboard", days=-2)
    (CERTS / "coordinator.pem").write_text("nothing")
    (CERTS / "actor.attic.pem").write_bytes(issue(make_authority(), "actor.attic"))
    (CERTS / "actor.cellar.pem").write_bytes((CERTS / "actor.shed.pem").read_bytes())
    (CERTS / "router/hosts").write_text("local\nattic\ncellar\n")
    lines = {line.partition(" ")[0]: line for line in made("list").splitlines()}
    assert re.search(r" 12  soon$", lines["launcher"])
    assert re.search(r" 0  expired$", lines["dashboard"])
    assert "certs/coordinator.pem is no credential" in lines["coordinator"]
    assert lines["actor.attic"].endswith("  signed by another authority")
    assert lines["actor.cellar"].endswith("  is the credential of actor.shed")
    assert lines["actor.shed"].endswith("  not admitted: not in router/hosts")
    assert re.search(r"^authority +ca\.pem +20\d\d-\d\d-\d\d +36\d\d$", lines["authority"])
    assert lines["renew"] == "renew what expires with: babble certs renew --soon"


def test_list_needs_no_key_and_survives_a_damaged_router_file(made: Certs) -> None:
    (CERTS / "ca.key").unlink()
    (CERTS / "router/router.pem").write_text("nothing")
    said = made("list")
    assert "certs/router/router.pem is no credential" in said
    assert "names of the router" not in said
    assert "certs/ca.key is not here, and only it can sign" in made("renew", "launcher", code=2)


def test_a_damaged_router_file_needs_its_names_again(made: Certs) -> None:
    (CERTS / "router/router.pem").write_text("nothing")
    assert "say them again with `babble certs renew router --host NAME`" in made("renew", "router", code=2)
    made("renew", "router", "--host", "lab")
    assert read_credential(CERTS / "router/router.pem").role == "router"


def test_an_expired_authority_is_told(made: Certs) -> None:
    old = make_authority(now=datetime.now(UTC) - timedelta(days=20), days=10)
    (CERTS / "ca.key").write_bytes(old.key_pem)
    (CERTS / "ca.pem").write_bytes(old.certificate_pem)
    before = files()
    assert "the authority in certs expired on 20" in made("add", "attic", code=2)
    assert files() == before
    assert "no credential outlives the authority; make a new one" in made("list")


@pytest.mark.parametrize("damage", ["ca.key", "ca.pem"])
def test_a_damaged_authority_signs_nothing(made: Certs, damage: str) -> None:
    (CERTS / damage).write_text("nothing")
    assert "certs/ca.key is damaged, or is not the key of ca.pem" in made("renew", "launcher", code=2)


def test_the_key_of_another_authority_signs_nothing(made: Certs) -> None:
    (CERTS / "ca.key").write_bytes(make_authority().key_pem)
    assert "certs/ca.key is damaged, or is not the key of ca.pem" in made("renew", "launcher", code=2)


@pytest.mark.parametrize("action", [["list"], ["add", "attic"], ["renew", "--all"], ["revoke", "local"]])
def test_without_an_authority_each_action_says_so(certs: Certs, action: list[str]) -> None:
    assert "there is no authority in elsewhere; say with --dir where it is, or make one with" in certs(
        *action, "--dir", "elsewhere", code=2
    )


def test_a_full_disk_leaves_the_old_file_and_no_draft(made: Certs, monkeypatch: pytest.MonkeyPatch) -> None:
    before = files()

    def refuse(handle: int) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", refuse)
    assert "No space left on device; see to whom it belongs and whether there is room" in made(
        "renew", "launcher", code=2
    )
    assert files() == before


def test_two_at_once_do_not_forget_each_other(made: Certs) -> None:
    with (CERTS / "ca.pem").open("r+b") as other:
        fcntl.flock(other, fcntl.LOCK_EX)
        assert "another `babble certs` is changing certs; try again when it has ended" in made(
            "add", "attic", code=2
        )
    assert hosts() == ["local"]
    made("add", "attic")


def test_a_new_authority_s_files_do_not_mix_with_the_old_one_s(made: Certs) -> None:
    made("init", "--host", "lab", "--dir", "others")
    mixed = Path("others/launcher.pem")
    key_and_certificate = mixed.read_bytes().removesuffix(Path("others/ca.pem").read_bytes())
    mixed.write_bytes(key_and_certificate + (CERTS / "ca.pem").read_bytes())
    with pytest.raises(CredentialError, match="is not signed by the authority in the same file"):
        read_credential(mixed)
