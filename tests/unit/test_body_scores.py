"""What people are told of bodies that are no points: landmarks, rewards, pictures of postures."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from babble.worlds import WORLDS, WorldEntry
from services.launcher import posture_figures, worlds_command
from services.launcher.cli import main
from services.launcher.evaluate import RunError, evaluate, measures, open_run, shortfalls
from services.launcher.figures import Ends
from services.launcher.lines import score_table, score_words
from services.launcher.report import write_report
from tests.simulated.episodic import EpisodicWorld
from tests.unit.analytic_run import encoder, policy, write_run

SIDES = {"body": (encoder([3.0, 0.0]), policy([1.0]))}
"""Goal 0 leads to the right, goal 1 to the left."""


@pytest.fixture(autouse=True)
def _episodic(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(WORLDS, "Episodic", WorldEntry("Episodic", "a line", "2", "tests.simulated.episodic"))


def run_in(folder: Path, settings: str = "", **parameters: Any) -> Path:
    written = write_run(folder, [SIDES], world="Episodic", settings=settings)
    (written / "config.toml").write_text(
        f'scenario = "analytic"\n{settings}\n[world]\nid = "Episodic"\n[world.parameters]\n'
        + "".join(f"{name} = {value}\n" for name, value in parameters.items())
    )
    rows = [json.loads(line) for line in (written / "scores.jsonl").read_text().splitlines()]
    found = {"landmarks": {"left": 0.97, "right": 1.0}, "landmark_vertices": {"left": 1, "right": 0}}
    (written / "scores.jsonl").write_text("".join(json.dumps(row | found) + "\n" for row in rows))
    return written


def test_landmarks_are_asked_for_instead_of_separation(tmp_path: Path) -> None:
    run = open_run(run_in(tmp_path / "run"))
    (row,) = evaluate(run, [run.version("body")], columns=8, modes=["mean"])
    assert measures(row) == {"z_min": pytest.approx(row.z_min), "left": 1.0, "right": 1.0}
    assert row.landmark_vertices == {"left": 1, "right": 0}
    assert shortfalls(row.model_copy(update={"separation": 0.1})) == []
    assert shortfalls(row.model_copy(update={"landmarks": {"left": 1.0, "right": 0.5}})) == [
        "right 0.50 < 0.9"
    ]


def test_the_tasks_own_reward_is_measured_without_any_weight(tmp_path: Path) -> None:
    run = open_run(run_in(tmp_path / "run"))
    (row,) = evaluate(run, [run.version("body")], columns=8, modes=["mean"])
    assert row.external_reward_by_vertex == pytest.approx([1.0, -1.0], abs=0.01)


def test_the_table_has_a_column_for_each_landmark_and_the_reward(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(run_in(tmp_path / "run")), "--columns", "8"]) == 0
    text = capsys.readouterr().out
    head = next(line for line in text.splitlines() if line.strip().startswith("iter"))
    assert head.split()[-3:] == ["left", "right", "reward"]
    assert "reached: z_min, left, right >= 0.9; left is goal 1; right is goal 0" in text
    assert "left, right: share of legs" in text
    assert max(len(line) for line in text.splitlines() if line.strip()[:1].isdigit()) <= 80


def test_json_has_the_landmarks_with_their_vertices(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(run_in(tmp_path / "run")), "--columns", "8", "--json"]) == 0
    row = json.loads(capsys.readouterr().out.splitlines()[0])
    assert row["landmarks"] == {"left": 1.0, "right": 1.0}
    assert row["landmark_vertices"] == {"left": 1, "right": 0}


def test_a_simulation_that_breaks_down_all_the_time_is_a_sentence(tmp_path: Path) -> None:
    run = open_run(run_in(tmp_path / "run", fails_every=50))
    with pytest.raises(
        RunError, match=r"run cannot be rolled out: the simulation of Episodic broke down 20 times"
    ):
        evaluate(run, [run.version("body")], columns=2)


def test_a_control_that_breaks_down_all_the_time_is_a_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = run_in(tmp_path / "run", settings="[phases]\nbabble_steps = 64", fails_every=50)
    assert main(["score", str(folder), "--control"]) == 2
    said = capsys.readouterr().err
    assert "the control of " in said
    assert "cannot be trained here: the simulation of Episodic broke down 20 times in a row" in said
    assert len(said.splitlines()) == 1


@pytest.mark.parametrize("where", ["score", "report", "control"])
def test_a_sense_without_a_renderer_is_a_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], where: str
) -> None:
    def blind(*_: object) -> None:
        raise ValueError("there is no OpenGL here; install libosmesa6")

    folder = run_in(tmp_path / "run")
    monkeypatch.setattr(EpisodicWorld, "reset", blind)
    if where != "report":
        assert main(["score", str(folder), *(["--control"] if where == "control" else [])]) == 2
        said = capsys.readouterr().err
        assert len(said.splitlines()) == 1
    else:
        said = write_report(folder).read_text()
    cannot = "trained" if where == "control" else "rolled out"
    assert f"cannot be {cannot} here: there is no OpenGL here; install libosmesa6" in said


ROW = {
    "block": "body", "iteration": 3, "policy": "mean", "separation": 0.5, "z_min": 0.95, "z_goal": 0.97,
    "switch_success": 1.0, "crossing": None, "landmarks": {"open": 1.0, "closed": 0.75},
    "external_reward": -0.25,
}  # fmt: skip


def test_the_live_view_shows_the_landmark_that_is_worst_and_a_plain_line_shows_each() -> None:
    head, line = score_table([ROW])
    assert head.split()[-2:] == ["landmark", "reward"]
    assert line.split()[-2:] == ["0.750", "-0.250"]
    assert max(map(len, score_table([ROW]))) <= 60
    assert score_words(ROW).endswith("switch 1.000, reward -0.250, open 1.000, closed 0.750")
    assert "landmark" not in score_table([{**ROW, "landmarks": {}}])[0]


def pictures(folder: Path) -> tuple[str, dict[str, np.ndarray]]:
    text = write_report(folder).read_text()
    shown = {name: imread(folder / name) for name in re.findall(r"\]\((figures/[^)]+)\)", text)}
    for name, picture in shown.items():
        assert picture.shape[1] <= 1400
        assert np.ptp(picture[..., 0]) > 0.5, f"{name} is empty"
    return text, shown


def test_a_report_says_and_draws_where_the_joints_end(tmp_path: Path) -> None:
    text, shown = pictures(run_in(tmp_path / "run"))
    assert "**The postures left and right were found.**" in text
    assert "left 0.97, right 1.00, mean actions" in text
    assert "success is z_min and each of left, right of 0.9" in text
    assert "goal 0 is the posture right: 100% of its legs end there" in text
    assert "goal 0 ends at (1.00) (-1 and 1 are the joints' limits)" in text
    assert "the task's own reward per step is" in text
    drawn = {f"figures/body-{name}.png" for name in ("map", "postures", "way", "learning")}
    assert set(shown) == {"figures/timeline.png"} | drawn


def test_joints_are_called_by_their_names(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(EpisodicWorld, "posture_names", ("elbow",))
    assert "goal 0 ends at elbow 1.00" in pictures(run_in(tmp_path / "run"))[0]


@pytest.mark.parametrize("joints", [1, 14, 49])
@pytest.mark.parametrize("vertices", [2, 8])
def test_any_number_of_joints_and_vertices_is_drawn(tmp_path: Path, joints: int, vertices: int) -> None:
    rng = np.random.default_rng(0)
    goal = rng.integers(0, vertices - 1, 60)  # the last vertex was never a goal
    ends = Ends(
        goal=goal,
        posture=rng.uniform(-1, 1, (60, joints)),
        way=rng.uniform(-1, 1, (60, 5, joints)),
        first_goal=goal[:15],
        first_way=rng.uniform(-1, 1, (15, 5, joints)),
        latent_dim=vertices,
    )
    names = [f"robot:right_hand_joint_with_a_long_name_{joint}" for joint in range(joints)]
    path = tmp_path / "postures.png"
    for known in ([], names):
        posture_figures.draw_postures(path, ends, known, "a body")
        picture = imread(path)
        assert picture.shape[1] <= 1400
        assert np.ptp(picture[..., 0]) > 0.5


def test_worlds_that_cannot_be_built_as_they_are_are_listed_all_the_same(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    few = {name: WORLDS[name] for name in ("Cuboid", "Episodic", "Mjcf")}
    monkeypatch.setattr(worlds_command, "WORLDS", few)
    assert main(["worlds"]) == 0
    text = capsys.readouterr().out
    assert "half_sizes = [1.0, 0.6, 0.3]" in text
    assert "landmarks   left, right" in text
    assert "Mjcf: any MuJoCo model file" in text
    assert "cannot be built: " in text
    assert max(map(len, text.splitlines())) <= 100
