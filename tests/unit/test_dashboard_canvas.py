"""What panels log to: live and file, lines with names, gaps for what is no number, signs of the font."""

from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from services.dashboard.canvas import Canvas, Due, Lines, colours, plain
from services.dashboard.colours import SKY, VERMILLION, darker, faded
from tests.unit.dashboard_reading import Row, rows_of, scalars


class Two:
    """Two streams, each to a file of its own."""

    def __init__(self, folder: Path) -> None:
        self.paths = [folder / "live.rrd", folder / "file.rrd"]
        self._streams = []
        for path in self.paths:
            stream = rr.RecordingStream("babble", recording_id="made-up", send_properties=False)
            stream.set_sinks(rr.FileSink(path))
            stream.set_time("run_time", duration=1.0)
            self._streams.append(stream)
        self.canvas = Canvas(*self._streams)

    def read(self) -> list[list[Row]]:
        """The rows of the live stream and those of the file."""
        for stream in self._streams:
            stream.disconnect()
        return [rows_of([path]) for path in self.paths]


@pytest.fixture
def two(tmp_path: Path) -> Two:
    rr.set_strict_mode(True)
    return Two(tmp_path)


def test_what_is_not_for_the_file_goes_to_the_live_stream_alone(two: Two) -> None:
    two.canvas.log("/a", rr.Scalars(1.0))
    two.canvas.log("/a", rr.Scalars(2.0), thin=False)
    two.canvas.log("/b", rr.TextDocument("always"), static=True, thin=False)
    live, file = two.read()
    assert [row.entity for row in live] == ["/b", "/a", "/a"]
    assert [row.entity for row in file] == ["/b", "/a"]
    assert two.canvas.rows == 5


def test_a_canvas_without_streams_takes_everything() -> None:
    canvas = Canvas()
    canvas.log("/a", rr.Scalars(1.0))
    assert canvas.rows == 0


def test_lines_are_named_once_per_stream_and_leave_gaps(two: Two) -> None:
    lines = Lines()
    lines.name(two.canvas, "/a", "the first", SKY)
    lines.name(two.canvas, "/a", "another", VERMILLION)
    for value in (1.0, float("nan"), float("inf"), None, -3.0):
        lines.add(two.canvas, "/a", value)
    lines.begin(two.canvas)
    live, _ = two.read()
    names = [row.values["SeriesLines:names"] for row in live if "SeriesLines:names" in row.values]
    assert names == [["the first"], ["the first"]]
    assert scalars(two.paths[:1], "/a") == [1.0, -3.0]


def test_due_is_true_once_per_interval() -> None:
    due = Due(1.0)
    assert [due(secs / 4) for secs in range(9)] == [True, False, False, False] * 2 + [True]


def test_signs_that_the_font_lacks_become_question_marks() -> None:
    assert plain("loss 0.5 → ü\n█ \U0001f7e2 \x1b[0m 手") == "loss 0.5 → ü\n? ? ?[0m ?"


def test_colours_are_unambiguous_numbers() -> None:
    assert colours([SKY] * 4).dtype == np.uint32
    assert faded(0x11223344, 0x80) == 0x11223380
    assert darker(0x804020FF, 0.5) == 0x402010FF
