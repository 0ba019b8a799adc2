"""The list of hosts: what is one, and when it has changed."""

from pathlib import Path

import pytest

from services.router.hosts import HostsError, WatchedFile, parse_hosts, read_hosts


def test_one_label_a_line_with_comments_and_blank_lines() -> None:
    assert parse_hosts("local\n\n# the lab\nlab_2   # upstairs\nlocal\n") == {"local", "lab_2"}
    assert parse_hosts("") == frozenset()


@pytest.mark.parametrize("line", ["lab-2", "Lab", "a" * 25, "actor.lab", "lab other", "*", "<html>"])
def test_what_is_no_label_is_refused_with_its_line(line: str) -> None:
    with pytest.raises(ValueError, match="line 2"):
        parse_hosts(f"good\n{line}\n")


def test_a_list_that_cannot_be_read_is_one_sentence(tmp_path: Path) -> None:
    path = tmp_path / "hosts"
    with pytest.raises(HostsError, match="cannot read the list of hosts"):
        read_hosts(path)
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(HostsError, match="is no list of hosts"):
        read_hosts(path)
    path.write_text("\n".join(f"h{number}" for number in range(1025)))
    with pytest.raises(HostsError, match="1024 are the most"):
        read_hosts(path)
    path.write_bytes(b"#" * 70_000)
    with pytest.raises(HostsError, match="too large"):
        read_hosts(path)


def test_a_change_is_noticed_once_and_when_the_file_keeps_still(tmp_path: Path) -> None:
    path = tmp_path / "hosts"
    path.write_text("one\n")
    watched = WatchedFile(path)
    assert not watched.changed()
    path.write_text("one\ntw")
    assert not watched.changed()
    path.write_text("one\ntwo\n")
    assert not watched.changed()
    assert watched.changed()
    assert not watched.changed()
    path.unlink()
    assert [watched.changed(), watched.changed(), watched.changed()] == [False, True, False]
    path.write_text("one\ntwo\n")
    assert [watched.changed(), watched.changed(), watched.changed()] == [False, True, False]
