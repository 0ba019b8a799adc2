"""What people are told of a recording: at the end of a run, and in its report."""

import json
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from babble.recording import METADATA_KEY, STATES
from services.launcher import timeline_figure
from services.launcher.cli import main
from services.launcher.conclusion import print_scores
from services.launcher.report import write_report
from services.launcher.run_folder import RunFolder
from services.runtime.settings import parse

NAMES = ["position/x", "position/y"]
OPEN_LOOP = {"phases": {"open_loop": True}, "recording": {"every_steps": 2}}


def folder_of(path: Path, **table: Any) -> RunFolder:
    return RunFolder.create(parse({"scenario": "s", **table}, origin="test"), path, ["babble"])


def record(folder: RunFolder, phase: str, number: int, steps: list[int]) -> Path:
    """A file of the recording of one actor with one world."""
    about = {"every_steps": 2, "state_names": NAMES}
    places = {"step": pa.array(steps, pa.int64()), "term": pa.array([number + 1] * len(steps), pa.int32())}
    actor = pa.array(["actor-1"] * len(steps)).dictionary_encode()
    column = pa.array([0] * len(steps), pa.int16())
    states = {name: pa.array([0.5] * len(steps), pa.float32()) for name in NAMES}
    table = pa.table({**places, "actor": actor, "column": column, **states})
    path = folder.path / STATES / f"phase={phase}" / f"part-{number:06}.parquet"
    path.parent.mkdir(parents=True)
    pq.write_table(table.replace_schema_metadata({METADATA_KEY: json.dumps(about)}), path)
    return path


def told(folder: RunFolder, capsys: pytest.CaptureFixture[str]) -> str:
    print_scores(folder)
    return " ".join(capsys.readouterr().out.split())


def test_of_an_open_loop_the_rows_are_told_and_no_scores(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path / "r", **OPEN_LOOP)
    assert told(folder, capsys) == (
        "nothing is learned in an open loop, so there are no scores nothing has been recorded yet"
    )
    record(folder, "babble", 0, [0, 2, 4])
    said = told(folder, capsys)
    assert f"3 rows of 2 state components are in {folder.shown}/states (1 file, 0.0 MB)" in said
    assert said.endswith(f"see what was explored with: babble coverage {folder.shown}")
    assert "iter " not in said


def test_of_a_run_that_learns_scores_come_first_and_then_the_rows(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path / "r", recording={"every_steps": 2})
    record(folder, "babble", 0, [0, 2])
    record(folder, "ground", 1, [4, 6])
    assert told(folder, capsys).startswith("there are no scores 4 rows of 2 state components are in ")


def test_of_a_run_that_records_nothing_nothing_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert told(folder_of(tmp_path / "r"), capsys) == "there are no scores"


def test_a_recording_that_cannot_be_read_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = folder_of(tmp_path / "r", **OPEN_LOOP)
    record(folder, "babble", 0, [0]).write_bytes(b"PAR1 and no more")
    assert "part-000000.parquet cannot be read" in told(folder, capsys)


def test_a_completed_open_loop_is_not_run_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = folder_of(tmp_path / "r", **OPEN_LOOP)
    record(folder, "babble", 0, [0, 2])
    folder.finish({"scores_secs": 1.0})
    for command in (["up", "--resume"], ["watch"]):
        assert main([*command, str(folder.path)]) == 0
        said = capsys.readouterr().out
        assert "is completed already:" in said
        assert "2 rows of 2 state components" in said


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(timeline_figure, "draw_timeline", lambda *_: None)


def event(secs: float, text: str) -> str:
    return json.dumps({"secs": secs, "what": "phase", "text": text}) + "\n"


@pytest.mark.usefixtures("undrawn")
def test_the_report_of_an_open_loop_tells_what_was_recorded_and_how_to_read_it(tmp_path: Path) -> None:
    folder = folder_of(tmp_path / "r", **OPEN_LOOP)
    record(folder, "babble", 0, [0, 2, 4, 10, 10])
    begin, end = (f"{phase} (level 0, iteration 0, term {n})" for n, phase in ((1, "babble"), (2, "done")))
    (folder.path / "events.jsonl").write_text(event(100.0, begin) + event(160.0, end))
    text = write_report(folder.path).read_text()
    assert "Nothing is learned in an open loop, so there are no scores" in text
    assert "5 rows of 2 state components, by 1 actor, in 1 file" in text
    assert "a row for one in 2 environment steps" in text
    assert "Rows that are there twice: 1; rows that are missing: 2." in text
    assert "| babble | 5 |" in text
    assert "In the phases that were completed: 20,000 environment steps." in text
    assert f"babble coverage {folder.shown}" in text
    for of_models in ("evaluated", "to learn from", "babble score", "unfinished"):
        assert of_models not in text


@pytest.mark.usefixtures("undrawn")
def test_a_report_before_the_first_rows_says_so(tmp_path: Path) -> None:
    text = write_report(folder_of(tmp_path / "r", **OPEN_LOOP).path).read_text()
    assert "## What was recorded\n\nNothing yet." in text


def test_what_is_read_back_is_what_polars_reads_by_the_line_in_the_report(tmp_path: Path) -> None:
    polars = pytest.importorskip("polars")
    folder = folder_of(tmp_path / "r", **OPEN_LOOP)
    record(folder, "babble", 0, [0, 2, 4])
    line = next(
        part for part in write_report(folder.path).read_text().split("`") if part.startswith("polars")
    )
    pattern, option = line.removeprefix('polars.read_parquet("').split('", ')
    assert option == "hive_partitioning=True)"
    assert polars.read_parquet(pattern, hive_partitioning=True)["phase"].to_list() == ["babble"] * 3
