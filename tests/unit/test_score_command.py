"""`babble score` as a person or a program uses it."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from babble.policy.act import EncoderModel, PolicyModel
from services.launcher.cli import main
from tests.unit.analytic_run import encoder, flat, good, policy, write_run

FIELDS = [
    "run",
    "block",
    "iteration",
    "phase",
    "separation",
    "separation_worst",
    "z_min",
    "z_goal",
    "switch_success",
    "crossing",
    "landmarks",
    "landmark_vertices",
    "external_reward",
    "external_reward_by_vertex",
    "policy",
    "steps",
    "encoder_version",
    "policy_version",
]

TINY = """
[phases]
babble_steps = 64
ground_steps = 256
practise_steps = 256
iterations = 1

[actors]
segment_steps = 16

[encoder]
vision_features = 7

[policy]
rollout_columns = 4
epochs = 1
minibatch = 64
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A run of two iterations, of which the first is good and kept."""
    return write_run(tmp_path / "shown", [good(), flat()], settings=TINY)


def rows(text: str) -> list[dict[str, Any]]:
    """The rows of JSON lines."""
    return [json.loads(line) for line in text.splitlines()]


def test_json_has_the_rows_of_all_iterations_with_exactly_the_promised_fields(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(folder), "--json", "--columns", "4"]) == 0
    found = rows(capsys.readouterr().out)
    assert [(row["iteration"], row["policy"]) for row in found] == [
        (0, "mean"),
        (0, "sampled"),
        (1, "mean"),
        (1, "sampled"),
    ]
    assert all(list(row) == FIELDS for row in found)
    assert found[0]["run"] == "shown"
    assert found[0]["crossing"] is None
    assert found[0]["z_min"] > 0.99
    assert found[2]["z_min"] < 0.6


@pytest.mark.parametrize(("option", "iteration"), [(["--best"], 0), (["--iteration", "1"], 1)])
def test_one_iteration_can_be_chosen(
    folder: Path, capsys: pytest.CaptureFixture[str], option: list[str], iteration: int
) -> None:
    assert main(["score", str(folder), "--json", "--columns", "4", *option]) == 0
    assert {row["iteration"] for row in rows(capsys.readouterr().out)} == {iteration}


def test_the_table_is_plain_and_narrow_and_the_verdict_is_on_the_best_iteration(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert main(["score", str(folder), "--columns", "4"]) == 0
    text = capsys.readouterr().out
    assert text.isascii()
    assert "\x1b" not in text
    table = [line.split() for line in text.splitlines() if line.strip()[:1].isdigit()]
    assert [cells[:2] for cells in table] == [
        ["0", "mean"],
        ["0", "sampled"],
        ["1", "mean"],
        ["1", "sampled"],
    ]
    assert [cells[-1] == "best" for cells in table] == [True, True, False, False]
    assert all(len(line) <= 60 for line in text.splitlines() if line.strip()[:1].isdigit())
    assert "block body, best iteration 0, mean actions: reached: separation, z_min >= 0.9" in text


def test_a_verdict_below_the_bar_says_what_is_missing(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["score", str(folder), "--iteration", "1"]) == 0
    assert "iteration 1, mean actions: not reached: z_min 0.57 < 0.9" in capsys.readouterr().out


def test_the_verdict_is_on_the_kept_iteration_wherever_it_stands(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = write_run(tmp_path / "late", [good(), flat(), good()], best=1)
    assert main(["score", str(folder), "--columns", "4"]) == 0
    assert "best iteration 1, mean actions: not reached: z_min 0.57" in capsys.readouterr().out


def test_a_run_may_be_given_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_run(tmp_path / "runs" / "named", [good()])
    monkeypatch.chdir(tmp_path)
    assert main(["score", "named", "--json", "--columns", "4"]) == 0
    assert rows(capsys.readouterr().out)[0]["run"] == "named"


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (["--iteration", "5"], "has no iteration 5 of block body; it has 0, 1"),
        (["--iteration", "-1"], "must be 0 or more"),
        (["--columns", "0"], "must be 1 or more"),
        (["--best", "--control"], "not allowed with"),
    ],
)
def test_wrong_arguments_end_with_2_and_one_sentence(
    folder: Path, capsys: pytest.CaptureFixture[str], arguments: list[str], sentence: str
) -> None:
    with pytest.raises(SystemExit) as ended:
        raise SystemExit(main(["score", str(folder), *arguments]))
    said = capsys.readouterr().err
    assert ended.value.code == 2
    assert sentence in said
    assert len(said.splitlines()) == 1


def test_the_control_fails_as_it_must(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["score", str(folder), "--control", "--json", "--columns", "8"]) == 0
    said = capsys.readouterr()
    mean, sampled = rows(said.out)
    assert list(mean) == FIELDS
    assert (mean["policy"], sampled["policy"]) == ("mean", "sampled")
    assert (mean["encoder_version"], mean["policy_version"]) == (0, 0)
    assert mean["z_min"] < 0.9
    assert "the control fails, as it must" in said.err


def test_a_control_that_passes_is_an_alarm(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    import babble.control

    budget: dict[str, Any] = {}

    def too_good(*_: object, **settings: Any) -> tuple[EncoderModel, PolicyModel]:
        budget.update(settings)
        return EncoderModel(encoder((1.0, 0.6, 0.3))), PolicyModel(policy((1.0, 1.0, 1.0)))

    monkeypatch.setattr(babble.control, "train_on_untrained_encoder", too_good)
    assert main(["score", str(folder), "--control", "--columns", "8"]) == 1
    assert "the control passes (separation 1.00, z_min 1.00)" in capsys.readouterr().out
    assert budget["train_steps"] == 256 + 1 * 256
    assert budget["walk_steps"] == 64
    assert budget["vision_features"] == 7
    assert (budget["steps"], budget["minibatch"]) == (16, 64)


def test_the_control_is_for_one_block_that_has_the_whole_body(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    blocks = '[[block]]\nname = "body"\nobserves = [0, 1]'
    run = write_run(tmp_path / "part", [good()], settings=blocks)
    assert main(["score", str(run), "--control"]) == 2
    assert "one block that senses and moves the whole body" in capsys.readouterr().err


@pytest.fixture
def without_torch(folder: Path) -> Callable[..., subprocess.CompletedProcess[str]]:
    """Runs `babble score` in a process where torch cannot be imported."""
    program = (
        "import sys; sys.modules['torch'] = None; from services.launcher.cli import main; sys.exit(main())"
    )

    def run(*options: str) -> subprocess.CompletedProcess[str]:
        command = [sys.executable, "-c", program, "score", str(folder), "--columns", "4", *options]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    return run


def test_scoring_needs_no_torch(without_torch: Callable[..., subprocess.CompletedProcess[str]]) -> None:
    ended = without_torch("--best", "--json")
    assert ended.returncode == 0, ended.stderr
    assert len(rows(ended.stdout)) == 2


def test_the_control_without_torch_names_the_extra(
    without_torch: Callable[..., subprocess.CompletedProcess[str]],
) -> None:
    ended = without_torch("--control")
    assert ended.returncode == 2
    assert "needs torch" in ended.stderr
    assert "--extra learner" in ended.stderr
    assert len(ended.stderr.splitlines()) == 1
