"""Checkpoints are whole or skipped, and say what to do when all are damaged."""

import errno
import logging
import os
from pathlib import Path

import pytest

from services.runtime.checkpoint import Checkpoints, write_atomically
from services.runtime.errors import CheckpointError, StorageError

PAYLOAD = {"weights": bytes(range(256)) * 40, "book": b"{}", "empty": b""}


def files(folder: Path) -> list[Path]:
    return sorted(folder.glob("*.checkpoint"))


def test_an_empty_or_missing_folder_has_no_checkpoint(tmp_path: Path) -> None:
    assert Checkpoints(tmp_path).newest() is None
    assert Checkpoints(tmp_path / "none").newest() is None


@pytest.mark.parametrize("payload", [PAYLOAD, b"bytes", b"", {}])
def test_what_was_saved_is_what_the_next_process_finds(
    tmp_path: Path, payload: bytes | dict[str, bytes]
) -> None:
    Checkpoints(tmp_path).save(1, b"older")
    Checkpoints(tmp_path).save(2, payload)
    assert Checkpoints(tmp_path).newest() == (2, payload)


def test_the_newest_two_are_kept_and_found_by_number(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path)
    for generation in range(8, 13):
        checkpoints.save(generation, str(generation).encode())
    assert [path.name for path in files(tmp_path)] == ["00000011.checkpoint", "00000012.checkpoint"]
    assert checkpoints.newest() == (12, b"12")


@pytest.mark.parametrize("damage", ["truncated", "empty", "flipped", "longer", "header"])
def test_a_damaged_newest_is_skipped_with_a_sentence(
    tmp_path: Path, damage: str, caplog: pytest.LogCaptureFixture
) -> None:
    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, PAYLOAD)
    checkpoints.save(2, PAYLOAD)
    newest = files(tmp_path)[-1]
    whole = newest.read_bytes()
    newest.write_bytes(
        {
            "truncated": whole[:-1],
            "empty": b"",
            "flipped": whole[:-1] + bytes([whole[-1] ^ 1]),
            "longer": whole + b"x",
            "header": b"{" + whole,
        }[damage]
    )
    with caplog.at_level(logging.ERROR):
        assert Checkpoints(tmp_path).newest() == (1, PAYLOAD)
    assert str(newest) in caplog.text


@pytest.mark.parametrize("next_generation", [2, 3])
def test_after_a_fallback_the_damaged_one_goes_and_the_good_one_is_kept(
    tmp_path: Path, next_generation: int
) -> None:
    Checkpoints(tmp_path).save(1, b"one")
    Checkpoints(tmp_path).save(2, b"two")
    files(tmp_path)[-1].write_bytes(b"")
    checkpoints = Checkpoints(tmp_path)
    assert checkpoints.newest() == (1, b"one")
    checkpoints.save(next_generation, b"again")
    assert checkpoints.newest() == (next_generation, b"again")
    files(tmp_path)[-1].write_bytes(b"")
    assert Checkpoints(tmp_path).newest() == (1, b"one")


def test_only_damaged_ones_are_an_error_that_names_them(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path)
    for generation in (1, 2):
        checkpoints.save(generation, PAYLOAD)
    for path in files(tmp_path):
        path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(CheckpointError) as failure:
        Checkpoints(tmp_path).newest()
    text = str(failure.value)
    assert "00000001.checkpoint, 00000002.checkpoint" in text
    assert str(tmp_path) in text
    assert "start a new run" in text


def test_a_kill_at_any_point_leaves_the_old_or_the_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Killed(BaseException):
        pass

    def die(*arguments: object) -> None:
        raise Killed

    path = tmp_path / "file"
    write_atomically(path, b"old")
    for step in ("fsync", "replace"):
        with monkeypatch.context() as patch:
            patch.setattr(os if step == "fsync" else Path, step, die)
            with pytest.raises(Killed):
                write_atomically(path, b"new" * 1000)
        assert path.read_bytes() == b"old"


def test_what_a_kill_left_half_written_is_no_checkpoint_and_is_tidied_up(tmp_path: Path) -> None:
    checkpoints = Checkpoints(tmp_path)
    (tmp_path / ".00000007.checkpoint.123.draft").write_bytes(b"half")
    assert checkpoints.newest() is None
    checkpoints.save(1, b"one")
    assert [path.name for path in tmp_path.iterdir()] == ["00000001.checkpoint"]


def test_a_full_disk_is_one_sentence_and_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    checkpoints = Checkpoints(tmp_path)
    checkpoints.save(1, b"old")
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(StorageError, match=r"00000002\.checkpoint: No space left on device"):
        checkpoints.save(2, PAYLOAD)
    monkeypatch.undo()
    assert [path.name for path in tmp_path.iterdir()] == ["00000001.checkpoint"]
    assert checkpoints.newest() == (1, b"old")


def test_a_file_in_place_of_the_folder_is_one_sentence_too(tmp_path: Path) -> None:
    (tmp_path / "a file").write_bytes(b"in the way")
    for path in (tmp_path / "a file" / "new", tmp_path / "a file" / "folder" / "new"):
        with pytest.raises(StorageError, match=f"cannot write {path}"):
            write_atomically(path, b"new")
    assert (tmp_path / "a file").read_bytes() == b"in the way"


def test_the_file_is_synced_before_it_gets_its_name_and_the_folder_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    steps: list[str] = []
    sync, replace = os.fsync, Path.replace

    def note_sync(handle: int) -> None:
        steps.append("sync folder" if os.path.isdir(f"/proc/self/fd/{handle}") else "sync file")
        sync(handle)

    def note_replace(path: Path, target: Path) -> Path:
        steps.append("rename")
        return replace(path, target)

    monkeypatch.setattr(os, "fsync", note_sync)
    monkeypatch.setattr(Path, "replace", note_replace)
    write_atomically(tmp_path / "file", [b"a", b"b"])
    assert steps == ["sync file", "rename", "sync folder"]
