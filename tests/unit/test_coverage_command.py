"""`babble coverage` and the refusals of `babble study`, as a person sees them."""

import json
from pathlib import Path

import pytest

from services.launcher import cli
from services.launcher.run_folder import RunFolder
from services.launcher.study_folder import STATES
from tests.unit.study_stage import base, coverage, lay, measurement, plan_of


def said(capsys: pytest.CaptureFixture[str], *arguments: str | Path) -> tuple[int, str, str]:
    """Exit code, output and errors of a command."""
    try:
        code = cli.main([str(each) for each in arguments])
    except SystemExit as end:
        code = int(str(end.code))
    out, err = capsys.readouterr()
    return code, out, err


def test_the_table_of_a_study_beside_the_thesis_says_what_is_missing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    conditions = [
        {"id": "A", "title": "still", "thesis": {"diameter": [12.0, 1.0]}},
        {"id": "B", "title": "lively"},
    ]
    lay(tmp_path / "s", plan_of(condition=conditions), {"A": {0: measurement(coverage(diameter=10.0))}})
    code, out, _ = said(capsys, "coverage", "--table1", "--folder", tmp_path / "s")
    assert code == 0
    (row,) = [line for line in out.splitlines() if line.startswith("A still")]
    assert row.split()[2:6] == ["10.0", "12.0", "±", "1.0"]
    assert "missing: B-seed0, A-seed1, B-seed1" in out
    _, out, _ = said(capsys, "coverage", "--table1", "--folder", tmp_path / "s", "--json")
    assert json.loads(out)["conditions"]["A"]["diameter"]["seeds"] == {"0": 10.0}


def test_of_a_run_whose_states_went_what_was_measured_is_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lay(tmp_path / "s", plan_of("A"), {"A": {0: measurement(coverage(diameter=12.5))}})
    run = tmp_path / "s" / "A-seed0"
    code, out, _ = said(capsys, "coverage", run)
    assert code == 0
    assert "as measured before its states went" in out
    assert next(line for line in out.splitlines() if line.startswith("diameter")).split()[1] == "12.5"
    _, out, _ = said(capsys, "coverage", run, "--json", "--steps", "100")
    assert json.loads(out)["diameter"] == 6.25
    code, _, err = said(capsys, "coverage", run, "--steps", "77")
    assert (code, err.count("\n")) == (2, 1)
    assert "it was measured after 100, 1,000 steps only" in err


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("coverage",), "give the run to measure"),
        (("coverage", "RUN", "--table1"), "leave out RUN"),
        (("coverage", "--table1", "--folder", "nowhere"), "nowhere is not the folder of a study"),
        (("coverage", "RUN"), "has no recorded states"),
        (("study", "nothing"), "there is no study 'nothing'"),
        (("study", "cuboid"), "is a scenario, not a study; train it with `babble up`"),
        (("study", "table1", "--seeds", "2-1"), "seeds are such as 0-2 or 0,3,7"),
        (("study", "table1", "--only", "C9"), "has no condition 'C9'"),
        (("study", "table1", "--steps", "0"), "--steps"),
        (("study", "table1", "--report-only", "--folder", "nowhere"), "is not the folder of a study"),
    ],
)
def test_what_is_wrong_is_one_sentence_and_code_2(
    arguments: tuple[str, ...], words: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = RunFolder.create(base(), tmp_path / "run", ["babble"])
    given = [str(run.path) if each == "RUN" else each for each in arguments]
    code, _, err = said(capsys, *given)
    assert code == 2
    assert words in err
    assert err.count("\n") == 1
    assert not (run.path / STATES).exists()
