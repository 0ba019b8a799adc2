"""The served page in a real Chromium: a live stream, its end and return, and a replay; loopback only."""

import gzip
import io
import json
import signal
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from services.dashboard.viewer_files import viewer_files
from services.dashboard.web_server import WebServer
from tests.processes.chromium import PROGRAM, Chromium
from tests.processes.owned import Owner, free_port, wait_for

pytestmark = [
    pytest.mark.processes,
    pytest.mark.timeout(240),
    pytest.mark.skipif(PROGRAM is None, reason="no Chromium here: apt-get install chromium"),
]
ORANGE = (255, 180, 0)
PAINTED_PX = 50
PICTURE_SECS = 90.0
"""Software rendering on a busy machine; about 5 s on an idle one."""
PAGE_SECS = 60.0
"""For what needs no picture: a question every two seconds, on a busy machine."""
VIEWERS_OWN_CALLS = {"tel.rerun.io", "api.github.com", "app.rerun.io"}
"""Hosts that the viewer tries to reach by itself: telemetry, the newest version, and example data."""

DRAW = """
import itertools, sys, time
import numpy as np, rerun as rr, rerun.blueprint as rrb
where = sys.argv[1]
stream = rr.RecordingStream("babble", recording_id="cuboid-1")
sink = (
    rr.FileSink(where, write_footer=True) if where.endswith(".rrd")
    else rr.GrpcServerSink(bind_ip="127.0.0.1", port=int(where), server_memory_limit="32MiB")
)
view = rrb.Spatial2DView(origin="/latent", name="latent")
stream.set_sinks(sink, default_blueprint=rrb.Blueprint(view, collapse_panels=True))
rows = range(100) if where.endswith(".rrd") else itertools.count()
for row in rows:
    stream.set_time("run_time", duration=row * 0.1)
    stream.log("/latent/now", rr.Points2D(np.random.rand(60, 2), colors=[(255, 180, 0)], radii=0.02))
    if where.endswith(".rrd"):
        stream.flush(timeout_sec=10.0)
        continue
    if row == 0:
        print("streaming", flush=True)
    time.sleep(0.1)
stream.disconnect()
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A cache of these tests' own, with the viewer's files out of the installed program."""
    folder = tmp_path_factory.mktemp("cache") / "babble"
    viewer_files(threading.Event(), folder)
    return folder


@pytest.fixture
def serve(cache: Path) -> Iterator[Callable[..., WebServer]]:
    """Starts web servers of the run cuboid-1; closed at the end."""
    started: list[WebServer] = []

    def start(port: int, grpc_port: int, life: str) -> WebServer:
        server = WebServer("127.0.0.1", port, grpc_port, "cuboid-1", life, [], cache=cache)
        server.start()
        started.append(server)
        return server

    yield start
    for server in started:
        server.close()


@pytest.fixture
def browser() -> Iterator[Chromium]:
    """A page in a new browser."""
    with Chromium() as chromium:
        yield chromium


def pixels(browser: Chromium) -> NDArray[np.int16]:
    """(H, W, 3) what the page shows."""
    return np.asarray(Image.open(io.BytesIO(browser.screenshot())).convert("RGB"), dtype=np.int16)


def painted(browser: Chromium) -> bool:
    """True once the points are in the picture."""
    return bool((np.abs(pixels(browser) - ORANGE).sum(axis=2) < 40).sum() > PAINTED_PX)


def text(browser: Chromium, name: str) -> str:
    return str(browser.evaluate(f"document.getElementById('{name}').innerText") or "")


def told(server: WebServer) -> dict[str, object]:
    """What the server tells its page, asked as a browser does."""
    with socket.create_connection(("127.0.0.1", int(server.url.rpartition(":")[2])), timeout=10) as talk:
        talk.sendall(b"GET /run HTTP/1.1\r\nHost: localhost\r\n\r\n")
        answer = b""
        while part := talk.recv(65_536):
            answer += part
    return dict(json.loads(answer.partition(b"\r\n\r\n")[2]))


def assert_nothing_left_the_machine(browser: Chromium) -> None:
    hosts = {urlsplit(url).hostname for url in browser.requests if url.startswith(("http", "ws"))}
    assert hosts <= {"127.0.0.1", "localhost"}
    stopped = {urlsplit(url).hostname for url in browser.blocked} | {
        host for line in browser.said if "Content Security Policy" in line for host in _hosts(line)
    }
    assert stopped <= VIEWERS_OWN_CALLS
    assert not browser.exceptions


def _hosts(line: str) -> set[str]:
    return {part.split("/")[2] for part in line.split("'") if part.startswith(("http://", "https://"))}


@pytest.mark.slow
def test_the_page_shows_the_stream_and_asks_nobody_else(
    owner: Owner, browser: Chromium, serve: Callable[..., WebServer]
) -> None:
    grpc_port = free_port()
    owner.start_code("stream", DRAW, str(grpc_port)).expect("streaming", 60)
    browser.open(serve(0, grpc_port, "dashboard-1").url.replace("127.0.0.1", "localhost"))
    browser.wait_for("the points of the stream", lambda: painted(browser), PICTURE_SECS)
    assert any("/ReadMessages" in url for url in browser.requests)
    assert browser.evaluate("document.title") == "Babble - cuboid-1"
    assert browser.evaluate("document.getElementById('note').hidden") is True
    assert_nothing_left_the_machine(browser)
    before = pixels(browser)
    browser.wait_for("newer points", lambda: np.any(pixels(browser) != before), PICTURE_SECS)


def test_the_page_says_what_is_missing_and_loads_anew_for_another_life(
    browser: Chromium, serve: Callable[..., WebServer]
) -> None:
    first = serve(0, free_port(), "dashboard-1")
    port = int(first.url.rpartition(":")[2])
    browser.open(first.url)
    browser.wait_for("the missing stream", lambda: "cannot be reached" in text(browser, "message"), PAGE_SECS)
    assert browser.loads == 1
    first.close()
    browser.wait_for("the note", lambda: "The dashboard has gone" in text(browser, "note-text"), PAGE_SECS)
    browser.evaluate("document.getElementById('note-close').click()")
    assert text(browser, "note-text") == ""
    serve(port, free_port(), "dashboard-2")
    browser.wait_for("the reload", lambda: browser.loads == 2, PAGE_SECS)
    browser.wait_for(
        "the stream's absence", lambda: "cannot be reached" in text(browser, "message"), PAGE_SECS
    )
    assert text(browser, "note-text") == ""


def test_the_page_loads_anew_when_another_life_took_over_at_once(
    browser: Chromium, serve: Callable[..., WebServer]
) -> None:
    first = serve(0, free_port(), "dashboard-1")
    browser.open(first.url)
    browser.wait_for("the missing stream", lambda: "cannot be reached" in text(browser, "message"), PAGE_SECS)
    first.close()
    serve(int(first.url.rpartition(":")[2]), free_port(), "dashboard-2")
    browser.wait_for("the reload", lambda: browser.loads == 2, PAGE_SECS)


@pytest.mark.slow
def test_a_recording_that_was_cut_off_is_replayed_until_a_signal(
    owner: Owner, browser: Chromium, cache: Path, tmp_path: Path
) -> None:
    (tmp_path / "run.json").write_text(json.dumps({"run": "cuboid-1"}))
    part = tmp_path / "recording" / "run-001.rrd"
    part.parent.mkdir()
    assert owner.start_code("record", DRAW, str(part)).ended(60) == 0
    contents = part.read_bytes()[: part.stat().st_size * 2 // 3 - 1]
    part.write_bytes(contents)
    replay = owner.start(
        "view",
        *("-m", "services.dashboard.replay", "--run-dir", str(tmp_path), "--port", str(free_port())),
        "--no-browser",
        environment={"XDG_CACHE_HOME": str(cache.parent)},
    )
    replay.expect("was cut off", PAGE_SECS)
    browser.open(replay.expect("recording of cuboid-1").split()[-4])
    browser.wait_for("the points of the recording", lambda: painted(browser), PICTURE_SECS)
    assert_nothing_left_the_machine(browser)
    assert not any("/ReadMessages" in url for url in browser.requests)
    assert part.read_bytes() == contents
    replay.interrupt(signal.SIGINT)
    assert replay.ended() == 0
    assert replay.err == []


def test_the_viewers_files_come_out_of_the_installed_program_and_nothing_stays(
    cache: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    made = viewer_files(threading.Event(), tmp_path / "another")
    assert made.digest == viewer_files(threading.Event(), cache).digest
    program = made.files["re_viewer_bg.wasm"]
    assert program.raw_bytes > 2 * len(program.gzipped)
    assert gzip.decompress(program.gzipped).startswith(b"\0asm")
    assert [path.name for path in tmp_path.iterdir()] == ["another"]


def test_a_server_that_is_killed_leaves_no_program_behind(owner: Owner, tmp_path: Path) -> None:
    code = """
import sys, threading, time
from pathlib import Path
from services.dashboard import viewer_files

def dawdle(port, name, cancelled):
    print("serving at", port, flush=True)
    time.sleep(60)

viewer_files._fetch = dawdle
viewer_files.viewer_files(threading.Event(), Path(sys.argv[1]))
"""
    process = owner.start_code("dashboard", code, str(tmp_path))
    port = int(process.expect("serving at", PAGE_SECS).split()[-1])
    process.kill()

    def refused() -> bool:
        try:
            socket.create_connection(("127.0.0.1", port), timeout=5).close()
        except ConnectionRefusedError:
            return True
        return False

    wait_for("the end of rerun's program", refused, PAGE_SECS)
