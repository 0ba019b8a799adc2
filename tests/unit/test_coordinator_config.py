"""The plan that follows from the settings."""

import pytest

from services.coordinator.config import plan_of
from services.coordinator.state import Plan
from services.runtime.settings import SettingsError, parse


def plan(**table: object) -> Plan:
    return plan_of(parse({"scenario": "test", **table}, origin="test"))


def test_a_flat_composer_is_a_tree_of_one_block() -> None:
    assert plan(phases={"iterations": 3}, wire={"stall_secs": 7.0}) == Plan(
        levels=(("body",),), iterations=3, stall_secs=7.0
    )


def test_a_parent_is_above_its_highest_child_and_leaves_are_at_the_bottom() -> None:
    blocks = [
        {"name": "arm", "children": ["hand", "elbow"]},
        {"name": "hand", "children": ["thumb", "index"]},
        {"name": "thumb"},
        {"name": "index"},
        {"name": "elbow"},
    ]
    assert plan(block=blocks).levels == (("thumb", "index", "elbow"), ("hand",), ("arm",))


@pytest.mark.parametrize(
    ("blocks", "sentence"),
    [
        ([{"name": "hand", "children": ["thumb"]}], "block 'hand' has an unknown child 'thumb'"),
        ([{"name": "a", "children": ["b"]}, {"name": "b", "children": ["a"]}], "its own ancestor"),
    ],
    ids=["unknown-child", "circle"],
)
def test_a_tree_that_is_none_is_refused_with_a_sentence(
    blocks: list[dict[str, object]], sentence: str
) -> None:
    with pytest.raises(SettingsError, match=sentence):
        plan(block=blocks)


@pytest.mark.parametrize("levels", [(), ((),), (("a", "a"),), (("a",), ("a",))])
def test_a_plan_needs_distinct_blocks_on_every_level(levels: tuple[tuple[str, ...], ...]) -> None:
    with pytest.raises(ValueError, match="each level needs blocks"):
        Plan(levels=levels, iterations=1, stall_secs=1.0)
