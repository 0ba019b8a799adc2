"""`babble certs`: to whom the files belong, and the numbers it takes."""

import os
from pathlib import Path

import pytest

from services.launcher.certs_folder import FIRST_ROLES
from services.launcher.cli import main

CERTS = Path("certs")


class Certs:
    """Runs `babble certs` in a folder of the test's own."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *given: str, code: int = 0) -> str:
        """What it said, on stdout if all went well and else on stderr."""
        assert main(["certs", *given]) == code
        said = self._capsys.readouterr()
        return said.err if code else said.out


@pytest.fixture
def certs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Certs:
    monkeypatch.chdir(tmp_path)
    return Certs(capsys)


class Chowned:
    """Who was given what, by inode, instead of giving it; only root could."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.by_inode: dict[int, tuple[int, int]] = {}
        monkeypatch.setattr(os, "geteuid", lambda: 0)
        monkeypatch.setattr(os, "chown", lambda path, uid, gid: self._give(os.stat(path), uid, gid))
        monkeypatch.setattr(os, "fchown", lambda handle, uid, gid: self._give(os.fstat(handle), uid, gid))

    def _give(self, found: os.stat_result, uid: int, gid: int) -> None:
        self.by_inode[found.st_ino] = (uid, gid)

    def owned(self) -> dict[str, tuple[int, int]]:
        paths = {path.stat().st_ino: path for path in CERTS.rglob("*")}
        given = {inode: owner for inode, owner in self.by_inode.items() if inode in paths}
        return {str(paths[inode].relative_to(CERTS)): owner for inode, owner in given.items()}


def test_root_gives_containers_what_they_read_and_nothing_else(
    certs: Certs, monkeypatch: pytest.MonkeyPatch
) -> None:
    chowned = Chowned(monkeypatch)
    said = certs("init", "--host", "lab", "--owner", "1000:1001")
    assert "All belongs to user" not in said
    expected = {f"{identity}.pem" for identity in (*FIRST_ROLES, "actor.local")}
    expected |= {"router", "router/router.pem", "router/hosts"}
    assert chowned.owned() == dict.fromkeys(expected, (1000, 1001))
    certs("add", "attic", "--owner", "1000")
    assert chowned.owned()["actor.attic.pem"] == chowned.owned()["router/hosts"] == (1000, -1)


def test_later_files_belong_to_whom_the_router_s_belongs(
    certs: Certs, monkeypatch: pytest.MonkeyPatch
) -> None:
    certs("init", "--host", "lab.example")
    chowned = Chowned(monkeypatch)
    router = (CERTS / "router/router.pem").stat()
    certs("add", "attic")
    assert chowned.owned() == dict.fromkeys(
        ["actor.attic.pem", "router/hosts"], (router.st_uid, router.st_gid)
    )


def test_containers_are_thought_of(certs: Certs, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "geteuid", lambda: 1234)
    monkeypatch.setattr(os, "getegid", lambda: 100)
    said = certs("init", "--host", "lab")
    assert "let them run as that user, with BABBLE_UID=1234 and BABBLE_GID=100 in .env" in said
    assert "only root can give files to user 1000" in certs("add", "attic", "--owner", "1000", code=2)
    monkeypatch.setattr(os, "geteuid", lambda: 1000)
    assert "containers" not in certs("init", "--host", "lab", "--dir", "others")
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    assert "make it again with --owner 1000" in certs("init", "--host", "lab", "--dir", "roots")


@pytest.mark.parametrize("given", [["--days", "0"], ["--days", "4000"], ["--days", "x"], ["--owner", "me"]])
def test_numbers_that_are_none_are_refused(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended:
        main(["certs", "init", "--host", "lab", *given])
    assert ended.value.code == 2
    assert f"argument {given[0]}: must be " in capsys.readouterr().err
