"""Choosing parts of a model by patterns."""

import pytest

from babble.patterns import PatternError, matching

NAMES = ["left_knee", "", "right_knee", "right_hip", "left_hip"]


@pytest.mark.parametrize(
    ("patterns", "chosen"),
    [
        (["*"], [0, 2, 3, 4]),
        (["right_*"], [2, 3]),
        (["*_hip", "left_knee"], [0, 3, 4]),
        (["*", "!left_*"], [2, 3]),
        (["*_kne?", "*_knee"], [0, 2]),
    ],
)
def test_names_are_chosen_in_the_models_order(patterns: list[str], chosen: list[int]) -> None:
    assert matching(NAMES, patterns, "joint").tolist() == chosen


@pytest.mark.parametrize(
    ("patterns", "sentence"),
    [
        (["rigth_knee"], "no joint matches 'rigth_knee'; the nearest are right_knee"),
        (["*", "!toe"], "no joint matches 'toe'"),
        (["left_*", "!left_*"], "leave no joint of the model's 5"),
        ([], "leave no joint"),
        ("left_*", "chosen by a list of patterns, got 'left_"),
    ],
)
def test_patterns_that_match_nothing_are_named(patterns: list[str], sentence: str) -> None:
    with pytest.raises(PatternError, match=sentence):
        matching(NAMES, patterns, "joint")


def test_a_model_without_names_says_so() -> None:
    with pytest.raises(PatternError, match="the model has no sensor with a name"):
        matching(["", ""], ["*"], "sensor")
