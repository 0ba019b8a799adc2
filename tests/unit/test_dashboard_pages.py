"""What of the web page needs no socket: addresses, the parts of an answer, the cache's place."""

import gzip
import random
from pathlib import Path

import pytest

from services.dashboard import connections, viewer_files
from services.dashboard.answers import Packed, Stored
from services.dashboard.pages import AddressError, stream_origins
from services.dashboard.web_server import WebServer

GRPC_PORT = 9876


@pytest.mark.parametrize("kind", ["in memory", "packed", "in a file"])
def test_answers_go_in_small_parts_for_each_of_which_a_slow_browser_has_time(
    tmp_path: Path, kind: str
) -> None:
    contents = random.Random(1).randbytes(3 * connections.PART_BYTES + 5)
    (tmp_path / "part").write_bytes(contents + b"written since")
    body = {
        "in memory": contents,
        "packed": Packed(gzip.compress(contents), len(contents)),
        "in a file": Stored(tmp_path / "part", len(contents)),
    }[kind]
    parts = list(connections._parts(body))
    assert b"".join(parts) == contents
    assert max(map(len, parts)) <= connections.PART_BYTES


def test_the_stream_lets_the_same_pages_read_it() -> None:
    assert stream_origins("127.0.0.1", []) == []
    assert stream_origins("192.168.1.5", ["http://lab:9090"]) == ["http://192.168.1.5:*", "http://lab:*"]


@pytest.mark.parametrize(
    "origin", ["*", "", "http://", "https://lab:9090", "http://a/b", "lab;x", "a b", "[::1]"]
)
def test_an_origin_that_is_none_is_refused(origin: str) -> None:
    with pytest.raises(AddressError, match="--allow-origin"):
        WebServer("127.0.0.1", 0, GRPC_PORT, "run", "life", [origin])


@pytest.mark.parametrize("bind", ["", "localhost", "::", "::1", "1.2.3", "127.0.0.1:80"])
def test_an_address_that_is_none_is_refused(bind: str) -> None:
    with pytest.raises(AddressError, match="--bind"):
        WebServer(bind, 0, GRPC_PORT, "run", "life", [])


def test_a_relative_cache_home_is_not_used(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    for given, expected in (
        ("here", tmp_path / ".cache"),
        ("", tmp_path / ".cache"),
        ("/there", Path("/there")),
    ):
        monkeypatch.setenv("XDG_CACHE_HOME", given)
        assert viewer_files.cache_folder() == expected / "babble"
