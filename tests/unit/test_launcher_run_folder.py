"""The run's folder: names, records, the lock, and folders that are none."""

import fcntl
import json
import os
import threading
from datetime import datetime
from pathlib import Path

import pytest
from pydantic import TypeAdapter

from protocol.messages import Name
from services.launcher.run_folder import RunFolder, RunFolderError, config_text, run_name, running
from services.runtime.errors import StorageError
from services.runtime.settings import RunSettings, load, parse


@pytest.fixture
def settings() -> RunSettings:
    block = {"name": "arm", "latent_dim": 3, "observes": [0, 2]}
    table = {
        "scenario": "cuboid",
        "seed": 4,
        "block": [block],
        "world": {"parameters": {"half_sizes": [1.0, 2, 3]}},
    }
    return parse(table, origin="test")


@pytest.fixture
def folder(tmp_path: Path, settings: RunSettings, monkeypatch: pytest.MonkeyPatch) -> RunFolder:
    monkeypatch.chdir(tmp_path)
    return RunFolder.create(settings, None, ["babble", "up", "cuboid"])


def test_a_new_run_records_its_settings_versions_and_command(
    folder: RunFolder, settings: RunSettings
) -> None:
    assert folder.path.parent.name == "runs"
    assert folder.path.name == folder.run
    assert folder.shown == f"runs/{folder.run}"
    assert load(folder.path / "config.toml") == settings == folder.settings()
    record = json.loads((folder.path / "run.json").read_text())
    assert (record["run"], record["seed"], record["command"]) == (folder.run, 4, ["babble", "up", "cuboid"])
    assert record["packages"]["numpy"]
    assert set(record["babble"]) == {"version", "commit", "dirty"}


def test_names_of_runs_fit_the_wire(settings: RunSettings) -> None:
    longest = settings.model_copy(update={"scenario": "s" * 64, "seed": 2**32 - 1})
    name = run_name(longest, datetime(2026, 1, 2, 3, 4, 5))
    assert TypeAdapter(Name).validate_python(name) == name
    assert name.endswith("-20260102-030405-4294967295")


def test_two_runs_of_the_same_second_have_two_folders(
    tmp_path: Path, settings: RunSettings, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    runs = [RunFolder.create(settings, None, []) for _ in range(3)]
    assert len({run.path for run in runs}) == len({run.run for run in runs}) == 3


def test_the_whole_settings_are_in_the_recorded_text(settings: RunSettings) -> None:
    text = config_text(settings)
    for section in ("[world.parameters]", "[encoder.refine]", "[wire]", "[[block]]"):
        assert section in text


def test_a_run_is_found_by_folder_and_by_name_and_nothing_else_is(folder: RunFolder, tmp_path: Path) -> None:
    assert RunFolder.find(folder.run).path == RunFolder.find(str(folder.path)).path == folder.path
    for wrong in (str(tmp_path), "no-such-run"):
        with pytest.raises(RunFolderError, match="is not the folder of a run"):
            RunFolder.find(wrong)


def test_a_folder_with_something_in_it_is_not_taken(
    folder: RunFolder, tmp_path: Path, settings: RunSettings
) -> None:
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.txt").write_text("mine")
    with pytest.raises(RunFolderError, match="is not empty"):
        RunFolder.create(settings, tmp_path / "full", [])
    with pytest.raises(RunFolderError, match="--resume"):
        RunFolder.create(settings, folder.path, [])
    assert RunFolder.create(settings, tmp_path / "new", []).run.startswith("cuboid-")


def test_a_folder_that_cannot_be_made_is_a_storage_error(tmp_path: Path, settings: RunSettings) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError, match="cannot write"):
        RunFolder.create(settings, tmp_path / "file" / "run", [])


def test_one_launcher_at_a_time(folder: RunFolder) -> None:
    assert running() == []
    with folder.locked():
        assert folder.in_use()
        assert [run.run for run in running()] == [folder.run]
        with pytest.raises(RunFolderError, match="is going on in another process"), folder.locked():
            pytest.fail("two launchers hold one folder")
    assert not folder.in_use()


def test_a_line_of_scores_that_is_being_written_is_left_out(folder: RunFolder) -> None:
    assert folder.scores() == []
    (folder.path / "scores.jsonl").write_bytes(b'{"iteration":0}\n{"iteration":1}\n{"itera')
    assert folder.scores() == [{"iteration": 0}, {"iteration": 1}]


def test_only_a_completed_run_has_a_result(folder: RunFolder) -> None:
    assert folder.result() == {}
    folder.finish({"scores_secs": 1.5})
    assert folder.result() == {"scores_secs": 1.5}
    (folder.path / "result.json").write_text("{")
    with pytest.raises(RunFolderError, match=r"result\.json"):
        folder.result()


def test_who_looks_whether_a_run_goes_on_is_in_nobodys_way(folder: RunFolder) -> None:
    with folder.locked():
        pass
    looking = os.open(folder.path / "lock", os.O_RDONLY)
    fcntl.flock(looking, fcntl.LOCK_SH)
    assert not folder.in_use(), "somebody else only looks"
    done = threading.Timer(0.05, os.close, [looking])
    done.start()
    with folder.locked():
        assert folder.in_use()
    done.join()


def test_what_goes_wrong_while_a_folder_is_held_is_not_taken_for_another_launcher(folder: RunFolder) -> None:
    with pytest.raises(BlockingIOError, match="the terminal"), folder.locked():
        raise BlockingIOError("the terminal takes no more")


def test_a_damaged_folder_does_not_hide_the_run_that_goes_on(folder: RunFolder) -> None:
    for name, record in (("a", "{"), ("b", '{"run": "b"}')):
        (folder.path.parent / name).mkdir()
        (folder.path.parent / name / "run.json").write_text(record)
    (folder.path.parent / "a" / "config.toml").write_text("")
    with folder.locked():
        assert [run.run for run in running()] == [folder.run]


def test_the_addresses_go_when_nobody_is_there_any_more(folder: RunFolder) -> None:
    folder.note_endpoint("tcp/127.0.0.1:7447")
    folder.note_dashboard("http://127.0.0.1:9090")
    assert (folder.endpoint(), folder.dashboard()) == ("tcp/127.0.0.1:7447", "http://127.0.0.1:9090")
    folder.forget_addresses()
    folder.forget_addresses()
    assert folder.dashboard() == ""
    with pytest.raises(RunFolderError, match="--connect"):
        folder.endpoint()


def test_damaged_milestones_are_left_out(folder: RunFolder) -> None:
    (folder.path / "events.jsonl").write_text('{"text": "good"}\n3\nrubbish\n{"text": "half')
    assert folder.events(5) == [{"text": "good"}]
