"""A report says what was found, in words and pictures, for finished, unfinished and unusual runs."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread, imsave

from services.launcher import figures, learning_figure, timeline_figure
from services.launcher.report import write_report
from services.launcher.run_folder import RunFolder
from services.runtime.errors import UserError
from tests.unit.analytic_run import encoder, face, flat, good, policy, write_run

D3 = '[[block]]\nname = "body"\nlatent_dim = 3\n[encoder]\nlearning_rate = 0.002'


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures take a second, and many tests are about the words."""

    def blank(path: Path, *_: object) -> None:
        path.parent.mkdir(exist_ok=True)
        imsave(path, np.eye(8))

    drawn = {figures: ("draw_world", "draw_latent"), learning_figure: ("draw_learning",)}
    for module, names in {**drawn, timeline_figure: ("draw_timeline",)}.items():
        for name in names:
            monkeypatch.setattr(module, name, blank)


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
    shown = {"body-world", "body-latent", "body-learning", "timeline"}
    assert {path.stem for path in (tmp_path / "run/figures").iterdir()} == shown
    assert text.count("](figures/") == 4
    assert "unfinished" not in text
    assert "Not everything could be read" not in text


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


@pytest.mark.parametrize("vertices", [3, 9])
def test_any_number_of_vertices_is_drawn(tmp_path: Path, vertices: int) -> None:
    models = (
        encoder((1.0, 0.6, 0.3), latent_dim=vertices),
        policy((1.0, 1.0, 1.0), latent_dim=vertices),
    )
    settings = D3.replace("= 3", f"= {vertices}")
    text = report_of(write_run(tmp_path / "run", [{"body": models}], settings=settings))
    assert text.count("ends at") == vertices
    assert text.count("](figures/") == 4


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
    assert "no losses: there are none in metrics.jsonl" in narrow
    width = imread(folder / "figures/body-learning.png").shape[1]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in LOSSES) + '{"now_')
    assert "what the learners measured, over the time" in report_of(folder)
    assert imread(folder / "figures/body-learning.png").shape[1] > width


LOSSES = [
    {
        "now_secs": 101.0 + second,
        "term": 2,
        "phase": "encode",
        "service": "encoder_learner",
        "metrics": {"body/encoder/loss": 4.0 - second, "body/encoder/alignment": 0.1 * second},
    }
    for second in range(3)
]


@pytest.mark.usefixtures("undrawn")
def test_without_rollouts_there_are_the_scores_but_not_the_places(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    (folder / "models/body/policy-10.onnx").unlink()
    text = write_report(folder, rollouts=False).read_text()
    assert "The saved models were not rolled out here; `babble report" in text
    assert "**Both ends of the long diagonal were found.**" in text
    assert "| 0 (best) | ground | mean | 0.950 |" in text
    assert "ends at" not in text
    assert "body-world" not in text


def test_what_was_learned_before_the_first_evaluation_is_drawn(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [], phase="encode (level 0, iteration 0, term 2)")
    (folder / "metrics.jsonl").write_text("".join(json.dumps(line) + "\n" for line in LOSSES))
    text = report_of(folder)
    assert "Nothing has been evaluated yet" in text
    assert "![What the learners measured of block body.](figures/body-learning.png)" in text
    assert "figures/timeline.png" in text


@pytest.mark.usefixtures("undrawn")
def test_a_run_that_goes_on_is_not_called_unfinished(tmp_path: Path) -> None:
    phase = "walk (level 0, iteration 2, term 12)"
    folder = write_run(tmp_path / "run", [good()], phase=phase)
    with RunFolder.find(str(folder)).locked():
        text = report_of(folder)
    assert f"**This run is still going on**: its phase is {phase}." in text
    assert "unfinished" not in text


@pytest.mark.usefixtures("undrawn")
def test_damaged_files_are_named_and_the_rest_is_told(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good(), flat()])
    lines = (folder / "scores.jsonl").read_text().splitlines(keepends=True)
    (folder / "scores.jsonl").write_text(lines[0] + "rubbish\n" + '{"run": "x"}\n' + "".join(lines[2:]) + "{")
    (folder / "best.json").write_text('{"body":')
    (folder / "result.json").write_text("[1]")
    (folder / "metrics.jsonl").write_bytes(b"\xff\xfe\n[]\n" + json.dumps({"now_secs": "x"}).encode() + b"\n")
    with (folder / "events.jsonl").open("a") as events:
        events.write('{"secs": 1e999, "what": "phase", "text": "done"}\n{"secs":')
    text = report_of(folder)
    assert "1 line of `scores.jsonl` could not be read and were left out." in text
    assert "1 of the records in `scores.jsonl` are no scores of this run" in text
    assert "2 lines of `metrics.jsonl` could not be read" in text
    assert "best.json is damaged" in text
    assert "`result.json` holds no table and is left out." in text
    assert text.count("| 1 | practise |") == 2
    assert text.count("| 0 | ground |") == 1


@pytest.mark.usefixtures("undrawn")
def test_a_best_iteration_without_scores_is_said(tmp_path: Path) -> None:
    text = report_of(write_run(tmp_path / "run", [good()], best=7))
    assert "What is kept is not known here: " in text
    assert "has no iteration 7 of block body; it has 0." in text
    assert "**Both ends of the long diagonal were found.** The newest iteration is 0" in text


@pytest.mark.usefixtures("undrawn")
def test_resumes_and_waits_are_said(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    babble = "babble (level 0, iteration 0, term 1)"
    told = [(100.0, "phase", babble), (102.0, "end", "stopped"), (902.0, "phase", babble)]
    told += [(903.5, "stalled", "nobody"), (905.0, "phase", "encode (level 0, iteration 0, term 2)")]
    lines = [json.dumps({"secs": secs, "what": what, "text": text}) for secs, what, text in told]
    (folder / "events.jsonl").write_text("\n".join(lines) + "\n")
    text = report_of(folder)
    assert "| babble | 2 | 5.0 | 20,000 |" in text
    assert "It was resumed once; the 800 s in between are left out. It stalled once;" in text
    assert "waiting included: 5.0 s for processes that were not there." in text


@pytest.mark.parametrize("damage", ["no folder", "settings"])
def test_what_is_no_run_is_one_sentence(tmp_path: Path, damage: str) -> None:
    folder = tmp_path / "run"
    if damage == "settings":
        write_run(folder, [good()])
        (folder / "config.toml").write_text("world = [")
    with pytest.raises(UserError) as refused:
        write_report(folder)
    assert str(refused.value).count("\n") == 0
