"""A recorder that is killed at any point loses no row that it acknowledged, and doubles none."""

import errno
import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.recording import Recording
from protocol.messages import Phase
from services.recorder import files
from services.recorder.store import Store
from services.runtime.checkpoint import Checkpoints
from services.runtime.errors import CheckpointError, StorageError
from services.runtime.spool import Spool
from tests.unit.recorder_stage import COLUMNS, LIFE, ROWS, Killed, RecorderStage, open_loop, settings_of

WANTED = 40 * ROWS
POINTS: dict[str, tuple[Any, str]] = {
    "spool": (Spool, "append"),
    "sync": (Spool, "sync"),
    "file": (files, "write_atomically"),
    "checkpoint": (Checkpoints, "save"),
    "rotation": (Spool, "rotate"),
    "writing": (Store, "write"),
}


def dying(call: Callable[..., Any], nth: int, before: bool) -> Callable[..., Any]:
    """A function whose nth call is the last thing that its process does."""
    left = [nth]

    def called(*args: Any, **named: Any) -> Any:
        left[0] -= 1
        if before and left[0] == 0:
            raise Killed
        result = call(*args, **named)
        if left[0] == 0:
            raise Killed
        return result

    return called


def check_whole(run_dir: Path, rows: int) -> None:
    """Each row once, none missing between, and in each what was sent as that row."""
    recording = Recording.open(run_dir)
    audit = recording.audit()
    assert (audit.duplicates, audit.gaps) == (0, 0)
    assert audit.rows == rows
    table = recording.table(["actor", "column", "step"])
    numbers = [int(str(life).split("-")[1]) for life in table.column("actor").to_pylist()]
    assert np.array_equal(
        recording.states(),
        np.stack([numbers, table.column("column").to_numpy(), table.column("step").to_numpy()], axis=1),
    )


@pytest.mark.parametrize("before", [True, False], ids=["before", "after"])
@pytest.mark.parametrize("nth", [1, 3])
@pytest.mark.parametrize("point", POINTS)
def test_killed_at_any_point_it_neither_loses_nor_doubles_a_row(
    point: str, nth: int, before: bool, tmp_path: Path
) -> None:
    stage = RecorderStage(open_loop(WANTED), tmp_path)
    stage.actor(1), stage.actor(2)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    owner, name = POINTS[point]
    with pytest.MonkeyPatch.context() as patch, stage.killed():
        patch.setattr(owner, name, dying(getattr(owner, name), nth, before))
        stage.until_finished(1)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.until_finished(1)
    check_whole(tmp_path, WANTED)
    assert stage.status(LIFE).totals["rows"] == WANTED
    assert stage.status(LIFE).totals["gaps"] == 0


def test_killed_at_every_file_it_still_ends(tmp_path: Path) -> None:
    stage = RecorderStage(open_loop(WANTED), tmp_path)
    stage.actor(1)
    for _ in range(3):
        stage.start(LIFE)
        stage.announce(Phase.BABBLE, 1, ["body"])
        with pytest.MonkeyPatch.context() as patch, stage.killed():
            patch.setattr(files, "write_atomically", dying(files.write_atomically, 2, False))
            stage.until_finished(1)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.until_finished(1)
    check_whole(tmp_path, WANTED)


def test_a_damaged_newest_checkpoint_costs_nothing(tmp_path: Path) -> None:
    stage = recorded(tmp_path)
    newest = sorted((tmp_path / "checkpoints" / "recorder").glob("*.checkpoint"))[-1]
    newest.write_bytes(newest.read_bytes()[:-1])
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.until_finished(1)
    check_whole(tmp_path, WANTED)


@pytest.mark.parametrize("point", ["file", "checkpoint"])
def test_a_full_disk_is_said_and_costs_nothing(
    point: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = RecorderStage(open_loop(WANTED), tmp_path)
    stage.actor(1)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    fsync, wanted = os.fsync, {"file": ".parquet", "checkpoint": ".checkpoint"}[point]

    def full(handle: int) -> None:
        if wanted in os.readlink(f"/proc/self/fd/{handle}"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(handle)

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", full)
        with pytest.raises(StorageError, match="No space left on device"):
            stage.until_finished(1)
    stage.crash(LIFE)
    assert not list(tmp_path.rglob("*.draft"))
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.until_finished(1)
    check_whole(tmp_path, WANTED)


def recorded(tmp_path: Path) -> RecorderStage:
    """A run whose recorder has ended in order, with five files."""
    stage = RecorderStage(open_loop(WANTED), tmp_path)
    stage.actor(1)
    stage.start(LIFE)
    stage.announce(Phase.BABBLE, 1, ["body"])
    stage.until_finished(1)
    stage.crash(LIFE)
    return stage


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    stage = recorded(tmp_path)
    (tmp_path / "states" / "phase=babble" / "part-000001.parquet").unlink()
    with pytest.raises(CheckpointError, match=r"part-000001\.parquet.*is missing.*start a new run"):
        stage.start(LIFE)


def test_files_without_their_checkpoints_are_not_deleted(tmp_path: Path) -> None:
    stage = recorded(tmp_path)
    for path in (tmp_path / "checkpoints" / "recorder").iterdir():
        path.unlink()
    with pytest.raises(CheckpointError, match="files that no checkpoint of this run's recorder knows; move"):
        stage.start(LIFE)
    assert len(list(tmp_path.rglob("part-*.parquet"))) == 5


def test_other_settings_and_damaged_files_are_refused(tmp_path: Path) -> None:
    stage = recorded(tmp_path)
    stage.settings = settings_of(recording={"every_steps": 2, "group_rows": 1024})
    with pytest.raises(CheckpointError, match="other settings; go on with those, or start a new run"):
        stage.start("recorder-2")
    stage.settings = open_loop(WANTED)
    (tmp_path / "states" / "phase=babble" / "part-000004.parquet").write_bytes(b"PAR1 and nothing more")
    with pytest.raises(CheckpointError, match=r"part-000004\.parquet cannot be read"):
        stage.start(LIFE)


def test_a_run_has_one_recorder(tmp_path: Path) -> None:
    stage = RecorderStage(open_loop(WANTED), tmp_path)
    stage.start(LIFE)
    with pytest.raises(CheckpointError, match="another recorder is at work"):
        stage.start("recorder-2")


def test_rows_of_columns_are_in_the_order_of_their_steps(tmp_path: Path) -> None:
    stage = recorded(tmp_path)
    assert stage.actors[0].sent * ROWS == WANTED
    states = Recording.open(tmp_path).states(most_rows=3 * COLUMNS)
    assert states[:, 2].tolist() == [step for step in range(3) for _ in range(COLUMNS)]
    assert states[:, 1].tolist() == list(range(COLUMNS)) * 3
