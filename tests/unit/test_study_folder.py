"""A study's folder: who may use it, what is done in it, and its report."""

import json
import re
from pathlib import Path

import pytest

from services.launcher.run_folder import RunFolder
from services.launcher.study_folder import STATES, StudyFolder
from services.launcher.study_measurement import FILE, MeasurementError, read_measurement
from services.launcher.study_plan import StudyError, runs_of
from services.launcher.study_queue import Stage
from services.launcher.study_report import write_study_report
from services.launcher.study_runs import LocalWorkshop, training_arguments
from tests.unit.study_stage import base, coverage, lay, measurement, plan_of


def test_how_far_a_run_is_lies_in_its_folder(tmp_path: Path) -> None:
    plan = plan_of("A", seeds=[0])
    (run,) = runs_of(plan, base(), steps=1000, seeds=[0])
    folder = lay(tmp_path / "s", plan, {})
    assert folder.stage(run) is Stage.WAITING
    assert training_arguments(folder, run)[-2:] == ["--run-dir", str(tmp_path / "s" / "A-seed0")]
    begun = RunFolder.create(run.settings, folder.run_path(run), ["babble"])
    assert folder.stage(run) is Stage.WAITING
    assert training_arguments(folder, run)[-2:] == ["--resume", str(tmp_path / "s" / "A-seed0")]
    begun.finish({"scores_secs": 1.0})
    assert folder.stage(run) is Stage.TRAINED
    measurement().write(folder.run_path(run))
    assert folder.stage(run) is Stage.DONE


def test_a_measurement_of_other_steps_or_of_another_version_is_made_anew_while_there_are_states(
    tmp_path: Path,
) -> None:
    plan = plan_of("A", seeds=[0])
    (run,) = runs_of(plan, base(), steps=1000, seeds=[0])
    folder = lay(tmp_path / "s", plan, {"A": {0: measurement(coverage(rows=500))}})
    assert folder.stage(run) is Stage.TRAINED
    (folder.run_path(run) / FILE).write_text('{"format": 1}')
    with pytest.raises(MeasurementError, match="delete it to measure the run anew"):
        folder.stage(run)
    (folder.run_path(run) / STATES).mkdir()
    assert folder.stage(run) is Stage.TRAINED


def test_a_measurement_reads_as_it_was_written(tmp_path: Path) -> None:
    written = measurement()
    written.write(tmp_path)
    assert read_measurement(tmp_path) == written
    assert read_measurement(tmp_path / "elsewhere") is None


def test_a_run_with_other_settings_is_refused_but_more_actors_are_the_same_run(tmp_path: Path) -> None:
    plan = plan_of("A", seeds=[0])
    folder = lay(tmp_path / "s", plan, {"A": {0: measurement()}})
    folder.prepare(plan, runs_of(plan, base(), steps=1000, seeds=[0], actors=7), 1000)
    with pytest.raises(StudyError, match=r"A-seed0 was begun with other settings \(phases\..*--folder"):
        folder.prepare(plan, runs_of(plan, base(), steps=50_000, seeds=[0]), 50_000)


def test_a_folder_that_was_killed_while_it_was_made_is_begun_anew(tmp_path: Path) -> None:
    plan = plan_of("A", seeds=[0])
    torn = tmp_path / "s" / "A-seed0"
    torn.mkdir(parents=True)
    (torn / "config.toml").write_text("")
    (torn / ".run.json.17.draft").write_text("")
    lay(tmp_path / "s", plan, {})
    assert not torn.exists()


def test_what_somebody_else_keeps_in_a_runs_place_is_left_alone(tmp_path: Path) -> None:
    other = tmp_path / "s" / "A-seed0"
    other.mkdir(parents=True)
    (other / "thesis.pdf").write_text("mine")
    lay(tmp_path / "s", plan_of("A", seeds=[0]), {})
    assert (other / "thesis.pdf").read_text() == "mine"


def test_two_studies_do_not_share_a_folder(tmp_path: Path) -> None:
    folder, other = StudyFolder(tmp_path / "s"), StudyFolder(tmp_path / "s")
    with (
        folder.locked(),
        pytest.raises(StudyError, match="going on in another process"),
        other.locked(),
    ):
        pass
    with other.locked():
        pass


def test_more_seeds_and_fewer_conditions_leave_the_rest_of_the_study_known(tmp_path: Path) -> None:
    plan = plan_of("A", "B")
    folder = lay(tmp_path / "s", plan, {"A": {0: measurement()}})
    folder.prepare(plan, runs_of(plan, base(), steps=1000, seeds=[4], only=["B"]), 1000)
    assert folder.plan()[2] == [0, 1, 4]
    assert folder.missing() == ["B-seed0", "A-seed1", "B-seed1", "A-seed4", "B-seed4"]
    assert set(folder.measurements()) == {"A"}


def test_states_go_only_once_a_run_is_measured_and_only_if_asked(tmp_path: Path) -> None:
    plan = plan_of("A", seeds=[0])
    (run,) = runs_of(plan, base(), steps=1000, seeds=[0])
    folder = lay(tmp_path / "s", plan, {"A": {0: measurement()}})
    states = folder.run_path(run) / STATES
    states.mkdir()
    LocalWorkshop(folder, discard_states=False).put_away(run)
    assert states.exists()
    LocalWorkshop(folder, discard_states=True).put_away(run)
    assert not states.exists()
    assert folder.stage(run) is Stage.DONE


def test_why_a_run_failed_is_the_sentence_that_it_ended_with(tmp_path: Path) -> None:
    plan = plan_of("A", seeds=[0])
    (run,) = runs_of(plan, base(), steps=1000, seeds=[0])
    folder = lay(tmp_path / "s", plan, {})
    workshop = LocalWorkshop(folder, discard_states=False)
    assert workshop.last_words(run) == ""
    folder.log_path(run).parent.mkdir()
    folder.log_path(run).write_text("one\nbabble up: the disk is full\nstopped; go on with: babble up\n\n")
    assert workshop.last_words(run) == "babble up: the disk is full"
    folder.log_path(run).write_text("one\ntwo\n")
    assert workshop.last_words(run) == "two"


def test_the_report_of_a_part_names_what_is_missing_and_links_only_what_is_there(tmp_path: Path) -> None:
    conditions = [
        {"id": "A", "title": "still", "thesis": {"diameter": [12.0, 1.0], "participation_ratio": [3.1, 0.1]}},
        {"id": "B", "title": "lively", "thesis": {"diameter": [24.0, 1.0]}},
        {"id": "C", "title": "not yet"},
    ]
    plan = plan_of(condition=conditions, notes=["a choice of ours"])
    done = {
        "A": {0: measurement(), 1: measurement(coverage(diameter=11.0))},
        "B": {0: measurement(coverage(diameter=30.0))},
    }
    folder = lay(tmp_path / "s", plan, done)
    report = write_study_report(folder, tmp_path / "r").read_text()
    assert "**Missing: C-seed0, B-seed1, C-seed1.**" in report
    assert "| **A** still | 2 | 10.5 ± 0.7 | 12.0 ± 1.0 |" in report
    assert "a choice of ours" in report
    assert "3 of 6 runs are done" in report
    links = re.findall(r"\]\(([^)]+)\)", report)
    assert len(links) >= 5
    assert all((tmp_path / "r" / link).is_file() for link in links)
    assert str(tmp_path) not in report
    runs = json.loads((tmp_path / "r" / "numbers.json").read_text())["runs"]
    assert [(each["condition"], each["seed"]) for each in runs] == [("A", 0), ("A", 1), ("B", 0)]


def test_nothing_done_is_nothing_to_report(tmp_path: Path) -> None:
    folder = lay(tmp_path / "s", plan_of("A"), {})
    with pytest.raises(StudyError, match="nothing to report"):
        write_study_report(folder, tmp_path / "r")
