"""What a study's TOML says, and what is refused in one sentence."""

from pathlib import Path
from typing import Any

import pytest

from services.launcher.study_plan import (
    StudyError,
    base_settings,
    load_plan,
    parse_plan,
    runs_of,
    scaled,
    seeds_of,
)
from services.runtime.sections import PhaseSettings
from tests.unit.study_stage import base, plan_of

TABLE1 = Path(__file__).parents[2] / "scenarios" / "table1.toml"


def table(**changes: Any) -> dict[str, Any]:
    """A plan as read from a file."""
    condition = {"id": "A", "title": "a"}
    made = {"study": "play", "title": "t", "base": "b", "steps": 9, "seeds": [0], "condition": [condition]}
    return {**made, **changes}


def test_table_1_is_eight_conditions_of_a_million_steps_each_with_one_thing_otherwise() -> None:
    plan = load_plan(TABLE1)
    runs = runs_of(plan, base_settings(plan, TABLE1), steps=plan.steps, seeds=plan.seeds)
    assert [run.condition for run in runs[:8]] == ["C5", "C6", "C7", "C8", "C1", "C2", "C3", "C4"]
    assert len(runs) == 24
    assert {run.rows for run in runs} == {1_000_000}
    by_id = {run.condition: run.settings for run in runs[:8]}
    assert not by_id["C2"].encoder.contrastive
    assert by_id["C3"].encoder.output == "linear"
    assert by_id["C4"].goals.kind == "random"
    assert by_id["C7"].babbling.exponents == (0.7, 0.9)
    assert by_id["C8"].babbling.scale == pytest.approx(0.2 / (1 - 0.85**2) ** 0.5, abs=1e-4)
    for one in ("C2", "C3", "C4"):
        differing = {name for name, value in by_id[one] if value != getattr(by_id["C1"], name)}
        assert len(differing - {"scenario"}) == 1


def test_of_a_run_that_learns_all_phases_shrink_in_proportion_and_their_sum_is_the_steps() -> None:
    phases = PhaseSettings(
        babble_steps=100_000, ground_steps=300_000, walk_steps=50_000, practise_steps=100_000, iterations=4
    )
    small = scaled(phases, 20_000)
    assert (small.babble_steps, small.ground_steps) == (2_000, 6_000)
    assert (small.walk_steps, small.practise_steps, small.iterations) == (1_000, 2_000, 4)
    assert scaled(phases, 1_000_000) == phases
    odd = scaled(phases, 777)
    assert odd.babble_steps + odd.ground_steps + 4 * (odd.walk_steps + odd.practise_steps) >= 777
    walking = scaled(phases.model_copy(update={"open_loop": True}), 777)
    assert walking.babble_steps == 777


def test_where_not_each_step_is_recorded_fewer_rows_are_measured() -> None:
    every_fourth = base(recording={"every_steps": 4})
    (run,) = runs_of(plan_of("A", seeds=[7], curve=[100, 5000]), every_fourth, steps=1000, seeds=[7])
    assert run.rows == 250
    assert run.curve == (25, 250)
    assert run.name == "A-seed7"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"seed": 3}, "seed: is not a known key"),
        ({"seeds": []}, "seeds: "),
        ({"seeds": [1, 1]}, "each seed may be there once"),
        ({"steps": 0}, "steps: "),
        ({"condition": [{"id": "A", "title": "a"}, {"id": "a", "title": "b"}]}, "each id may be there once"),
        ({"condition": [{"id": "../A", "title": "a"}]}, "condition.0.id: "),
        (
            {"condition": [{"id": "A", "title": "a", "thesis": {"width": [1, 2]}}]},
            "thesis.width: is not a known",
        ),
        ({"claims": "mine"}, "claims: "),
        ({"scenario": "x", "condition": None}, "condition: "),
    ],
)
def test_what_is_wrong_with_a_plan_is_one_sentence_with_the_key(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(StudyError, match=r"^here: ") as refused:
        parse_plan(table(**changes), origin="here")
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_scenario_is_told_from_a_study() -> None:
    with pytest.raises(StudyError, match="is a scenario, not a study; train it with `babble up`"):
        parse_plan({"scenario": "cuboid"}, origin="cuboid.toml")


@pytest.mark.parametrize(
    ("condition", "scenario", "words"),
    [
        (
            {"change": {"goals": {"kinds": "random"}}},
            {},
            "condition A of play: goals.kinds: is not a known key",
        ),
        ({"change": {"encoder": {"output": "square"}}}, {}, "encoder.output: "),
        ({}, {"recording": {"every_steps": 0}}, "records nothing to measure"),
        ({}, {"level": [{"phases": {"babble_steps": 5}}]}, "says phases by level"),
    ],
)
def test_what_cannot_be_run_is_said_before_anything_starts(
    condition: dict[str, Any], scenario: dict[str, Any], words: str
) -> None:
    plan = parse_plan(table(condition=[{"id": "A", "title": "a", **condition}]), origin="here")
    with pytest.raises(StudyError) as refused:
        runs_of(plan, base(**scenario), steps=100, seeds=[0])
    assert words in str(refused.value)


def test_only_some_conditions_and_an_unknown_one() -> None:
    plan = plan_of("A", "B", "C")
    runs = runs_of(plan, base(), steps=100, seeds=[5], only=["C", "A"])
    assert [run.name for run in runs] == ["A-seed5", "C-seed5"]
    with pytest.raises(StudyError, match="has no condition 'X'; it has A, B, C"):
        runs_of(plan, base(), steps=100, seeds=[5], only=["X"])


def test_seeds_of_a_command_line() -> None:
    assert seeds_of("0-2") == [0, 1, 2]
    assert seeds_of("4,1") == [4, 1]
    assert seeds_of("7, 0-1") == [7, 0, 1]
    for wrong in ("", "2-0", "a", "1,1", "0-99999999", "-1", str(2**32)):
        with pytest.raises(ValueError, match="got"):
            seeds_of(wrong)
