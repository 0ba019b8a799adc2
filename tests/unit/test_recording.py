"""A recording as it is read: in the order of its steps, whole or with a sentence; and by others in a line."""

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from babble.recording import Recording, RecordingError
from examples import read_states
from protocol.messages import Phase
from tests.unit.recorder_stage import COLUMNS, LIFE, ROWS, STEPS, RecorderStage, settings_of


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two actors of different speed in three terms, the last one of EVALUATE; written by the recorder."""
    folder = tmp_path_factory.mktemp("recorded")
    stage = RecorderStage(settings_of(), folder)
    slow, fast = stage.actor(2), stage.actor(1)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    for term, phase, sender, segments in (
        (1, Phase.BABBLE, fast, 7), (2, Phase.WALK, fast, 2), (1, Phase.BABBLE, slow, 3),
        (2, Phase.WALK, slow, 1), (3, Phase.EVALUATE, fast, 1),
    ):  # fmt: skip
        for _ in range(segments):
            sender.send(phase, term)
    stage.poll(2)
    stage.services[LIFE].stop()
    stage.poll(1)
    return folder


def test_states_come_in_the_order_of_term_step_in_it_actor_and_column(run: Path) -> None:
    recording = Recording.open(run)
    states = recording.states()
    terms = recording.table(["term"]).column("term").to_numpy()
    assert len(states) == 13 * ROWS
    actor, column, step = states.T
    first = np.where(terms == 1, 0, np.where(actor == 1, 7 * STEPS, 3 * STEPS))
    assert np.array_equal(np.lexsort((column, actor, step - first, terms)), np.arange(len(states)))
    assert states.dtype == np.float32
    assert states.flags["C_CONTIGUOUS"]


def test_the_first_rows_are_those_of_the_first_steps(run: Path) -> None:
    recording = Recording.open(run)
    first = recording.states(most_rows=5 * COLUMNS * 2 + 3)
    assert np.array_equal(first, recording.states()[: len(first)])
    assert len(first) == 83
    assert first[:, 2].max() == 5
    assert len(recording.states(most_rows=10**9)) == 13 * ROWS
    assert recording.states(most_rows=0).shape == (0, 3)
    with pytest.raises(ValueError, match="most_rows must be at least 0, got -1"):
        recording.states(most_rows=-1)


def test_of_a_run_that_is_resumed_in_a_term_the_rows_before_come_first(tmp_path: Path) -> None:
    stage = RecorderStage(settings_of(), tmp_path)
    one, other = stage.actor(1), stage.actor(2)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    for term, sender in ((1, one), (2, one), (2, other), (2, one), (2, other)):
        sender.send(Phase.PRACTISE, term)
    stage.poll(2)
    third, fourth = stage.actor(3), stage.actor(4)
    for term, sender in ((2, third), (2, fourth), (2, third), (3, fourth), (3, third)):
        sender.send(Phase.PRACTISE, term)
    stage.poll(2)
    stage.services[LIFE].stop()
    stage.poll(1)
    actor, column, step = Recording.open(tmp_path).states().T
    assert (column[:COLUMNS] == np.arange(COLUMNS)).all()
    each = [(int(a), int(s)) for a, s in zip(actor[::COLUMNS], step[::COLUMNS], strict=True)]
    before = [(1, s) for s in range(STEPS)]
    before += [(a, s + (STEPS if a == 1 else 0)) for s in range(2 * STEPS) for a in (1, 2)]
    after = [(a, s) for s in range(STEPS) for a in (3, 4)] + [(3, s) for s in range(STEPS, 2 * STEPS)]
    after += [(a, s + (2 if a == 3 else 1) * STEPS) for s in range(STEPS) for a in (3, 4)]
    assert each == before + after


def test_evaluations_are_left_out_unless_asked_for(run: Path) -> None:
    recording = Recording.open(run)
    assert recording.phases == ("babble", "walk", "evaluate")
    assert recording.rows == 14 * ROWS
    assert len(recording.states(phases=["evaluate"])) == ROWS
    assert len(recording.states(phases=recording.phases)) == 14 * ROWS
    assert recording.states(phases=["ground"]).shape == (0, 3)


def test_a_table_has_the_columns_that_were_asked_for_in_the_same_order(run: Path) -> None:
    recording = Recording.open(run)
    table = recording.table(["position/z", "phase", "actor", "episode"])
    assert table.column_names == ["position/z", "phase", "actor", "episode"]
    assert np.array_equal(table.column("position/z").to_numpy(), recording.states()[:, 2])
    assert table.column("phase").to_pylist() == ["babble"] * 10 * ROWS + ["walk"] * 3 * ROWS
    assert set(table.column("episode").to_pylist()) == {7}
    numbers = [int(life[-1]) for life in table.column("actor").to_pylist()]
    assert numbers == recording.states()[:, 0].tolist()
    assert recording.table(["step"], phases=["ground"]).num_rows == 0
    with pytest.raises(RecordingError, match="no column 'height'"):
        recording.table(["height"])


def test_the_recording_says_what_it_is_of(run: Path) -> None:
    recording = Recording.open(run)
    assert recording.state_names == ("position/x", "position/y", "position/z")
    assert recording.every_steps == 1
    audit = recording.audit()
    assert (audit.rows, audit.duplicates, audit.gaps) == (14 * ROWS, 0, 0)
    assert audit.rows_by_phase == {"babble": 10 * ROWS, "walk": 3 * ROWS, "evaluate": ROWS}
    assert audit.actors == ("actor-1", "actor-2")


def test_an_audit_finds_rows_that_are_double_or_missing(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path, dirs_exist_ok=True)
    (path,) = (tmp_path / "states" / "phase=babble").iterdir()
    whole = pq.read_table(path)
    pq.write_table(whole.filter(np.asarray(whole.column("step")) % STEPS != 5), path)
    shutil.copy(path, path.with_name("part-000099.parquet"))
    audit = Recording.open(tmp_path).audit()
    assert audit.gaps == 10 * COLUMNS
    assert audit.duplicates == 10 * (ROWS - COLUMNS)


def test_what_is_no_recording_gets_one_sentence(run: Path, tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"has no recorded states; set recording\.every_steps"):
        Recording.open(tmp_path)
    shutil.copytree(run, tmp_path, dirs_exist_ok=True)
    (path,) = (tmp_path / "states" / "phase=babble").iterdir()
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])
    with pytest.raises(RecordingError, match=r"part-000000\.parquet cannot be read .*restore it"):
        Recording.open(tmp_path)
    path.write_bytes(data[:4] + bytes(len(data) // 2) + data[4 + len(data) // 2 :])
    with pytest.raises(RecordingError, match=r"part-000000\.parquet cannot be read"):
        Recording.open(tmp_path).states()
    pq.write_table(pq.read_table(run / "states").replace_schema_metadata(None), path)
    with pytest.raises(RecordingError, match=r"part-000000\.parquet was not written by Babble's recorder"):
        Recording.open(tmp_path)
    about = pq.read_schema(run / "states" / "phase=babble" / path.name).metadata[b"babble"]
    other = {b"babble": about.replace(b'"run": "r"', b'"run": "q"')}
    pq.write_table(pq.read_table(run / "states").replace_schema_metadata(other), path)
    with pytest.raises(RecordingError, match="keep each run in a folder of its own"):
        Recording.open(tmp_path)


def test_what_a_recorder_is_about_to_write_is_not_read(run: Path, tmp_path: Path) -> None:
    shutil.copytree(run, tmp_path, dirs_exist_ok=True)
    (tmp_path / "states" / "phase=babble" / ".part-000099.parquet.7.draft").write_bytes(b"PAR1 half a file")
    assert Recording.open(tmp_path).rows == 14 * ROWS
    assert read_states.with_pandas(tmp_path).to_dict() == {
        "babble": 10 * ROWS,
        "walk": 3 * ROWS,
        "evaluate": ROWS,
    }
    assert read_states.with_duckdb(tmp_path)[0] == ("babble", None)


def test_pandas_polars_and_duckdb_read_it_in_one_line(run: Path) -> None:
    assert read_states.with_pandas(run).to_dict() == {"babble": 10 * ROWS, "walk": 3 * ROWS, "evaluate": ROWS}
    assert read_states.with_polars(run).rows() == [
        ("actor-1", 0, 10 * STEPS - 1), ("actor-2", 0, 4 * STEPS - 1)
    ]  # fmt: skip
    assert read_states.with_duckdb(run) == [("babble", None), ("evaluate", None), ("walk", None)]


def test_the_example_is_a_program(run: Path) -> None:
    done = subprocess.run(
        [sys.executable, read_states.__file__, str(run)],
        capture_output=True,
        text=True,
        timeout=200,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert f"walk         {3 * ROWS}" in done.stdout
