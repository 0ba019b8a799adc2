"""`babble view`: what becomes of its arguments, and what it refuses."""

import argparse
import sys
from pathlib import Path

import pytest

from services.dashboard.replay import _parse as parse_of_the_replay
from services.launcher import view_command
from services.launcher.run_folder import RunFolderError
from services.runtime.errors import UserError


class Became(Exception):
    """What the process would be from now on."""


@pytest.fixture
def run_dir(tmp_path: Path) -> Path:
    """The least that is a run's folder."""
    (tmp_path / "run.json").write_text('{"run": "cuboid-1"}')
    (tmp_path / "config.toml").write_text("")
    return tmp_path


def view(monkeypatch: pytest.MonkeyPatch, *given: str) -> list[str]:
    """The command line of the process that `babble view` becomes."""

    def become(program: str, arguments: list[str]) -> None:
        assert program == sys.executable
        raise Became(arguments)

    monkeypatch.setattr(view_command.os, "execv", become)
    parser = argparse.ArgumentParser()
    view_command.add_arguments(parser)
    with pytest.raises(Became) as became:
        view_command.run(parser.parse_args(given))
    return list(became.value.args[0])


def test_it_becomes_the_replay_of_the_run(monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> None:
    program, *module, _, folder = view(monkeypatch, str(run_dir))[:5]
    assert (program, module, folder) == (sys.executable, ["-m", view_command.REPLAY], str(run_dir))


def test_the_replay_understands_every_option(monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> None:
    given = ["--port", "8000", "--bind", "0.0.0.0", "--allow-origin", "lab", "--allow-origin", "http://b:1"]
    understood = parse_of_the_replay(view(monkeypatch, str(run_dir), "--no-browser", *given)[3:])
    assert understood.run_dir == run_dir
    assert (understood.port, understood.bind) == (8000, "0.0.0.0")
    assert understood.allow_origin == ["lab", "http://b:1"]
    assert (understood.browser, understood.native) == (False, False)
    understood = parse_of_the_replay(view(monkeypatch, str(run_dir), "--native")[3:])
    assert (understood.browser, understood.native, understood.port) == (True, True, None)


def test_a_run_that_is_none_is_refused(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunFolderError, match="'nothing' is not the folder of a run"):
        view(monkeypatch, "nothing")


def test_without_rerun_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch, run_dir: Path) -> None:
    monkeypatch.setattr(view_command, "find_spec", lambda name: None)
    with pytest.raises(UserError, match="--extra dashboard"):
        view(monkeypatch, str(run_dir))


@pytest.mark.parametrize("port", ["0", "70000", "x", "-1"])
def test_a_port_that_is_none_is_refused(
    monkeypatch: pytest.MonkeyPatch, run_dir: Path, port: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        view(monkeypatch, str(run_dir), f"--port={port}")
    assert "must be a port" in capsys.readouterr().err
