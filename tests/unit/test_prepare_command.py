"""`babble prepare`: the run's folder is made once, and found again or refused later."""

import json
import os
from collections.abc import Callable
from pathlib import Path

import pytest

from services.launcher.cli import main
from services.launcher.run_folder import RunFolder

TINY = 'scenario = "tiny"\n[phases]\nwalk_steps = 2048\n'
Prepare = Callable[..., tuple[int, str]]


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    (tmp_path / "tiny.toml").write_text(TINY)
    return tmp_path / "runs"


@pytest.fixture
def prepare(runs: Path, capsys: pytest.CaptureFixture[str]) -> Prepare:
    """Runs the command for the scenario tiny, and says its code and its one sentence."""

    def ask(*more: str, run: str = "mine", scenario: str = "") -> tuple[int, str]:
        path = scenario or str(runs.parent / "tiny.toml")
        try:
            code = main(["prepare", path, "--run", run, "--runs", str(runs), *more])
        except SystemExit as ended:
            code = int(str(ended.code))
        said = capsys.readouterr()
        words = said.err if code else said.out
        assert words.count("\n") == 1, words
        return code, words.strip()

    return ask


def test_it_makes_a_run_of_that_name(prepare: Prepare, runs: Path) -> None:
    code, words = prepare("--seed", "7", "--actors", "5")
    assert (code, words) == (0, f"made the run mine in {runs}/mine: scenario tiny, seed 7")
    folder = RunFolder.find(str(runs / "mine"))
    assert folder.run == "mine"
    assert (folder.settings().seed, folder.settings().actors.count) == (7, 5)
    assert json.loads((folder.path / "run.json").read_text())["run"] == "mine"


def test_an_empty_number_is_none(prepare: Prepare, runs: Path) -> None:
    assert prepare("--seed", "", "--actors", "")[0] == 0
    assert RunFolder.find(str(runs / "mine")).settings().seed == 0
    code, words = prepare("--seed", "x")
    assert code == 2
    assert "--seed: must be a whole number of at least 0, got 'x'" in words


def test_a_run_that_is_there_goes_on_with_its_seed_and_nothing_is_changed(
    prepare: Prepare, runs: Path
) -> None:
    prepare("--seed", "7")
    before = {path.name: path.read_bytes() for path in (runs / "mine").iterdir()}
    assert prepare() == (0, f"the run mine in {runs}/mine goes on where it was (seed 7)")
    assert prepare("--seed", "7", "--actors", "9")[0] == 0, "how many actors there are may change at any time"
    assert {path.name: path.read_bytes() for path in (runs / "mine").iterdir()} == before


def test_another_run_of_that_name_is_refused_with_what_differs(prepare: Prepare, runs: Path) -> None:
    prepare("--seed", "7")
    code, words = prepare("--seed", "8")
    assert code == 2
    assert "seed is 7 there and 8 here; begin another run with another name (--run or BABBLE_RUN)" in words
    (runs.parent / "tiny.toml").write_text(TINY.replace("2048", "4096"))
    assert "phases.walk_steps is 2048 there and 4096 here" in prepare()[1]
    (runs.parent / "tiny.toml").write_text('scenario = "tiny"\n[[block]]\nname = "arm"\n')
    assert "block.1.name is body there and arm here" in prepare()[1]
    assert "scenario is tiny there and dumbbell here" in prepare(scenario="dumbbell")[1]


def test_a_completed_run_stays_as_it_is_and_another_name_is_proposed(prepare: Prepare, runs: Path) -> None:
    for name, another in (("mine", "mine-2"), ("mine-9", "mine-10"), ("m" * 64, f"{'m' * 60}-2")):
        prepare(run=name)
        done = {"secs": 5.0, "what": "phase", "text": "done (level 0, iteration 4, term 9)"}
        (runs / name / "events.jsonl").write_text(json.dumps(done) + "\n")
        code, words = prepare(run=name)
        assert code == 0
        assert f"is completed already; begin anew with another name: BABBLE_RUN={another} (or --run)" in words


def test_a_run_that_babble_up_looks_after_is_left_to_it(prepare: Prepare, runs: Path) -> None:
    prepare()
    with RunFolder.find(str(runs / "mine")).locked():
        code, words = prepare()
    assert code == 2
    assert "is going on in `babble up`" in words


@pytest.mark.parametrize("name", ["Mine", "a/b", "", "m" * 65])
def test_what_is_no_name_is_refused(prepare: Prepare, name: str) -> None:
    code, words = prepare(run=name)
    assert code == 2
    assert "1 to 64 of a-z, 0-9, - and _" in words


def test_a_scenario_that_is_none_is_refused_before_there_is_a_folder(prepare: Prepare, runs: Path) -> None:
    code, words = prepare(scenario="torus")
    assert code == 2
    assert "there is no scenario 'torus'" in words
    assert not runs.exists()


def test_what_is_in_the_way_is_named_and_left_alone(prepare: Prepare, runs: Path) -> None:
    (runs / "mine").mkdir(parents=True)
    (runs / "mine" / "thesis.txt").write_text("mine")
    assert "holds something, and no run; choose another name" in prepare()[1]
    (runs / "file").write_text("")
    assert f"{runs}/file is a file" in prepare(run="file")[1]
    prepare(run="first")
    (runs / "first").rename(runs / "moved")
    assert "holds the run first, which was moved there" in prepare(run="moved")[1]
    assert (runs / "mine" / "thesis.txt").read_text() == "mine"


def test_where_it_may_not_write_it_says_who_may_not_and_how_to_change_it(
    prepare: Prepare, runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs.mkdir()
    # Root may write anywhere, so the system's answer is made up.
    monkeypatch.setattr(os, "access", lambda path, mode: path != runs)
    monkeypatch.setattr(os, "getuid", lambda: 1000)
    code, words = prepare()
    assert code == 2
    assert f"user 1000 cannot write into {runs}, where {runs}/mine belongs" in words
    assert f"`chown -R 1000 {runs}`" in words
