"""Means, intervals, and how near definitions come to the thesis."""

import numpy as np
import pytest

from services.launcher.study_plan import Plan
from services.launcher.study_table import (
    estimate,
    estimates_of,
    is_near,
    nearness_of,
    spearman,
    table_lines,
)
from tests.unit.study_stage import coverage, measurement, plan_of


def judged_plan(**thesis: list[float]) -> Plan:
    """Three conditions; `thesis` is the diameter of each."""
    conditions = [
        {"id": each, "title": each.lower(), "thesis": {"diameter": numbers}}
        for each, numbers in thesis.items()
    ]
    return plan_of(condition=conditions)


def test_mean_deviation_and_interval_of_the_seeds() -> None:
    one = estimate({0: 1.0, 1: 2.0, 2: 6.0})
    assert one.mean == pytest.approx(3.0)
    assert one.deviation == pytest.approx(np.std([1, 2, 6], ddof=1))
    assert 1.0 <= one.low < one.mean < one.high <= 6.0
    assert estimate({0: 1.0, 1: 2.0, 2: 6.0}) == one
    assert (one.least, one.most) == (1.0, 6.0)


def test_the_bootstrap_interval_is_that_of_a_mean() -> None:
    values = np.random.default_rng(1).normal(5.0, 2.0, 400)
    one = estimate(dict(enumerate(values.tolist())))
    expected = 1.96 * values.std(ddof=1) / 20
    assert one.high - one.low == pytest.approx(2 * expected, rel=0.1)


def test_one_seed_has_no_deviation() -> None:
    one = estimate({4: 2.5})
    assert one.deviation is None
    assert (one.low, one.high) == (2.5, 2.5)
    with pytest.raises(ValueError, match="no seed"):
        estimate({})


def test_the_nearest_definition_comes_first_with_its_errors_and_its_order() -> None:
    plan = judged_plan(A=[10.0, 1.0], B=[20.0, 1.0], C=[30.0, 1.0])
    found = estimates_of(
        {
            each: {0: measurement(coverage(diameter=wide, box_diagonal=box))}
            for each, wide, box in (("A", 11.0, 40.0), ("B", 18.0, 30.0), ("C", 30.0, 20.0))
        }
    )
    nearest, *others = nearness_of(plan, found, "diameter")
    assert nearest.metric.name == "diameter"
    assert nearest.errors == pytest.approx({"A": 0.1, "B": -0.1, "C": 0.0})
    assert nearest.mean_error == pytest.approx(0.2 / 3)
    assert nearest.order == pytest.approx(1.0)
    box = next(each for each in others if each.metric.name == "box_diagonal")
    assert box.order == pytest.approx(-1.0)


def test_a_definition_that_only_differs_by_a_factor_is_known_by_it() -> None:
    plan = judged_plan(A=[10.0, 1.0], B=[20.0, 1.0], C=[30.0, 1.0])
    found = estimates_of(
        {
            each: {0: measurement(coverage(centre_sum=wide))}
            for each, wide in (("A", 50.0), ("B", 100.0), ("C", 150.0))
        }
    )
    summed = next(each for each in nearness_of(plan, found, "diameter") if each.metric.name == "centre_sum")
    assert summed.factor == pytest.approx(0.2)
    assert summed.left_error == pytest.approx(0.0, abs=1e-12)
    assert summed.mean_error == pytest.approx(4.0)


def test_near_is_within_a_fifth() -> None:
    assert is_near(12.0, 10.0)
    assert not is_near(12.1, 10.0)
    assert is_near(8.0, 10.0)
    assert not is_near(7.9, 10.0)


def test_rank_correlation() -> None:
    assert spearman([1, 2, 3], [10, 20, 90]) == pytest.approx(1.0)
    assert spearman([1, 2, 3], [9, 8, 7]) == pytest.approx(-1.0)


def test_the_table_has_a_line_per_condition_also_for_one_without_a_run() -> None:
    plan = judged_plan(A=[10.0, 1.0], B=[20.0, 1.0])
    head, first, second = table_lines(plan, estimates_of({"A": {0: measurement()}}))
    assert head.split()[:2] == ["diameter", "thesis"]
    assert first.split()[:6] == ["A", "a", "10.0", "10.0", "±", "1.0"]
    assert second.split()[:3] == ["B", "b", "-"]
