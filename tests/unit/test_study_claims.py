"""Verdicts: each claim of 4.5 by its rule, on numbers whose verdict is known."""

from pathlib import Path

import pytest

from services.launcher.study_claims import CLAIMS, Judgement, Verdict, verdict_of, verdicts_of
from services.launcher.study_plan import Plan, load_plan
from services.launcher.study_table import Estimates, estimates_of
from tests.unit.study_stage import coverage, measurement

TABLE1 = Path(__file__).parents[2] / "scenarios" / "table1.toml"
Numbers = dict[str, dict[str, float]]


@pytest.fixture(scope="module")
def plan() -> Plan:
    """The study that the claims are about."""
    return load_plan(TABLE1)


def as_printed(plan: Plan) -> Numbers:
    """What every estimator would have to find if all of the thesis's means were right."""
    numbers: Numbers = {}
    for condition in plan.condition:
        thesis = condition.thesis
        assert thesis.diameter is not None
        assert thesis.participation_ratio is not None
        assert thesis.intrinsic_dimension is not None
        width, dimension = thesis.diameter[0], thesis.intrinsic_dimension[0]
        numbers[condition.id] = {
            **dict.fromkeys(("diameter", "bulk_diameter", "box_diagonal", "centre_sum"), width),
            **dict.fromkeys(("twonn", "twonn_all", "intrinsic_check"), dimension),
            **dict.fromkeys(
                ("participation_ratio", "bulk_participation_ratio"), thesis.participation_ratio[0]
            ),
        }
    return numbers


def estimated(numbers: Numbers, spread: float = 0.001) -> Estimates:
    """Three seeds near those numbers."""
    return estimates_of(
        {
            condition: {
                seed: measurement(
                    coverage(**{name: value * (1 + spread * (seed - 1)) for name, value in ours.items()})
                )
                for seed in (0, 1, 2)
            }
            for condition, ours in numbers.items()
        }
    )


def verdict(words: str, plan: Plan, estimates: Estimates) -> Verdict:
    """Of the claim with these words."""
    (claim,) = [each for each in CLAIMS if words in each.words]
    return verdict_of(claim, plan, estimates)


def test_on_the_thesiss_own_numbers_all_holds_but_what_its_table_contradicts(plan: Plan) -> None:
    verdicts = verdicts_of(plan, estimated(as_printed(plan)))
    failing = {each.claim.words for each in verdicts if each.judgement is Judgement.FAILS}
    assert failing == {
        "pink noise makes the widest pancake of all conditions",
        "pink noise makes the thinnest pancake of all conditions",
    }
    assert all(each.judgement in (Judgement.HOLDS, Judgement.FAILS) for each in verdicts)
    for each in verdicts:
        assert each.claim.by_runs or each.of_thesis is not None
        assert each.of_thesis is None or each.of_thesis.holds == (each.judgement is Judgement.HOLDS)


def test_where_estimators_disagree_the_claim_depends_on_them(plan: Plan) -> None:
    numbers = as_printed(plan)
    numbers["C1"]["twonn_all"] = 40.0
    found = verdict("lower intrinsic dimension than white", plan, estimated(numbers))
    assert found.judgement is Judgement.DEPENDS
    assert {name for name, one in found.findings.items() if one.holds} == {"twonn", "intrinsic_check"}


def test_how_much_wider_is_said_in_percent(plan: Plan) -> None:
    found = verdict("Composer explores a wider space", plan, estimated(as_printed(plan)))
    assert found.judgement is Judgement.HOLDS
    assert found.findings["diameter"].words.endswith("+134%")


def test_one_run_that_reaches_less_far_ends_the_claim_about_every_run(plan: Plan) -> None:
    numbers = as_printed(plan)
    assert verdict("every run of the Composer", plan, estimated(numbers)).judgement is Judgement.HOLDS
    # Means are far apart, but seeds scatter by 60 %.
    found = verdict("every run of the Composer", plan, estimated(numbers, spread=0.6))
    assert found.judgement is Judgement.FAILS
    wider = verdict("Composer explores a wider space", plan, estimated(numbers, spread=0.6))
    assert wider.judgement is Judgement.HOLDS
    assert not wider.clear


@pytest.mark.parametrize(
    ("words", "condition", "dimension", "judgement"),
    [
        ("without the simplex the dimension", "C3", 27.28 + 1.9, Judgement.FAILS),
        ("without the simplex the dimension", "C3", 27.28 + 2.1, Judgement.HOLDS),
        ("without the simplex the dimension", "C3", 27.28 + 6.1, Judgement.FAILS),
        ("without contrastive learning the dimension", "C2", 27.28 + 0.9, Judgement.FAILS),
        ("without contrastive learning the dimension", "C2", 27.28 + 2.9, Judgement.HOLDS),
        ("without them the dimension is highest", "C4", 31.0, Judgement.FAILS),
        ("in the order goals, simplex", "C2", 31.5, Judgement.FAILS),
    ],
)
def test_differences_of_dimension(
    plan: Plan, words: str, condition: str, dimension: float, judgement: Judgement
) -> None:
    numbers = as_printed(plan)
    numbers[condition] |= dict.fromkeys(("twonn", "twonn_all", "intrinsic_check"), dimension)
    assert verdict(words, plan, estimated(numbers)).judgement is judgement


def test_a_diameter_that_moves_by_more_than_its_share_is_not_robust(plan: Plan) -> None:
    numbers = as_printed(plan)
    assert verdict("robust", plan, estimated(numbers)).judgement is Judgement.HOLDS
    for name in ("diameter", "bulk_diameter", "box_diagonal", "centre_sum"):
        numbers["C2"][name] = 0.8 * numbers["C1"][name]
    assert verdict("robust", plan, estimated(numbers)).judgement is Judgement.FAILS


def test_what_was_not_measured_is_said(plan: Plan) -> None:
    numbers = as_printed(plan)
    del numbers["C5"]
    found = verdict("Composer explores a wider space", plan, estimated(numbers))
    assert found.judgement is Judgement.UNKNOWN
    assert found.missing == ("C5",)
    assert verdict("robust", plan, estimated(numbers)).judgement is Judgement.HOLDS
