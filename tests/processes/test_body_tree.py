"""A tree of four levels on the whole infant, as shipped but for its budgets, from the first phase on."""

from pathlib import Path
from typing import Any

import pytest
import tomli_w

from protocol.messages import Phase
from tests.processes.owned import ROOT, Owner
from tests.processes.tree_runs import children_in, merged, rows, said, scenario_of

pytestmark = [pytest.mark.slow, pytest.mark.processes]

CUT: dict[str, Any] = {
    "phases": {
        "iterations": 1,
        "babble_steps": 256,
        "ground_steps": 128,
        "walk_steps": 128,
        "practise_steps": 64,
    },
    "encoder": {
        "batch": 32,
        "encode": {"updates": 20, "window_steps": 4},
        "refine": {"updates": 10, "window_steps": 3},
    },
    "policy": {"rollout_columns": 4, "epochs": 1, "minibatch": 32},
    "goals": {"period_steps": 20, "walk_steps_per_goal": 20},
    "actors": {"envs_per_actor": 2, "segment_steps": 16},
    "evaluation": {"columns": 2, "legs": 3, "leg_steps": 40},
}
DECISION_STEPS = (1, 10, 20, 40)
"""By level, as shipped: whatever is cut keeps room for some decisions."""


def test_a_body_of_four_levels_goes_through_all_its_phases(owner: Owner, tmp_path: Path) -> None:
    scenario, folder = tmp_path / "body.toml", tmp_path / "run"
    scenario.write_text(tomli_w.dumps(cut(scenario_of(ROOT / "scenarios" / "body-hi.toml"))))
    said(owner, "up", str(scenario), "--seed", "1", "--run-dir", str(folder), "--no-dashboard")
    blocks = list(children_in(folder))
    assert len(blocks) == 23
    for level in range(4):
        assert phases_of(folder, level) >= {phase.value for phase in Phase} - {Phase.DONE.value}
    scored = [
        (row["block"], row["iteration"]) for row in rows(folder, "scores.jsonl") if row["policy"] == "mean"
    ]
    assert sorted(scored) == sorted((block, number) for block in blocks for number in (0, 1))
    told = said(owner, "score", str(folder), "--best", "--columns", "2")
    [words] = [line for line in told if line.startswith("tree: ")]
    assert "of 23 blocks" in words
    (folder / "report.md").unlink()
    said(owner, "report", str(folder))
    report = (folder / "report.md").read_text()
    assert all(block in report for block in blocks)


def cut(scenario: dict[str, Any]) -> dict[str, Any]:
    """The scenario with the least budgets that let each phase begin and end."""
    levels = [
        merged(level, cut_of(decision))
        for level, decision in zip(scenario["level"], DECISION_STEPS, strict=True)
    ]
    return merged(scenario, CUT) | {"level": levels}


def cut_of(decision_steps: int) -> dict[str, Any]:
    """What a level above the leaves makes smaller: sixteen decisions a phase, two of them to a goal."""
    if decision_steps == 1:
        return {}
    budget = 16 * decision_steps
    names = ("babble_steps", "ground_steps", "walk_steps", "practise_steps")
    return {
        "segment_steps": 4,
        "phases": dict.fromkeys(names, budget),
        "encoder": {"encode": {"window_steps": 3}, "refine": {"window_steps": 2}},
        "policy": {"minibatch": 16},
        "goals": {"period_steps": 2 * decision_steps, "walk_steps_per_goal": 2 * decision_steps},
        "evaluation": {"leg_steps": 2 * decision_steps},
    }


def phases_of(folder: Path, level: int) -> set[str]:
    """Which phases a level went through."""
    texts = [row["text"] for row in rows(folder, "events.jsonl") if row["what"] == "phase"]
    return {text.split()[0] for text in texts if f"level {level}," in text}
