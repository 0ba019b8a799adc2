"""Scores, verdicts and reports of a tree: two parts of the cuboid, and a block that gives them goals."""

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from babble.onnx_model import Layer, PolicyWeights, policy_onnx
from services.launcher.child_ends import child_ends
from services.launcher.cli import main
from services.launcher.conclusion import print_scores
from services.launcher.evaluate import RunError, evaluate, latents_at, load_models, open_run, roll_out
from services.launcher.report import write_report
from services.launcher.report_levels import columns_of
from services.launcher.run_folder import RunFolder
from services.launcher.scalars import scalars
from services.runtime.sections import WorldSettings
from tests.unit.analytic_run import TREE, composed, encoder, parts, policy, write_run

SLOW = "[[level]]\n[[level]]\ndecision_steps = 5\n[level.evaluation]\nleg_steps = 50\n"
EVENTS = [
    (100.0, "babble (level 0, iteration 0, term 1)"),
    (102.0, "evaluate of ground (level 0, iteration 0, term 2)"),
    (104.0, "babble (level 1, iteration 0, term 3)"),
    (108.0, "evaluate of ground (level 1, iteration 0, term 4)"),
    (112.0, "done (level 1, iteration 0, term 5)"),
]


def tree(folder: Path, settings: str = "", **changed: tuple[bytes, bytes]) -> Path:
    """A run of both levels; `changed` are other models by block."""
    return write_run(folder, [{**parts(), **composed(), **changed}], settings=TREE + settings)


def lazy() -> tuple[bytes, bytes]:
    """Models of "body" that send x to its vertex 1, whatever the goal."""
    weight = np.zeros((4, 4), np.float32)
    weight[:, 2], weight[:, 3] = (0, 1, 1, -1), (0, 1, -1, 1)
    layers = [Layer(weight, np.zeros(4, np.float32))]
    still = policy_onnx(PolicyWeights(2, layers, np.zeros(4, np.float32)), "body")
    return encoder((1, -1, 1, -1), block="body"), still


def shown(folder: Path, *options: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert main(["score", str(folder), "--columns", "8", *options]) == 0
    return capsys.readouterr().out


def objects(text: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in text.splitlines()]


def test_a_block_is_scored_by_what_it_moves_and_the_one_above_by_all(tmp_path: Path) -> None:
    run = open_run(tree(tmp_path / "run"))
    assert run.levels == {0: ["x", "yz"], 1: ["body"]}
    x, yz = evaluate(run, [run.version("x"), run.version("yz")], columns=8, modes=["mean"])
    (body,) = evaluate(run, [run.version("body")], columns=8, modes=["mean"])
    assert [row.separation for row in (x, yz, body)] == pytest.approx([1, 1, 1], abs=1e-3)
    assert [row.z_min > 0.99 for row in (x, yz, body)] == [True, True, True]


def test_a_leg_is_as_long_in_environment_steps_however_long_an_action_is_held(tmp_path: Path) -> None:
    run = open_run(tree(tmp_path / "run", SLOW))
    version = run.version("body")
    rollout = roll_out(run, [version], {"body": load_models(run, version)}, columns=8)
    assert (rollout.leg_rows, rollout.env_steps_per_row) == (10, 5)
    assert rollout.scores()[0].steps == 8 * 5 * 50
    assert len(rollout.path) == 1 + 5 * 10
    assert rollout.arrived["body"].shape == (5, 8, 4)


def test_the_latent_of_a_block_with_children_is_that_of_their_latents(tmp_path: Path) -> None:
    run = open_run(tree(tmp_path / "run"))
    version = run.version("body")
    rollout = roll_out(run, [version], {"body": load_models(run, version)}, columns=8)
    legs = rollout.legs["body"]
    at_ends = latents_at(run.tree, rollout.models, "body", legs.posture[-1].astype(np.float32))
    np.testing.assert_allclose(at_ends, legs.latent[-1], atol=1e-5)


def test_goals_are_told_by_where_the_children_end(tmp_path: Path) -> None:
    run = open_run(tree(tmp_path / "run", body=lazy()))
    version = run.version("body")
    ends = child_ends(roll_out(run, [version], {"body": load_models(run, version)}, columns=8), version)
    assert ends is not None
    assert {goal: [end.vertex for end in row.values()] for goal, row in ends.goals.items()} == {
        0: [1, 0],
        1: [1, 1],
    }
    assert ends.differing == {(0, 1): ["yz"]}
    assert min(end.z for row in ends.goals.values() for end in row.values()) > 0.99


def test_score_shows_levels_postures_and_one_verdict_of_the_tree(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = shown(tree(tmp_path / "run", body=lazy()), capsys=capsys)
    assert re.findall(r"level \d, block \w+", text) == [
        "level 0, block x",
        "level 0, block yz",
        "level 1, block body",
    ]
    assert re.search(r"^x +1 \(1\.00\) +1 \(1\.00\)$", text, re.M)
    assert "goals 0 and 1 differ in 1 of 2 children; each child ends at a vertex (z >= 0.9) in 100%" in text
    assert re.search(
        r"^tree: 2 of 3 blocks reach their bars; not: body \(separation 0\.\d+ < 0\.9", text, re.M
    )


def test_score_says_how_long_legs_are_on_each_level(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    one = shown(tree(tmp_path / "one"), "--best", capsys=capsys).splitlines()[0]
    assert "starts, 5 legs of 100 steps, seed 0" in one
    slow = shown(tree(tmp_path / "slow", SLOW), "--best", capsys=capsys).splitlines()[0]
    assert "5 legs of 100 steps on level 0, 5 legs of 50 steps on level 1, seed 0" in slow


def test_json_has_rows_of_all_levels_and_an_object_of_goals(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = objects(shown(tree(tmp_path / "run"), "--best", "--json", capsys=capsys))
    rows, postures = ([each for each in found if ("goals" in each) is told] for told in (False, True))
    assert [(row["block"], row["policy"]) for row in rows[-2:]] == [("body", "mean"), ("body", "sampled")]
    (body,) = postures
    assert (body["block"], body["iteration"], body["policy"]) == ("body", 0, "mean")
    assert body["goals"][0]["children"]["yz"]["vertex"] == 0
    assert body["differing"] == [{"goals": [0, 1], "children": ["x", "yz"]}]


def test_children_act_as_they_are_kept(tmp_path: Path) -> None:
    """The second iteration of x is worthless: it is not the one that body moves it by."""
    worthless = (encoder([0.0], block="x"), policy([0.0], block="x"))
    models = [{**parts(), **composed()}, {**parts(), "x": worthless, **composed()}]
    run = open_run(write_run(tmp_path / "run", models, settings=TREE, best=0))
    (row,) = evaluate(run, [run.version("body", 1)], columns=8, modes=["mean"])
    assert row.separation > 0.99
    (x, _) = evaluate(run, [run.version("x", 1), run.version("yz", 1)], columns=8, modes=["mean"])
    assert x.separation < 0.9


def test_a_tree_whose_upper_level_has_not_begun_is_scored_as_far_as_it_is(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "run", [parts()], settings=TREE)
    text = shown(folder, capsys=capsys)
    assert "tree: 2 of 3 blocks reach their bars; not evaluated yet: body" in text
    assert "level 1" not in text


def test_an_iteration_that_not_all_blocks_of_a_level_have_is_left_out(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [parts(), {"x": parts()["x"]}], settings=TREE)
    found = [[(each.block, each.iteration) for each in some] for some in open_run(folder).iterations()]
    assert found == [[("x", 0), ("yz", 0)]]


def test_a_missing_model_of_a_child_is_one_sentence(tmp_path: Path) -> None:
    folder = tree(tmp_path / "run")
    (folder / "models/x/policy-10.onnx").unlink()
    run = open_run(folder)
    with pytest.raises(RunError, match=r"cannot read the model .*x/policy-10.onnx"):
        evaluate(run, [run.version("body")])


def test_the_control_refuses_a_tree(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(tree(tmp_path / "run")), "--control"]) == 2
    assert (
        "one block that senses and moves the whole body; this one has x, yz, body" in capsys.readouterr().err
    )


def test_the_end_of_a_run_says_how_the_tree_did(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    print_scores(RunFolder.find(str(tree(tmp_path / "run"))))
    assert "tree: 3 of 3 blocks reach their bars" in capsys.readouterr().out


def test_a_report_shows_each_level_with_its_steps(tmp_path: Path) -> None:
    folder = tree(tmp_path / "run", "[[level]]\n[[level]]\n[level.phases]\nbabble_steps = 500\n", body=lazy())
    lines = [{"secs": secs, "what": "phase", "text": words} for secs, words in EVENTS]
    (folder / "events.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    text = write_report(folder).read_text()
    headings = re.findall(r"^## (Level .*)$", text, re.M)
    assert headings == ["Level 1: block body", "Level 0: blocks x, yz"]
    assert "**Tree: 3 of 3 blocks reach their bars.**" in text, "of the rows of the run itself"
    assert "| x | 1 (1.00) | 1 (1.00) |" in text
    assert "- goals 0 and 1 differ in 1 of 2 children" in text
    assert "- goal 0 ends at x = (1.00)" in text
    assert "| 1 | babble | 1 | 4.0 | 500 | 500 |" in text
    assert "20,500 environment steps to learn from (level 0 20,000, level 1 500)" in text
    assert "| `block.x.drives` | `[0]` |" in text
    assert "| `level.1.phases.babble_steps` | `500` |" in text
    pictures = re.findall(r"\]\((figures/[^)]+)\)", text)
    for name in ("body-world", "body-latent", "level-0-ends", "level-0-learning", "x-learning", "timeline"):
        assert f"figures/{name}.png" in pictures
    for name in pictures:
        assert np.ptp(imread(folder / name)[..., 0]) > 0.5, f"{name} is empty"


def test_blocks_of_a_large_body_are_rolled_out_in_fewer_worlds(tmp_path: Path) -> None:
    point = open_run(tree(tmp_path / "point", SLOW.replace("50", "400")))
    assert columns_of(point, 0) == columns_of(point, 1) == 64
    world = WorldSettings(id="MimoRollover", parameters={"hands": "five_finger"})
    body = replace(point, settings=point.settings.model_copy(update={"world": world}))
    assert 4 <= columns_of(body, 1) < columns_of(body, 0) < 16


def test_scores_are_told_at_the_end_of_the_evaluation_of_their_own_level(tmp_path: Path) -> None:
    folder = tree(tmp_path / "run")
    lines = [{"secs": secs, "what": "phase", "text": words} for secs, words in EVENTS]
    (folder / "events.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))
    told = {row.block: (row.secs, row.term) for row in scalars(folder) if row.name == "scores/mean/z_min"}
    assert told == {"x": (4.0, 2), "yz": (4.0, 2), "body": (12.0, 4)}
