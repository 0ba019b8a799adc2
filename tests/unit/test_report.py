"""A report says what was found, in words and pictures, for finished, unfinished and unusual runs."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread, imsave

from services.launcher import figures
from services.launcher.report import write_report
from tests.unit.analytic_run import encoder, face, flat, good, policy, write_run

D3 = '[[block]]\nname = "body"\nlatent_dim = 3\n[encoder]\nlearning_rate = 0.002'


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take a second, and many tests are about the words."""

    def blank(path: Path, *_: object) -> None:
        imsave(path, np.eye(8))

    for name in ("draw_world", "draw_latent", "draw_learning"):
        monkeypatch.setattr(figures, name, blank)


def report_of(folder: Path) -> str:
    """The text, after a check that every picture it shows is there and is one."""
    path = write_report(folder)
    assert path == folder / "report.md"
    text = path.read_text()
    for name in re.findall(r"\]\((figures/[^)]+)\)", text):
        picture = imread(folder / name)
        assert picture.shape[1] <= 1400
        assert np.ptp(picture[..., 0]) > 0.5, f"{name} is empty"
    return text


@pytest.mark.parametrize(
    ("world", "place", "ends"),
    [
        (
            "Cuboid",
            "Both ends of the long diagonal were found.",
            ("(1.00, 0.60, 0.30)", "(-1.00, -0.60, -0.30)"),
        ),
        ("Ellipsoid", "Both ends of the long axis were found.", ("(1.00, ", "(-1.00, ")),
        ("Dumbbell", "The outer ends of both lobes were found.", ("(1.40, ", "(-1.40, ")),
    ],
)
def test_success_is_said_with_the_places(
    tmp_path: Path, world: str, place: str, ends: tuple[str, str]
) -> None:
    text = report_of(write_run(tmp_path / "run", [good(world)], world=world))
    assert f"**{place}**" in text
    assert f"goal 0 ends at {ends[0]}" in text
    assert f"goal 1 ends at {ends[1]}" in text
    assert re.search(r"ends of goals 0 and 1 are \d\.\d\d apart: (99|100)% of the diameter", text)
    assert text.count("](figures/") == 3
    assert "unfinished" not in text


def test_drawn_ways_lead_from_end_to_end(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawn: list[figures.Ends] = []
    monkeypatch.setattr(figures, "draw_world", lambda path, body, ends, title: drawn.append(ends))
    write_report(write_run(tmp_path / "run", [good()]))
    (ends,) = drawn
    np.testing.assert_array_equal(ends.way[:, -1], ends.posture)
    # From the opposite corner, where the leg before ended.
    np.testing.assert_allclose(ends.way[:, 0], -ends.posture, atol=1e-6)
    assert np.ptp(ends.first_way[:, 0], axis=0).min() > 0.3


@pytest.mark.usefixtures("undrawn")
def test_failure_is_said_with_the_reason_and_where_the_goals_lead_instead(tmp_path: Path) -> None:
    text = report_of(write_run(tmp_path / "run", [good(), face()], best=1))
    assert "**Both ends of the long diagonal were not found: z_min 0.83 < 0.9.**" in text
    assert "83% of the diameter 2.41" in text
    assert "Scores of these rollouts: separation 0.83" in text


@pytest.mark.usefixtures("undrawn")
def test_scores_of_every_iteration_are_listed_and_the_best_is_marked(tmp_path: Path) -> None:
    text = report_of(write_run(tmp_path / "run", [good(), flat()]))
    table = [line for line in text.splitlines() if re.match(r"\| \d", line)]
    assert [line.split(" | ")[:3] for line in table] == [
        ["| 0 (best)", "ground", "mean"],
        ["| 0 (best)", "ground", "sampled"],
        ["| 1", "practise", "mean"],
        ["| 1", "practise", "sampled"],
    ]
    assert "0.950 | 0.910 | 0.830 | 0.980 | 1.000 |" in table[2]


@pytest.mark.usefixtures("undrawn")
def test_settings_times_and_origin_are_recorded(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()], settings="[encoder]\nlearning_rate = 0.002")
    (folder / "result.json").write_text(json.dumps({"cpu_secs": {"actor-0": 3.25, "launcher": 1.0}}))
    text = report_of(folder)
    assert "| `encoder.learning_rate` | `0.002` |" in text
    assert "`encoder.batch`" not in text
    assert "| babble | 1 | 3.5 | 20,000 |" in text
    assert "| actor-0 | 3.2 |" in text
    assert "| packages.numpy | `2` |" in text
    assert "babble score" in text


@pytest.mark.usefixtures("undrawn")
def test_parameters_of_the_world_count_as_settings_only_where_they_differ(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    world = '{ id = "Cuboid", parameters = { half_sizes = [1.0, 0.6, 0.3], speed = 0.05 } }'
    (folder / "config.toml").write_text(f'scenario = "a"\nworld = {world}')
    text = report_of(folder)
    assert "| `world.parameters.speed` | `0.05` |" in text
    assert "half_sizes" not in text


@pytest.mark.usefixtures("undrawn")
def test_an_unfinished_run_says_so_and_how_to_go_on(tmp_path: Path) -> None:
    phase = "walk (level 0, iteration 2, term 12)"
    text = report_of(write_run(tmp_path / "run", [good()], phase=phase))
    assert f"**This run is unfinished**: its last phase is {phase}. `babble up --resume" in text


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_has_just_begun_has_a_report_too(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [])
    for name in ("best.json", "scores.jsonl", "events.jsonl"):
        (folder / name).unlink()
    text = report_of(folder)
    assert "no phase has been announced yet" in text
    assert "Nothing has been evaluated yet" in text


def test_three_vertices_are_drawn_and_nine_are_not(tmp_path: Path) -> None:
    three = {"body": (encoder((1.0, 0.6, 0.3), latent_dim=3), policy((1.0, 1.0, 1.0), latent_dim=3))}
    text = report_of(write_run(tmp_path / "three", [three], settings=D3))
    assert text.count("ends at") == 3
    assert text.count("](figures/") == 3
    nine = {"body": (encoder((1.0, 0.6, 0.3), latent_dim=9), policy((1.0, 1.0, 1.0), latent_dim=9))}
    text = report_of(write_run(tmp_path / "nine", [nine], settings=D3.replace("= 3", "= 9")))
    assert "no drawing of 9 vertices" in text
    assert text.count("](figures/") == 1


@pytest.mark.usefixtures("undrawn")
def test_models_that_cannot_be_used_leave_the_scores_standing(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    (folder / "models/body/policy-10.onnx").write_bytes(b"torn")
    text = report_of(folder)
    assert "could not be rolled out" in text
    assert "policy-10.onnx cannot be used" in text
    assert "| 0 (best) | ground | mean | 0.950 |" in text


def test_losses_are_drawn_where_they_were_recorded(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    narrow = report_of(folder)
    assert "there is no metrics.jsonl" in narrow
    width = imread(folder / "figures/body-learning.png").shape[1]
    lines = [
        {"now_secs": 5.0 + i, "term": 2, "phase": "encode", "metrics": {"body/encoder/loss": 4.0 - i}}
        for i in range(3)
    ]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines) + '{"now_')
    assert "and the encoder's loss and the policy's reward" in report_of(folder)
    assert imread(folder / "figures/body-learning.png").shape[1] > width
