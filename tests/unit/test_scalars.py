"""All numbers of a run in a table, and for TensorBoard: what was written is what is read back."""

import json
import struct
import sys
from pathlib import Path
from typing import Any

import pytest
from pyarrow import parquet

from services.launcher import report_command
from services.launcher.cli import main
from services.launcher.scalars import ROWS_AT_ONCE, scalars, write_scalars
from services.launcher.tensorboard_events import write_events
from services.runtime.errors import StorageError, UserError
from tests.unit.analytic_run import good, write_run

METRICS = [
    {
        "now_secs": 101.25,
        "term": 1,
        "life": "encoder_learner-1",
        "service": "encoder_learner",
        "phase": "babble",
        "totals": {"segments": 3, "body/encoder_updates": 40},
        "metrics": {"rss_mb": 512.5, "body/encoder/loss": 4.5},
    },
    {
        "now_secs": 102.5,
        "term": 1,
        "service": "policy_learner",
        "phase": None,
        "metrics": {"body/policy/entropy": -0.125},
    },
]
EVENTS = [
    {"secs": 100.0, "what": "phase", "text": "babble (level 0, iteration 0, term 1)"},
    {"secs": 100.5, "what": "joined", "text": "actor-1 (actor) joined"},
    {"secs": 100.5, "what": "joined", "text": "actor-2 (actor) joined"},
    {"secs": 110.0, "what": "phase", "text": "evaluate of ground (level 0, iteration 0, term 4)"},
    {"secs": 115.0, "what": "end", "text": "the run is done"},
]


def lines(records: list[dict[str, Any]]) -> str:
    return "".join(json.dumps(record) + "\n" for record in records)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    run = write_run(tmp_path / "run", [good()])
    (run / "metrics.jsonl").write_text(lines(METRICS) + "damaged\n" + '{"now_secs": 1')
    (run / "events.jsonl").write_text(lines(EVENTS))
    return run


def rows_of(path: Path) -> list[dict[str, Any]]:
    rows: list[dict[str, Any]] = parquet.read_table(path).to_pylist()
    return rows


def test_each_number_is_a_row_with_its_place(folder: Path) -> None:
    rows = rows_of(write_scalars(folder, "run"))
    learned = {"secs": 1.25, "term": 1, "phase": "babble", "iteration": 0, "service": "encoder_learner"}
    assert [row for row in rows if not row["name"].startswith(("scores/", "event/"))] == [
        {"run": "run", **learned, "block": None, "name": "rss_mb", "value": 512.5},
        {"run": "run", **learned, "block": "body", "name": "encoder/loss", "value": 4.5},
        {"run": "run", **learned, "block": None, "name": "segments", "value": 3.0},
        {"run": "run", **learned, "block": "body", "name": "encoder_updates", "value": 40.0},
        {
            "run": "run", "secs": 2.5, "term": 1, "phase": None, "iteration": 0, "block": "body",
            "service": "policy_learner", "name": "policy/entropy", "value": -0.125,
        },
    ]  # fmt: skip


def test_scores_are_told_at_the_end_of_their_evaluation(folder: Path) -> None:
    rows = rows_of(write_scalars(folder, "run"))
    (found,) = [row for row in rows if row["name"] == "scores/sampled/z_min"]
    assert found == {
        "run": "run", "secs": 15.0, "term": 4, "phase": "ground", "iteration": 0, "block": "body",
        "service": "policy_learner", "name": "scores/sampled/z_min", "value": 0.97,
    }  # fmt: skip
    recorded = json.loads((folder / "scores.jsonl").read_text().splitlines()[0])
    for name in ("separation", "separation_worst", "z_min", "z_goal", "switch_success"):
        (row,) = [row for row in rows if row["name"] == f"scores/mean/{name}"]
        assert row["value"] == recorded[name]


def test_events_are_counted(folder: Path) -> None:
    rows = [row for row in rows_of(write_scalars(folder, "run")) if row["name"] == "event/joined"]
    assert [(row["secs"], row["service"], row["value"]) for row in rows] == [
        (0.5, "actor", 1),
        (0.5, "actor", 2),
    ]


def test_a_run_that_has_just_begun_has_an_empty_table(tmp_path: Path) -> None:
    assert rows_of(write_scalars(tmp_path, "run")) == []


def test_numbers_that_fit_no_table_are_left_out(folder: Path) -> None:
    strange = [
        {"now_secs": 103.0, "term": 10**30, "phase": "\ud800", "metrics": {"loss": 10**400, "odd\n": 1.0}},
        {"now_secs": float("inf"), "metrics": {"loss": 1.0}},
        {"now_secs": 104.0, "term": -1, "phase": [], "metrics": {"body/loss": float("nan"), "x": "y"}},
        {"metrics": {"loss": 1.0}},
    ]
    (folder / "metrics.jsonl").write_text(lines(strange))
    rows = [row for row in rows_of(write_scalars(folder, "run")) if "loss" in row["name"]]
    (row,) = rows
    assert (row["term"], row["phase"], row["secs"]) == (None, None, 4.0)
    assert row["value"] != row["value"]


def test_a_long_file_is_written_piece_by_piece(folder: Path) -> None:
    count = ROWS_AT_ONCE + 10
    with (folder / "metrics.jsonl").open("w") as file:
        for index in range(count):
            file.write(f'{{"now_secs": {100 + index}, "term": 1, "metrics": {{"rss_mb": {index}}}}}\n')
    path = write_scalars(folder, "run")
    assert parquet.read_metadata(path).num_row_groups == 2
    values = parquet.read_table(path, filters=[("name", "==", "rss_mb")])["value"].to_pylist()
    assert values == list(range(count))


def test_a_disk_that_refuses_leaves_the_old_table(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write_scalars(folder, "run")
    before = path.read_bytes()

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(parquet.ParquetWriter, "write_batch", full)
    with pytest.raises(StorageError, match="No space left"):
        write_scalars(folder, "run")
    assert path.read_bytes() == before
    assert [found.name for found in folder.glob(".*")] == []


def read_events(path: Path) -> list[tuple[str, int, float, float]]:
    """(tag, step, wall time, value) of an event file, by the format of TFRecord."""
    from tensorboardX.proto.event_pb2 import Event

    data, at, found = path.read_bytes(), 0, []
    while at < len(data):
        (size,) = struct.unpack_from("<Q", data, at)
        event = Event.FromString(data[at + 12 : at + 12 + size])
        at += 12 + size + 4
        found += [(v.tag, event.step, event.wall_time, v.simple_value) for v in event.summary.value]
    return found


def test_tensorboard_finds_the_same_numbers(folder: Path) -> None:
    pytest.importorskip("tensorboardX", reason="the extra tensorboard is not installed")
    for _ in range(2):
        (path,) = write_events(folder).iterdir()
    found = read_events(path)
    assert len(found) == len(list(scalars(folder)))
    assert ("body/encoder/loss", 1250, 101.25, 4.5) in found
    assert ("encoder_learner/rss_mb", 1250, 101.25, 512.5) in found
    (score,) = [event for event in found if event[0] == "body/scores/mean/z_min"]
    assert score == ("body/scores/mean/z_min", 0, 115.0, pytest.approx(0.97))


def test_without_tensorboardx_there_is_one_sentence(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tensorboardX", None)
    monkeypatch.setitem(sys.modules, "tensorboardX.event_file_writer", None)
    with pytest.raises(UserError, match="--extra tensorboard") as refused:
        write_events(folder)
    assert "\n" not in str(refused.value)
    assert not (folder / "tensorboard").exists()


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch) -> None:
    table = {"report": (report_command.__name__, "write the report of a run anew")}
    monkeypatch.setattr("services.launcher.cli.COMMANDS", table)


@pytest.mark.usefixtures("command")
def test_the_report_is_written_anew(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(folder), "--no-rollouts"]) == 0
    assert capsys.readouterr().out == f"wrote {folder}/report.md\n"
    text = (folder / "report.md").read_text()
    assert "not rolled out" in text
    assert f'pandas.read_parquet("{folder}/scalars.parquet")' in text
    assert len(rows_of(folder / "scalars.parquet")) == len(list(scalars(folder)))


@pytest.mark.usefixtures("command")
def test_a_report_with_event_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("tensorboardX", reason="the extra tensorboard is not installed")
    assert main(["report", str(folder), "--no-rollouts", "--tensorboard"]) == 0
    assert f"tensorboard --logdir {folder}" in capsys.readouterr().out
    assert list((folder / "tensorboard").glob("events.out.tfevents.*"))


@pytest.mark.usefixtures("command")
def test_a_report_of_no_run_is_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path)]) == 2
    said = capsys.readouterr().err
    assert "is not the folder of a run" in said
    assert said.count("\n") == 1


def test_texts_are_plain_so_that_every_reader_can_search_them(folder: Path) -> None:
    schema = parquet.read_schema(write_scalars(folder, "run"))
    texts = ("run", "phase", "block", "service", "name")
    assert {str(schema.field(name).type) for name in texts} == {"string"}


def test_a_damaged_time_or_number_stops_neither_table_nor_event_files(folder: Path) -> None:
    pytest.importorskip("tensorboardX", reason="the extra tensorboard is not installed")
    far = {"now_secs": 1e300, "term": 1, "metrics": {"body/encoder/loss": 1.0}}
    huge = {"now_secs": 103.0, "term": 1, "metrics": {"body/encoder/loss": 1e300}}
    with (folder / "metrics.jsonl").open("w") as file:
        file.write(lines([far, *METRICS, huge]))
    rows = [row for row in rows_of(write_scalars(folder, "run")) if row["name"] == "encoder/loss"]
    assert [row["value"] for row in rows] == [4.5, 1e300]
    assert list(write_events(folder).iterdir())
