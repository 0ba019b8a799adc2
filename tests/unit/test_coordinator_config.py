"""The plan that follows from the settings."""

import pytest

from services.coordinator.config import plan_of
from services.coordinator.state import Plan
from services.runtime.settings import SettingsError, parse


def plan(**table: object) -> Plan:
    return plan_of(parse({"scenario": "test", **table}, origin="test"))


def test_a_flat_composer_is_a_tree_of_one_block() -> None:
    assert plan(phases={"iterations": 3}, wire={"stall_secs": 7.0}) == Plan(
        levels=(("body",),),
        iterations=(3,),
        stall_secs=7.0,
        processes={"encoder_learner": 1, "policy_learner": 1},
        shares={("encoder_learner", "body"): 0, ("policy_learner", "body"): 0},
    )


def test_a_parent_is_above_its_highest_child_and_leaves_are_at_the_bottom() -> None:
    blocks = [
        {"name": "arm", "children": ["hand", "elbow"]},
        {"name": "hand", "children": ["thumb", "index"]},
        {"name": "thumb"},
        {"name": "index"},
        {"name": "elbow"},
    ]
    levels = [{}, {}, {"decision_steps": 50, "phases": {"iterations": 1}}]
    made = plan(block=blocks, level=levels)
    assert made.levels == (("thumb", "index", "elbow"), ("hand",), ("arm",))
    assert made.iterations == (4, 4, 1)


def test_the_plan_knows_which_process_learns_a_block() -> None:
    blocks = [{"name": name} for name in ("thumb", "index", "ring")]
    made = plan(block=[*blocks, {"name": "little", "learner": 0}], learners={"policy": 2})
    assert made.processes == {"encoder_learner": 1, "policy_learner": 2}
    of_policies = [made.shares["policy_learner", name] for name in ("thumb", "index", "ring", "little")]
    assert of_policies == [0, 1, 0, 0]
    assert {index for (learner, _), index in made.shares.items() if learner == "encoder_learner"} == {0}


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


def test_a_plan_needs_the_iterations_of_every_level() -> None:
    with pytest.raises(ValueError, match=r"2 levels cannot have the iterations \(1,\)"):
        Plan(levels=(("a",), ("b",)), iterations=(1,), stall_secs=1.0)


@pytest.mark.parametrize("levels", [(), ((),), (("a", "a"),), (("a",), ("a",))])
def test_a_plan_needs_distinct_blocks_on_every_level(levels: tuple[tuple[str, ...], ...]) -> None:
    with pytest.raises(ValueError, match="each level needs blocks"):
        Plan(levels=levels, iterations=(1,), stall_secs=1.0)
