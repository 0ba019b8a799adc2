"""The web server of the dashboard, over real sockets: what it serves, to whom, and what it refuses."""

import gzip
import http.client
import json
import shutil
import socket
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from services.dashboard import connections, viewer_files, web_server
from services.dashboard.pages import AddressError
from services.dashboard.viewer_files import NAMES, ViewerFilesError
from services.dashboard.web_server import WebServer

FILES = {name: name.encode() * 1000 for name in NAMES}
GRPC_PORT = 9876
Serve = Callable[..., WebServer]


@pytest.fixture
def fetches(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Instead of rerun's program: small files; counts how often they are fetched."""
    counted: list[int] = []

    def fetch_all(cancelled: threading.Event) -> dict[str, tuple[bytes, int]]:
        counted.append(len(counted))
        return {name: (gzip.compress(contents, mtime=0), len(contents)) for name, contents in FILES.items()}

    monkeypatch.setattr(viewer_files, "_fetch_all", fetch_all)
    monkeypatch.setattr(viewer_files.metadata, "version", lambda package: "0.0.1")
    return counted


@pytest.fixture
def serve(fetches: list[int], tmp_path: Path) -> Iterator[Serve]:
    """Starts servers on free ports, and waits until their files are ready or cannot be."""
    started: list[WebServer] = []

    def start(**given: object) -> WebServer:
        settings = {"bind": "127.0.0.1", "port": 0, "grpc_port": GRPC_PORT, "run": "cuboid-1", "life": "d-1"}
        server = WebServer(**{**settings, "cache": tmp_path / "cache", **given})  # type: ignore[arg-type]
        started.append(server)
        server.start()
        wait_until(lambda: server.ready or bool(server.error))
        return server

    yield start
    for server in started:
        server.close()


def wait_until(look: Callable[[], bool], within_secs: float = 10.0) -> None:
    deadline_secs = time.monotonic() + within_secs
    while not look():
        assert time.monotonic() < deadline_secs, "waited in vain"
        time.sleep(0.005)


def port_of(server: WebServer) -> int:
    return int(server.url.rpartition(":")[2])


def ask(
    server: WebServer, path: str, method: str = "GET", **headers: str
) -> tuple[http.client.HTTPResponse, bytes]:
    """The answer and its body; header names with _ for -."""
    connection = http.client.HTTPConnection("127.0.0.1", port_of(server), timeout=10)
    try:
        named = {name.replace("_", "-"): value for name, value in headers.items()}
        connection.request(method, path, headers=named)
        answer = connection.getresponse()
        return answer, answer.read()
    finally:
        connection.close()


def say(server: WebServer, request: bytes) -> bytes:
    """Everything that comes back on a connection after these bytes."""
    with socket.create_connection(("127.0.0.1", port_of(server)), timeout=10) as talk:
        talk.sendall(request)
        answer = b""
        while part := talk.recv(65_536):
            answer += part
        return answer


def told(server: WebServer, **headers: str) -> dict[str, object]:
    return dict(json.loads(ask(server, "/run", **headers)[1]))


def test_the_page_may_talk_to_nobody_but_us_and_the_stream(serve: Serve) -> None:
    answer, body = ask(serve(), "/")
    assert answer.status == 200
    policy = dict(part.strip().split(" ", 1) for part in answer.headers["Content-Security-Policy"].split(";"))
    assert policy["default-src"] == "'none'"
    assert policy["connect-src"] == f"'self' data: blob: http://127.0.0.1:{GRPC_PORT}"
    assert policy["script-src"] == "'self' 'wasm-unsafe-eval'"
    assert "http" not in "".join(source for name, source in policy.items() if name != "connect-src")
    assert answer.headers["X-Content-Type-Options"] == "nosniff"
    assert answer.headers["Referrer-Policy"] == "no-referrer"
    assert b"http://" not in body
    assert b"https://" not in body
    assert b"<title>Babble - cuboid-1</title>" in body


def test_the_pages_name_of_the_run_is_text(serve: Serve) -> None:
    assert b"<title>Babble - &lt;b&gt;</title>" in ask(serve(run="<b>"), "/")[1]


def test_the_page_is_told_which_stream_to_open_and_which_life_it_sees(serve: Serve) -> None:
    words = told(serve(life="dashboard-7"))
    assert words["life"] == "dashboard-7"
    assert words["sources"] == [f"rerun+http://127.0.0.1:{GRPC_PORT}/proxy"]
    assert words["error"] == ""


@pytest.mark.parametrize("name", NAMES)
def test_the_viewers_files_come_gzipped_to_those_who_take_it(serve: Serve, name: str) -> None:
    server = serve()
    path = f"{told(server)['viewer']}{name}"
    packed, body = ask(server, path, Accept_Encoding="br, gzip")
    assert packed.headers["Content-Encoding"] == "gzip"
    assert int(packed.headers["Content-Length"]) == len(body) < len(FILES[name])
    assert gzip.decompress(body) == FILES[name]
    assert "immutable" in packed.headers["Cache-Control"]
    for refusal in ("identity", "gzip;q=0", ""):
        plain, body = ask(server, path, Accept_Encoding=refusal)
        assert plain.headers["Content-Encoding"] is None
        assert body == FILES[name]
        assert plain.headers["ETag"] != packed.headers["ETag"]
        assert plain.headers["Vary"] == "Accept-Encoding"


def test_only_what_is_named_by_its_contents_is_kept_without_asking_again(serve: Serve) -> None:
    """Another version may be served at the same port tomorrow."""
    server = serve()
    for path in ("/", "/page.js", "/page.css", "/favicon.ico"):
        assert ask(server, path)[0].headers["Cache-Control"] == "no-cache", path
    for name in NAMES[1:]:
        assert ask(server, f"/{name}")[0].status == 404


def test_what_a_browser_has_is_not_sent_again(serve: Serve) -> None:
    server = serve()
    for path in ("/", "/page.js", f"{told(server)['viewer']}re_viewer.js"):
        tag = ask(server, path)[0].headers["ETag"]
        again, body = ask(server, path, If_None_Match=f'"other", W/{tag}')
        assert (again.status, body) == (304, b"")
        assert ask(server, path, If_None_Match='"other"')[0].status == 200


def test_the_state_of_the_run_is_never_kept(serve: Serve) -> None:
    answer, _ = ask(serve(), "/run")
    assert answer.headers["Cache-Control"] == "no-store"
    assert answer.headers["ETag"] is None


def test_head_answers_like_get_without_a_body(serve: Serve) -> None:
    server = serve()
    for path in ("/", "/favicon.ico", "/run"):
        get, body = ask(server, path)
        head, nothing = ask(server, path, "HEAD")
        assert (head.status, nothing) == (200, b"")
        assert int(head.headers["Content-Length"]) == len(body)
        assert head.headers["Content-Type"] == get.headers["Content-Type"]


@pytest.mark.parametrize("host", ["evil.example", "127.0.0.1.evil.example:9090", "", "local host", "[::1]:1"])
def test_a_page_under_a_strangers_name_gets_nothing(serve: Serve, host: str) -> None:
    answer, body = ask(serve(), "/run", Host=host)
    assert answer.status == 421
    assert b"--allow-origin" in body
    assert b"life" not in body


def test_a_request_without_a_host_gets_nothing(serve: Serve) -> None:
    assert say(serve(), b"GET /run HTTP/1.0\r\n\r\n").startswith(b"HTTP/1.1 421 ")


def test_other_names_are_served_when_they_are_allowed(serve: Serve) -> None:
    server = serve(allow_origin=["http://Lab:9090", "other.example"])
    for host, stream in (("lab:9090", "lab"), ("OTHER.example", "other.example"), ("localhost", "127.0.0.1")):
        answer, body = ask(server, "/run", Host=host)
        assert answer.status == 200
        assert json.loads(body)["sources"] == [f"rerun+http://{stream}:{GRPC_PORT}/proxy"]
        assert f"http://{stream}:{GRPC_PORT};" in answer.headers["Content-Security-Policy"]


@pytest.mark.parametrize(
    "path",
    [
        "/../pages.py",
        "/page/index.html",
        "/%2e%2e/pages.py",
        "//etc/passwd",
        "/viewer/../../etc/passwd",
        "/viewer/0/re_viewer.js",
        "/recording/../run.json",
        "/recording/run-002.rrd",
        "/page.js/",
        "/page.js%00",
        "http://127.0.0.1/page.js",
        "/" + "a" * 8000,
    ],
)
def test_nothing_but_what_is_in_the_table_can_be_had(serve: Serve, tmp_path: Path, path: str) -> None:
    part = tmp_path / "recording" / "run-001.rrd"
    part.parent.mkdir()
    part.write_bytes(b"")
    (tmp_path / "run.json").write_text("{}")
    request = f"GET {path} HTTP/1.1\r\nHost: localhost\r\n\r\n".encode()
    assert say(serve(recordings=[part]), request).startswith(b"HTTP/1.1 404 ")


@pytest.mark.parametrize("method", ["POST", "PUT", "DELETE", "OPTIONS", "BREW"])
def test_there_is_only_something_to_read(serve: Serve, method: str) -> None:
    answer, _ = ask(serve(), "/run", method)
    assert answer.status == 405
    assert answer.headers["Allow"] == "GET, HEAD"


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"nonsense\r\n\r\n", b" 400 "),
        (b"GET /run HTTP/9.9\r\nHost: localhost\r\n\r\n", b" 505 "),
        (b"GET /run HTTP/1.1\r\n" + b"a: b\r\n" * 200 + b"\r\n", b" 431 "),
        (b"GET /" + b"a" * 40_000 + b" HTTP/1.1\r\n\r\n", b" 431 "),
        (b"\x16\x03\x01\x02\x00\x01\x00\r\n\r\n", b" 400 "),
    ],
)
def test_bad_requests_are_answered_and_the_next_one_is_served(
    serve: Serve, request_bytes: bytes, status: bytes
) -> None:
    server = serve()
    assert status in say(server, request_bytes).partition(b"\r\n")[0]
    assert ask(server, "/run")[0].status == 200


def test_a_request_that_dawdles_is_given_up(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connections, "REQUEST_SECS", 0.2)
    server = serve()
    with socket.create_connection(("127.0.0.1", port_of(server)), timeout=10) as slow:
        slow.sendall(b"GET /run HTTP/1.1\r\n")
        assert slow.recv(100) == b""


def test_too_many_connections_are_turned_away_and_counted(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MOST_CONNECTIONS", 2)
    server = serve()
    idle = [socket.create_connection(("127.0.0.1", port_of(server)), timeout=10) for _ in range(2)]
    try:
        assert say(server, b"").startswith(b"HTTP/1.1 503 ")
        assert server.refused == 1
    finally:
        for held in idle:
            held.close()
    wait_until(
        lambda: say(server, b"GET /run HTTP/1.1\r\nHost: localhost\r\n\r\n").startswith(b"HTTP/1.1 200 ")
    )


def test_a_machine_without_a_thread_to_spare_serves_again_later(
    serve: Serve, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connections, "MOST_CONNECTIONS", 1)
    server = serve()
    with monkeypatch.context() as patch:

        def refuse(thread: threading.Thread) -> None:
            raise RuntimeError("can't start new thread")

        patch.setattr(threading.Thread, "start", refuse)
        assert say(server, b"") == b""
    wait_until(
        lambda: say(server, b"GET /run HTTP/1.1\r\nHost: localhost\r\n\r\n").startswith(b"HTTP/1.1 200")
    )


def test_a_port_in_use_is_named_with_its_option(serve: Serve) -> None:
    port = port_of(serve())
    with pytest.raises(AddressError, match=rf"127\.0\.0\.1:{port}, is in use; .*--web-port"):
        serve(port=port)


@pytest.mark.parametrize("port", [70_000, -1])
def test_a_port_that_is_none_is_refused_in_a_sentence(serve: Serve, port: int) -> None:
    with pytest.raises(AddressError, match="--web-port"):
        serve(port=port)


def test_close_frees_the_port(serve: Serve) -> None:
    server = serve()
    server.close()
    assert serve(port=port_of(server)).url == server.url


def test_the_page_says_why_there_is_no_viewer(serve: Serve, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(cancelled: threading.Event, cache: Path | None) -> None:
        raise ViewerFilesError("rerun-sdk is not installed here")

    monkeypatch.setattr(web_server, "viewer_files", refuse)
    server = serve()
    assert server.error == "rerun-sdk is not installed here"
    assert told(server)["error"] == server.error
    assert told(server)["viewer"] == ""
    assert ask(server, "/")[0].status == 200


def test_the_page_is_there_before_the_viewers_files(
    fetches: list[int], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    go_on, fetch_all = threading.Event(), viewer_files._fetch_all

    def wait(cancelled: threading.Event) -> dict[str, tuple[bytes, int]]:
        assert go_on.wait(10)
        return fetch_all(cancelled)

    monkeypatch.setattr(viewer_files, "_fetch_all", wait)
    server = WebServer("127.0.0.1", 0, GRPC_PORT, "run", "life", [], cache=tmp_path)
    server.start()
    try:
        assert ask(server, "/")[0].status == 200
        assert told(server)["viewer"] == ""
        go_on.set()
        wait_until(lambda: told(server)["viewer"] != "")
    finally:
        go_on.set()
        server.close()


def test_the_files_are_fetched_once_per_version(serve: Serve, fetches: list[int]) -> None:
    serve().close()
    serve().close()
    assert len(fetches) == 1


@pytest.mark.parametrize("name", ["manifest.json", *(f"{name}.gz" for name in NAMES)])
@pytest.mark.parametrize("harm", ["cut", "changed", "deleted"])
def test_a_damaged_cache_is_made_anew(
    serve: Serve, fetches: list[int], tmp_path: Path, name: str, harm: str
) -> None:
    serve().close()
    path = tmp_path / "cache" / "viewer-0.0.1" / name
    contents = path.read_bytes()
    if harm == "deleted":
        path.unlink()
    else:
        path.write_bytes(contents[:-5] if harm == "cut" else b"\0" + contents[1:])
    server = serve()
    assert len(fetches) == 2
    assert path.read_bytes() == contents
    assert ask(server, "/favicon.ico")[1] == FILES["favicon.ico"]


def test_a_cache_that_cannot_be_written_is_done_without(
    serve: Serve, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    blocked, temporary = tmp_path / "a file", tmp_path / "temporary"
    blocked.write_text("in the way")
    temporary.mkdir()
    monkeypatch.setattr(viewer_files.tempfile, "tempdir", str(temporary))
    server = serve(cache=blocked)
    for name in NAMES:
        assert ask(server, f"{told(server)['viewer']}{name}")[1] == FILES[name]
    assert not [*temporary.iterdir()]


def test_the_cache_may_be_deleted_while_it_is_served(serve: Serve, tmp_path: Path) -> None:
    server = serve()
    shutil.rmtree(tmp_path / "cache")
    for name in NAMES:
        assert ask(server, f"{told(server)['viewer']}{name}")[1] == FILES[name]
