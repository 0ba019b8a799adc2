"""The spool gives back every frame that was synced, in order, or says which file is damaged."""

import errno
import os
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from services.runtime.errors import SpoolError, StorageError
from services.runtime.spool import Spool

FRAMES = [b"first", b"", bytes(range(256)) * 10, b"last"]


def write(folder: Path, frames: list[bytes] = FRAMES) -> Path:
    spool = Spool(folder)
    for frame in frames:
        spool.append(frame)
    spool.sync()
    spool.close()
    (path,) = folder.glob("*.spool")
    return path


def held(folder: Path, from_generation: int = 0) -> list[bytes]:
    spool = Spool(folder)
    frames = list(spool.replay(from_generation))
    spool.close()
    return frames


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_the_next_process_finds_what_was_appended_and_goes_on(tmp_path: Path) -> None:
    write(tmp_path)
    write(tmp_path, [b"more"])
    assert held(tmp_path) == [*FRAMES, b"more"]


@given(cut=st.integers(1, 2700))
@settings(max_examples=40, deadline=None)
def test_a_torn_tail_costs_only_the_record_it_tears(
    tmp_path_factory: pytest.TempPathFactory, cut: int
) -> None:
    folder = tmp_path_factory.mktemp("spool")
    path = write(folder)
    whole = path.read_bytes()
    path.write_bytes(whole[: max(0, len(whole) - cut)])
    found = held(folder)
    assert found == FRAMES[: len(found)]
    lengths = [12 + len(frame) for frame in FRAMES]
    kept_bytes = max(0, len(whole) - cut)
    assert len(found) == max(n for n in range(len(FRAMES)) if sum(lengths[:n]) <= kept_bytes)
    write(folder, [b"after"])
    assert held(folder) == [*found, b"after"]


def test_zeros_that_a_power_cut_left_are_a_torn_tail(tmp_path: Path) -> None:
    path = write(tmp_path)
    path.write_bytes(path.read_bytes() + bytes(5000))
    assert held(tmp_path) == FRAMES


@pytest.mark.parametrize("place", [0, 5, 9, 13, 40])
def test_a_damaged_record_with_others_after_it_is_an_error_that_names_the_file(
    tmp_path: Path, place: int
) -> None:
    path = write(tmp_path)
    damaged = bytearray(path.read_bytes())
    damaged[place] ^= 0x40
    path.write_bytes(damaged)
    with pytest.raises(SpoolError, match=r"00000000-0000\.spool is damaged at byte \d+"):
        held(tmp_path)


def test_rotation_keeps_what_the_previous_checkpoint_needs(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    for generation in range(1, 5):
        spool.append(f"before {generation}".encode())
        spool.rotate(generation)
    spool.append(b"since 4")
    spool.sync()
    spool.close()
    assert names(tmp_path) == ["00000003-0000.spool", "00000004-0000.spool"]
    assert held(tmp_path, 4) == [b"since 4"]
    assert held(tmp_path, 3) == [b"before 4", b"since 4"]


def test_a_kill_between_checkpoint_and_rotation_replays_nothing_twice(tmp_path: Path) -> None:
    write(tmp_path)
    spool = Spool(tmp_path)
    assert list(spool.replay(1)) == []
    spool.append(b"since 1")
    spool.sync()
    spool.close()
    assert held(tmp_path, 1) == [b"since 1"]


def test_after_a_fallback_the_older_checkpoint_can_still_be_chosen_again(tmp_path: Path) -> None:
    spool = Spool(tmp_path)
    spool.rotate(1)
    spool.append(b"since 1")
    spool.rotate(2)
    spool.append(b"since 2")
    spool.close()
    resumed = Spool(tmp_path)
    assert list(resumed.replay(1)) == [b"since 1", b"since 2"]
    resumed.append(b"since the fallback")
    resumed.rotate(2)
    resumed.append(b"since the new 2")
    resumed.close()
    assert held(tmp_path, 2) == [b"since the new 2"]
    assert held(tmp_path, 1) == [b"since 1", b"since 2", b"since the fallback", b"since the new 2"]


def test_a_full_disk_is_one_sentence_and_what_was_held_stays_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spool, really = Spool(tmp_path), os.write
    spool.append(b"held")
    spool.sync()
    calls: list[int] = []

    def nearly_full(handle: int, data: bytes) -> int:
        calls.append(len(data))
        if len(calls) > 1:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return really(handle, bytes(data[:7]))

    monkeypatch.setattr(os, "write", nearly_full)
    with pytest.raises(
        StorageError, match=r"\.spool: No space left on device; nothing unwritten was acknowledged"
    ):
        spool.append(b"does not fit")
    monkeypatch.undo()
    spool.append(b"fits again")
    spool.sync()
    spool.close()
    assert held(tmp_path) == [b"held", b"fits again"]


def test_a_failed_sync_is_a_storage_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(handle: int) -> None:
        raise OSError(errno.EIO, os.strerror(errno.EIO))

    spool = Spool(tmp_path)
    spool.append(b"frame")
    monkeypatch.setattr(os, "fsync", broken)
    with pytest.raises(StorageError):
        spool.sync()
    with pytest.raises(StorageError):
        spool.sync()
    spool.close()


def test_sync_reaches_the_disk_once_per_batch(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    syncs: list[int] = []
    spool = Spool(tmp_path)
    monkeypatch.setattr(os, "fsync", syncs.append)
    spool.append(b"a")
    spool.append(b"b")
    spool.sync()
    spool.sync()
    assert len(syncs) == 1
    assert spool.size_bytes == 2 * 13
    spool.close()


def test_a_folder_that_cannot_be_written_is_one_sentence(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="file"):
        Spool(tmp_path / "file" / "folder")
