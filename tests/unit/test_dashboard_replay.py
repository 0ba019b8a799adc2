"""Recordings that a crash cut off, and what `babble view` makes of a run's folder."""

import argparse
import http.client
import json
import os
import signal
import struct
import threading
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
import rerun as rr
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from services.dashboard import replay, salvage, viewer_files
from services.dashboard.pages import AddressError
from services.dashboard.salvage import STREAM_HEADER_BYTES, RecordingError, measure
from services.dashboard.web_server import WebServer
from services.runtime.errors import UserError

HEADER = b"RRF2" + bytes(8)
FOOTER = bytes(20) + b"RRF2FOOT\x01\0\0\0"
ROWS = 60


def message(kind: int, payload: bytes) -> bytes:
    return struct.pack("<QQ", kind, len(payload)) + payload


SHORT = [HEADER, message(1, b"store"), message(2, b"a chunk"), message(2, b""), message(3, b"x" * 40)]
END = message(0, b"index") + FOOTER


def borders(pieces: list[bytes]) -> list[int]:
    """Where a whole piece ends, in bytes from the start."""
    return [len(b"".join(pieces[: count + 1])) for count in range(len(pieces))]


def written(path: Path, contents: bytes) -> Path:
    path.write_bytes(contents)
    return path


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of rerun's own making: ROWS rows of one value, in several messages."""
    path = tmp_path_factory.mktemp("recording") / "run-001.rrd"
    stream = rr.RecordingStream("babble", recording_id="cuboid-1")
    stream.set_sinks(rr.FileSink(path, write_footer=True))
    for row in range(ROWS):
        stream.set_time("run_time", duration=float(row))
        stream.log("/value", rr.Scalars(float(row)))
        if row % 10 == 9:
            stream.flush(timeout_sec=10.0)
    stream.disconnect()
    return path


def rows_of(path: Path) -> int:
    """Rows of the value that rerun itself reads."""
    with warnings.catch_warnings():
        # It warns of every recording without an end.
        warnings.simplefilter("ignore", RerunWarning)
        chunks = RrdReader(path).stream().to_chunks()
    return sum(chunk.num_rows for chunk in chunks if str(chunk.entity_path) == "/value")


def test_a_finished_recording_is_whole(recording: Path) -> None:
    whole = measure(recording)
    assert whole.cut_bytes == 0
    assert whole.whole_bytes == recording.stat().st_size
    assert whole.messages > 3


@pytest.mark.parametrize("end", [b"", END, message(0, b""), END + HEADER + message(2, b"of another stream")])
def test_wherever_it_is_cut_the_whole_messages_remain(tmp_path: Path, end: bytes) -> None:
    contents = b"".join(SHORT) + end
    ends = [*borders(SHORT), len(contents)]
    if end.endswith(b"of another stream"):
        ends += [len(b"".join(SHORT) + END), len(b"".join(SHORT) + END + HEADER)]
    for length in range(len(contents) + 1):
        whole = measure(written(tmp_path / "cut.rrd", contents[:length]))
        assert whole.whole_bytes == max((border for border in ends if border <= length), default=0)
        assert whole.file_bytes == length


def test_what_a_disk_left_as_zeros_is_not_the_end_of_a_recording(tmp_path: Path) -> None:
    for zeros in (17, 4096, 100_000):
        whole = measure(written(tmp_path / "zeros.rrd", b"".join(SHORT) + bytes(zeros)))
        assert whole.whole_bytes == len(b"".join(SHORT))


@pytest.mark.parametrize(
    "tail",
    [struct.pack("<QQ", 2, 2**63), struct.pack("<QQ", 4, 1) + b"x", b"\xff" * 64, message(0, b"index")],
)
def test_what_is_no_message_is_cut(tmp_path: Path, tail: bytes) -> None:
    whole = measure(written(tmp_path / "bad.rrd", b"".join(SHORT) + tail))
    assert whole.cut_bytes == len(tail)
    assert whole.messages == len(SHORT) - 1


@pytest.mark.parametrize(
    "contents", [b"", b"RRF", b"RRF2", b"RRF1" + bytes(100), bytes(4096), b"\x89PNG" * 9]
)
def test_nothing_is_whole_of_what_is_no_recording(tmp_path: Path, contents: bytes) -> None:
    whole = measure(written(tmp_path / "none.rrd", contents))
    assert (whole.whole_bytes, whole.messages) == (0, 0)


def test_an_end_that_is_written_while_it_is_measured_does_not_count_yet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    contents = b"".join(SHORT) + END
    path = written(tmp_path / "growing.rrd", contents)
    measured = os.stat_result([*path.stat()[:6], len(contents) - 1, *path.stat()[7:]])
    monkeypatch.setattr(salvage.os, "fstat", lambda handle: measured)
    assert measure(path).whole_bytes == len(b"".join(SHORT))


def test_a_recording_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"gone\.rrd: No such file"):
        measure(tmp_path / "gone.rrd")


def test_rerun_reads_every_row_of_the_whole_messages(recording: Path, tmp_path: Path) -> None:
    contents, rows, refused = recording.read_bytes(), [], 0
    for length in range(STREAM_HEADER_BYTES + 200, len(contents), len(contents) // 40):
        cut = written(tmp_path / "cut.rrd", contents[:length])
        whole = measure(cut)
        rows.append(rows_of(written(tmp_path / "whole.rrd", contents[: whole.whole_bytes])))
        try:
            rows_of(cut)
        except RuntimeError:
            refused += 1
    assert refused > 10
    assert rows == sorted(rows)
    assert len(set(rows)) >= ROWS // 10
    assert rows[-1] == rows_of(recording) == ROWS


@pytest.fixture
def run_dir(tmp_path: Path, recording: Path) -> Path:
    """A run with one whole part, one cut part and one that has just been begun."""
    (tmp_path / "run.json").write_text(json.dumps({"run": "cuboid-1"}))
    parts = tmp_path / "recording"
    parts.mkdir()
    contents = recording.read_bytes()
    (parts / "run-001.rrd").write_bytes(contents)
    (parts / "run-002.rrd").write_bytes(contents[: len(contents) * 2 // 3])
    (parts / "run-1000.rrd").write_bytes(b"")
    (parts / "notes.rrd").write_bytes(b"")
    return tmp_path


def arguments_of(run_dir: Path, **given: object) -> argparse.Namespace:
    settings = {"bind": "127.0.0.1", "port": None, "allow_origin": [], "browser": False, "native": False}
    return argparse.Namespace(run_dir=run_dir, **{**settings, **given})


@pytest.fixture
def _no_program(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """The viewer's files without rerun's program."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(
        viewer_files, "_fetch_all", lambda cancelled: {name: (b"", 0) for name in viewer_files.NAMES}
    )


@pytest.fixture
def served(
    run_dir: Path, _no_program: None, monkeypatch: pytest.MonkeyPatch
) -> Iterator[tuple[WebServer, dict[str, object]]]:
    """A replay that serves, and what its page is told."""
    started: list[WebServer] = []
    serving, start = threading.Event(), WebServer.start

    def remember(server: WebServer) -> None:
        start(server)
        started.append(server)
        serving.set()

    monkeypatch.setattr(WebServer, "start", remember)
    stopped = threading.Event()
    playing = threading.Thread(target=replay.replay, args=(arguments_of(run_dir), stopped))
    playing.start()
    try:
        assert serving.wait(10)
        yield started[0], json.loads(fetch(started[0], "/run"))
    finally:
        stopped.set()
        playing.join(10)
    assert not playing.is_alive()


def fetch(server: WebServer, path: str) -> bytes:
    connection = http.client.HTTPConnection("127.0.0.1", int(server.url.rpartition(":")[2]), timeout=10)
    try:
        connection.request("GET", path)
        answer = connection.getresponse()
        assert answer.status == 200
        return answer.read()
    finally:
        connection.close()


def test_the_parts_are_served_in_order_and_only_as_far_as_they_are_whole(
    served: tuple[WebServer, dict[str, object]], run_dir: Path
) -> None:
    server, told = served
    assert told["sources"] == ["/recording/run-001.rrd", "/recording/run-002.rrd"]
    assert told["probe"] == ""
    for name in ("run-001.rrd", "run-002.rrd"):
        path = run_dir / "recording" / name
        before = path.read_bytes()
        assert fetch(server, f"/recording/{name}") == before[: measure(path).whole_bytes]
        assert path.read_bytes() == before


def test_what_was_cut_off_is_said_in_one_sentence(run_dir: Path) -> None:
    parts = replay.recordings(run_dir)
    (sentence,) = replay.damage(parts)
    cut = measure(run_dir / "recording" / "run-002.rrd")
    assert "run-002.rrd was cut off" in sentence
    assert f"{cut.cut_bytes:,} of {cut.file_bytes:,} bytes" in sentence
    assert "2 parts" in replay.summary("cuboid-1", parts, "http://127.0.0.1:9090")


def test_parts_are_in_the_order_of_their_numbers(run_dir: Path) -> None:
    (run_dir / "recording" / "run-999.rrd").write_bytes(b"")
    names = [path.name for path, _ in replay.recordings(run_dir)]
    assert names == ["run-001.rrd", "run-002.rrd", "run-999.rrd", "run-1000.rrd"]


def test_a_run_without_a_recording_is_told_how_one_comes(run_dir: Path) -> None:
    for part in (run_dir / "recording").iterdir():
        part.unlink()
    with pytest.raises(RecordingError, match=r"no recording in .*recording_mb.*--no-dashboard"):
        replay.recordings(run_dir)
    (run_dir / "recording" / "run-001.rrd").write_bytes(HEADER)
    with pytest.raises(RecordingError, match="nothing has been recorded yet"):
        replay.recordings(run_dir)


@pytest.mark.usefixtures("_no_program")
def test_a_port_that_was_asked_for_is_not_changed(run_dir: Path) -> None:
    server = WebServer("127.0.0.1", 0, None, "run", "life")
    server.start()
    port = int(server.url.rpartition(":")[2])
    try:
        with pytest.raises(AddressError, match=rf"{port}, is in use; .*--port"):
            replay.replay(arguments_of(run_dir, port=port), threading.Event())
    finally:
        server.close()


@pytest.mark.usefixtures("_no_program")
def test_the_usual_port_gives_way_to_a_free_one(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    taken = WebServer("127.0.0.1", 0, None, "run", "life")
    taken.start()
    monkeypatch.setattr(replay, "WEB_PORT", int(taken.url.rpartition(":")[2]))
    stopped, opened = threading.Event(), []
    monkeypatch.setenv("BROWSER", "wished")
    monkeypatch.setattr(replay.webbrowser, "open", lambda url: opened.append(url) or stopped.set() or True)
    try:
        replay.replay(arguments_of(run_dir, browser=True), stopped)
    finally:
        taken.close()
    assert opened
    assert opened[0] != taken.url


@pytest.mark.usefixtures("_no_program")
def test_without_a_screen_no_browser_is_opened_and_none_in_the_terminal(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in (*replay.DISPLAYS, "BROWSER"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("SSH_CONNECTION", "here there")
    monkeypatch.setattr(replay.webbrowser, "open", lambda url: pytest.fail("opened a browser"))
    stopped = threading.Event()
    stopped.set()
    replay.replay(arguments_of(run_dir, browser=True), stopped)
    said = capsys.readouterr().out
    assert "http://127.0.0.1:" in said
    assert "ssh -L" in said
    with pytest.raises(UserError, match="--native needs a screen"):
        replay.replay(arguments_of(run_dir, native=True), stopped)


@pytest.mark.usefixtures("_no_program")
def test_a_viewer_that_cannot_be_had_ends_the_replay(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(cancelled: threading.Event) -> None:
        raise viewer_files.ViewerFilesError("rerun's program cannot be started here")

    monkeypatch.setattr(viewer_files, "_fetch_all", refuse)
    with pytest.raises(UserError, match="cannot be started"):
        replay.replay(arguments_of(run_dir), threading.Event())


@pytest.mark.usefixtures("_no_program")
def test_the_native_viewer_is_given_the_parts_and_its_end_is_ours(
    run_dir: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    program, given = tmp_path / "rerun", tmp_path / "given"
    program.write_text(
        f'#!/bin/sh\necho "$@" > {given}\ncat "$XDG_CONFIG_HOME/rerun/analytics.json" >> {given}\n'
    )
    program.chmod(0o755)
    monkeypatch.setattr(replay, "rerun_program", lambda: program)
    monkeypatch.setenv("DISPLAY", ":7")
    replay.replay(arguments_of(run_dir, native=True), threading.Event())
    words, settings = given.read_text().splitlines()
    assert "/recording/run-001.rrd" in words
    assert "/recording/run-002.rrd" in words
    assert json.loads(settings)["analytics_enabled"] is False
    program.write_text("#!/bin/sh\nexit 3\n")
    with pytest.raises(UserError, match=r"ended with code 3.*--native"):
        replay.replay(arguments_of(run_dir, native=True), threading.Event())


def test_a_signal_ends_it_in_order(run_dir: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def hear_one(arguments: argparse.Namespace, stopped: threading.Event) -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        assert stopped.wait(10)

    monkeypatch.setattr(replay, "replay", hear_one)
    try:
        assert replay.main(["--run-dir", str(run_dir)]) == 0
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
