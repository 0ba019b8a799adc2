"""Scores recomputed from a run folder are those that its models deserve; what cannot be scored is named."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from protocol.messages import Score
from services.launcher.evaluate import RunError, evaluate, open_run, shortfalls
from services.runtime.errors import UserError
from tests.unit.analytic_run import encoder, face, flat, good, policy, write_run

TWO_BLOCKS = """
[[block]]
name = "up"
observes = [2]
drives = [2]

[[block]]
name = "flat"
observes = [1, 0]
drives = [0, 1]
"""


def score_best(folder: Path) -> list[Score]:
    """The rows of the best iteration."""
    run = open_run(folder)
    return evaluate(run, [run.version("body")], columns=4)


@pytest.mark.parametrize("world", ["Cuboid", "Ellipsoid", "Dumbbell"])
def test_models_that_reach_both_ends_meet_every_bar(tmp_path: Path, world: str) -> None:
    run = open_run(write_run(tmp_path / "run", [good(world)], world=world))
    for row in evaluate(run, [run.version("body")], columns=32):
        assert shortfalls(row) == []
        assert (row.crossing is not None) == (world == "Dumbbell")


def test_the_ends_of_the_diagonal_are_one_diameter_apart_and_those_of_faces_less(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run", [good(), face()]))
    (corner,) = evaluate(run, [run.version("body", 0)], modes=["mean"])
    (side,) = evaluate(run, [run.version("body", 1)], modes=["mean"])
    assert corner.separation == pytest.approx(1.0, abs=1e-3)
    assert side.separation == pytest.approx(2 / np.hypot(np.hypot(2, 1.2), 0.6), abs=1e-3)
    assert shortfalls(side) == ["separation 0.83 < 0.9"]


def test_far_ends_on_a_latent_that_learned_nothing_are_no_success(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run", [flat()]))
    (row,) = evaluate(run, [run.version("body")], modes=["mean"])
    assert row.separation > 0.99
    assert row.z_min == pytest.approx(1 / (1 + np.exp(-0.2 * (1 + 0.36 + 0.09))), abs=1e-3)
    assert shortfalls(row) == ["z_min 0.57 < 0.9"]


def test_a_shortfall_shows_as_many_digits_as_it_takes(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run", [good()]))
    (row,) = evaluate(run, [run.version("body")], modes=["mean"])
    assert shortfalls(row.model_copy(update={"z_min": 0.89999})) == ["z_min 0.899990 < 0.9"]
    assert shortfalls(row.model_copy(update={"z_min": 0.9})) == []


def test_scores_repeat_with_their_seed_and_vary_with_another(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run", [good()]))
    versions = [run.version("body")]
    once, again, other = (
        evaluate(run, versions, seed=seed, columns=8, modes=["sampled"]) for seed in (3, 3, 4)
    )
    assert once == again
    assert once != other


def test_rows_say_what_was_measured(tmp_path: Path) -> None:
    run = open_run(write_run(tmp_path / "run", [flat(), good()], best=1))
    mean, sampled = evaluate(run, [run.version("body")], columns=8)
    assert (mean.policy, sampled.policy) == ("mean", "sampled")
    assert (mean.iteration, mean.phase.value, mean.steps) == (1, "practise", 8 * 5 * 100)
    assert (mean.encoder_version, mean.policy_version) == (2, 20)
    assert mean.separation > sampled.separation


def test_blocks_see_and_move_their_slices_and_act_at_the_same_time(tmp_path: Path) -> None:
    models = {
        "up": (encoder([5.0]), policy([1.0])),
        "flat": (encoder([0.0, 2.0]), policy([1.0, 0.0])),
    }
    run = open_run(write_run(tmp_path / "run", [models], settings=TWO_BLOCKS))
    up, across = evaluate(run, [run.version(block) for block in run.blocks], modes=["mean"])
    assert (up.block, across.block) == ("up", "flat")
    assert up.z_min > 0.9
    assert across.z_min > 0.9
    with pytest.raises(RunError, match="no models of block flat to act beside up"):
        evaluate(run, [run.version("up")])


def test_an_unnamed_version_is_the_best_or_else_the_newest(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good(), flat(), flat()])
    assert open_run(folder).version("body").iteration == 0
    (folder / "best.json").unlink()
    assert open_run(folder).version("body").iteration == 2


def test_a_row_that_is_still_being_written_does_not_count(tmp_path: Path) -> None:
    folder = write_run(tmp_path / "run", [good()])
    with (folder / "scores.jsonl").open("a") as file:
        file.write('{"run": "ru')
    assert len(open_run(folder).scores) == 2


def _truncate(folder: Path) -> None:
    path = folder / "models/body/policy-10.onnx"
    path.write_bytes(path.read_bytes()[:-40])


def _put(name: str, onnx: bytes) -> Callable[[Path], object]:
    return lambda folder: (folder / "models/body" / name).write_bytes(onnx)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (lambda folder: (folder / "run.json").unlink(), "is not the folder of a run"),
        (lambda folder: (folder / "config.toml").write_text("[world]\nid = 3"), "config.toml: "),
        (lambda folder: (folder / "scores.jsonl").write_text(""), "no evaluated models of block body yet"),
        (lambda folder: (folder / "scores.jsonl").write_text('{"run": 3}\n'), "scores.jsonl: line 1"),
        (lambda folder: (folder / "best.json").write_text("{"), "best.json is damaged"),
        (lambda folder: (folder / "best.json").write_text('{"body": {"iteration": 7}}'), "no iteration 7"),
        (lambda folder: (folder / "models/body/encoder-1.onnx").unlink(), "cannot read the model"),
        (_truncate, "policy-10.onnx cannot be used: .* ONNX Runtime"),
        (_put("encoder-1.onnx", policy([1.0] * 3)), "encoder-1.onnx cannot be used: the encoder has inputs"),
        (_put("encoder-1.onnx", encoder([1.0] * 4)), "observation size is 4, and this run's world needs 3"),
        (_put("encoder-1.onnx", encoder([1.0] * 3, 1.0, 5)), "latent dimension is 5, .* needs 2"),
        (_put("policy-10.onnx", policy([1.0] * 2)), "action size is 2, and this run's world needs 3"),
        (_put("policy-10.onnx", policy([1.0] * 3, 4)), "latent dimension is 4, .* needs 2"),
    ],
)
def test_what_cannot_be_scored_is_named_in_one_sentence(
    tmp_path: Path, spoil: Callable[[Path], object], sentence: str
) -> None:
    folder = write_run(tmp_path / "run", [good()])
    spoil(folder)
    with pytest.raises(UserError, match=sentence) as refused:
        score_best(folder)
    assert "\n" not in str(refused.value)
