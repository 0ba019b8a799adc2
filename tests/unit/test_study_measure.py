"""What is measured of a run, and which run is not fit for it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from babble.coverage import twonn
from babble.recording import Audit
from services.launcher import study_measure
from services.launcher.run_folder import RunFolder
from services.launcher.study_measure import drawn_ratios, main
from services.launcher.study_measurement import read_measurement
from tests.unit.study_stage import base


class PlayedRecording:
    """Of one run: so many states, some of them twice."""

    state_names = ("position/a", "position/b", "velocity/a")
    duplicates = 0

    def __init__(self, rows: int) -> None:
        self.rows = rows

    @classmethod
    def open(cls, run_folder: Path) -> "PlayedRecording":
        return cls(500)

    def audit(self) -> Audit:
        return Audit(
            rows=self.rows, duplicates=self.duplicates, gaps=1, rows_by_phase={"walk": 500}, actors=("a",)
        )

    def states(self, *, most_rows: int) -> NDArray[Any]:
        rng = np.random.default_rng(0)
        return rng.normal(size=(self.rows, 3)).astype(np.float32)[:most_rows]


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder of a completed run."""
    monkeypatch.setattr(study_measure, "Recording", PlayedRecording)
    monkeypatch.setattr("babble.coverage_neighbours.likely_dimension", lambda distances: 3.0)
    monkeypatch.setattr(study_measure.os, "nice", lambda by: by)
    folder = RunFolder.create(base(), tmp_path / "run", ["babble"])
    folder.finish({"cpu_secs": {"actor-0": 2.0, "recorder": 1.5}})
    return folder.path


def test_the_first_rows_and_their_growing_parts_are_measured(run: Path) -> None:
    assert main([str(run), "--rows", "400", "--curve", "100"]) == 0
    found = read_measurement(run)
    assert found is not None
    assert (found.rows, found.recorded_rows, found.gaps, found.cpu_secs) == (400, 500, 1, 3.5)
    assert [each.rows for each in found.curve] == [100, 400]
    assert found.coverage == found.curve[-1]
    one, other = map(np.array, found.furthest)
    assert np.linalg.norm(one - other) == pytest.approx(found.coverage.diameter, rel=1e-5)


def test_rows_that_are_there_twice_or_missing_are_not_measured(
    run: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([str(run), "--rows", "501"]) == 2
    assert "has 500 rows, and 501 are to be measured" in capsys.readouterr().err
    monkeypatch.setattr(PlayedRecording, "duplicates", 3)
    assert main([str(run), "--rows", "400"]) == 2
    assert "has 3 rows twice" in capsys.readouterr().err
    assert read_measurement(run) is None


def test_the_drawn_ratios_lie_on_the_line_that_twonn_fits() -> None:
    states = np.random.default_rng(1).uniform(size=(3000, 2)).astype(np.float32)
    log_ratios, ranks = drawn_ratios(states)
    assert len(log_ratios) == len(ranks) <= 400
    assert list(log_ratios) == sorted(log_ratios)
    x, y = np.array(log_ratios), -np.log(1 - np.array(ranks))
    kept = np.array(ranks) < 0.9
    slope = float((x[kept] @ y[kept]) / (x[kept] @ x[kept]))
    everything = np.exp(np.interp((np.arange(3000) + 0.5) / 3000, ranks, log_ratios))
    assert slope == pytest.approx(twonn(everything), rel=0.03)
    assert slope == pytest.approx(2.0, rel=0.1)
