"""The recording on disk: parts, their bound, what they hold, and a disk that refuses."""

import resource
import socket
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.parts import FLUSH_SECS, Parts
from services.dashboard.recording import free_port
from services.runtime.errors import UserError
from tests.unit.dashboard_reading import rows_of, verified


@pytest.fixture(autouse=True)
def _strict() -> None:
    rr.set_strict_mode(True)


@pytest.fixture
def short_files() -> Iterator[int]:
    """No file of this process may grow beyond this many bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, before[1]))
    yield 200_000
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def parts_in(folder: Path, bound_bytes: int = 4_000_000) -> Parts:
    """Parts of a quarter of the bound each."""
    return Parts(
        folder,
        bound_bytes,
        new_stream=lambda: rr.RecordingStream("babble", recording_id="made-up"),
        blueprint=rrb.Blueprint(rrb.TimeSeriesView(origin="/")),
    )


def fill(written: Parts, secs: float, kilobytes: int) -> None:
    """Log something so large at this time, as often as a dashboard would."""
    assert written.stream is not None
    written.stream.set_time("run_time", duration=secs)
    noise = np.random.default_rng(int(secs)).random((kilobytes * 1000 // 8, 2), np.float32)
    written.stream.log("/noise", rr.Points2D(noise))


def test_a_full_part_is_followed_by_another_and_the_oldest_go(tmp_path: Path) -> None:
    written = parts_in(tmp_path)
    assert written.open(0.0)
    sums = []
    for turn in range(1, 13):
        fill(written, turn, 600)
        if written.flush_if_due(turn * FLUSH_SECS):
            written.close()
            assert written.open(turn * FLUSH_SECS)
        sums.append(sum(path.stat().st_size for path in tmp_path.iterdir()))
    written.close()
    names = sorted(path.name for path in tmp_path.iterdir())
    assert max(sums) <= 4_000_000
    assert written.deleted == written.opened - len(names) > 0
    numbers = range(written.deleted + 1, written.opened + 1)
    assert names == [f"run-{number:03d}.rrd" for number in numbers], "the oldest are deleted"


def test_every_part_can_be_read_alone_and_belongs_to_the_same_recording(tmp_path: Path) -> None:
    written = parts_in(tmp_path / "recording")
    for turn in range(2):
        assert written.open(0.0)
        fill(written, turn, 10)
        written.close()
    for number, path in enumerate(sorted((tmp_path / "recording").iterdir())):
        assert verified(path, tmp_path / "home")
        assert [row.run_secs for row in rows_of([path], "/noise")] == [number]


def test_a_new_process_begins_a_new_part_and_keeps_what_is_there(tmp_path: Path) -> None:
    for _ in range(2):
        written = parts_in(tmp_path)
        assert written.open(0.0)
        written.close()
    (tmp_path / "notes.txt").write_text("not ours")
    again = parts_in(tmp_path)
    assert again.open(0.0)
    again.close()
    sizes = [(tmp_path / f"run-00{number}.rrd").stat().st_size for number in (1, 2, 3)]
    assert sum(sizes) == again.bytes
    assert (tmp_path / "notes.txt").exists()


def test_a_disk_that_fills_ends_the_recording_alone(tmp_path: Path, short_files: int) -> None:
    written = parts_in(tmp_path)
    assert written.open(0.0)
    for turn in range(1, 4):
        if written.stream is not None:
            fill(written, turn, 300)
        assert not written.flush_if_due(turn * FLUSH_SECS)
    assert written.stream is None
    assert written.errors == 1
    assert written.last_error.startswith(f"nothing more is recorded in {tmp_path} (")
    assert "file too large" in written.last_error
    assert "make room" in written.last_error
    assert sum(path.stat().st_size for path in tmp_path.iterdir()) == short_files
    written.close()
    assert written.errors == 1


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path) -> None:
    (tmp_path / "recording").write_text("a file stands where the folder should be")
    written = parts_in(tmp_path / "recording")
    assert not written.open(0.0)
    assert written.errors == 1
    assert str(tmp_path / "recording") in written.last_error


def test_a_port_in_use_is_told_in_one_sentence() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(UserError) as caught:
            free_port("127.0.0.1", port)
    assert str(caught.value) == (
        f"cannot listen at port {port} of 127.0.0.1: it is in use; give another port with --grpc-port"
    )
    assert free_port("127.0.0.1", port) == port
    assert free_port("127.0.0.1", 0) > 0
