"""Settings of a tree: what a level or a block has otherwise, who learns what, and how long a step is."""

import tomllib
from typing import Any

import pytest
import tomli_w

from protocol.messages import Phase
from services.runtime.settings import (
    MOST_BLOCKS,
    RunSettings,
    SettingsError,
    announced_text,
    parse,
    parse_announced,
)

HAND = """
scenario = "hand"

[phases]
iterations = 3

[learners]
encoder = 2
policy = 2

[[block]]
name = "hand"
children = ["thumb", "index"]
encoder = { hidden = [8] }

[[block]]
name = "thumb"
observes = ["position/*th_*"]
drives = ["act:right_th_*"]
policy = { epochs = 2 }

[[block]]
name = "index"
observes = [0, 1]
drives = [0]
learner = 0

[[level]]
[level.policy]
epochs = 9
minibatch = 64

[[level]]
decision_steps = 5
segment_steps = 32
[level.phases]
ground_steps = 1000
iterations = 1
[level.encoder.encode]
window_steps = 20
"""


def hand(**changes: Any) -> RunSettings:
    return parse({**tomllib.loads(HAND), **changes}, origin="origin")


def chain(*levels: dict[str, Any]) -> RunSettings:
    """A block above a block above a block."""
    blocks = [{"name": "a"}, {"name": "b", "children": ["a"]}, {"name": "c", "children": ["b"]}]
    return parse({"scenario": "x", "block": blocks, "level": list(levels)}, origin="origin")


def test_leaves_are_level_0_and_a_parent_is_above_them() -> None:
    assert hand().levels == (("thumb", "index"), ("hand",))
    assert [hand().level_of(name) for name in ("hand", "thumb")] == [1, 0]
    with pytest.raises(KeyError, match="tail"):
        hand().level_of("tail")


def test_a_block_has_the_runs_settings_but_for_its_levels_and_its_own() -> None:
    thumb, index, above = (hand().of_block(name) for name in ("thumb", "index", "hand"))
    assert [of.policy.epochs for of in (thumb, index, above)] == [2, 9, 6]
    assert [of.policy.minibatch for of in (thumb, index, above)] == [64, 64, 512]
    assert [of.actors.segment_steps for of in (thumb, index, above)] == [128, 128, 32]
    assert (above.phases.ground_steps, above.phases.walk_steps, above.phases.iterations) == (1000, 16_000, 1)
    assert thumb.phases.iterations == 3


def test_a_table_within_a_table_may_be_changed_in_part() -> None:
    encoder, run = hand().of_block("hand").encoder, hand().encoder
    assert encoder.encode.window_steps == 20
    assert encoder.encode.updates == run.encode.updates
    assert (encoder.hidden, encoder.refine) == ([8], run.refine)


def test_a_flat_run_has_the_same_settings_for_its_level_and_its_block() -> None:
    flat = parse({"scenario": "x", "actors": {"segment_steps": 64}}, origin="x")
    assert flat.of_level(0) == flat.of_block("body") == flat
    assert (flat.levels, flat.decision_steps) == ((("body",),), (1,))
    assert {flat.rows_env_steps("body", phase) for phase in Phase} == {1}
    assert flat.learner_of("body", "policy") == 0


def test_a_decision_of_a_level_is_several_of_the_level_below() -> None:
    assert hand().decision_steps == (1, 5)
    goals = {"period_steps": 100, "walk_steps_per_goal": 100}
    assert chain({}, {}, {"goals": goals, "evaluation": {"leg_steps": 100}}).decision_steps == (1, 10, 50)
    assert chain({}, {"decision_steps": 20}, {"decision_steps": 100}).decision_steps == (1, 20, 100)


def test_a_row_is_a_decision_where_a_block_acts_and_one_of_the_level_below_where_it_is_watched() -> None:
    tree = chain({}, {"decision_steps": 5}, {"decision_steps": 50})
    acting, watched = (Phase.GROUND, Phase.PRACTISE, Phase.EVALUATE), (Phase.BABBLE, Phase.WALK)
    assert {name: [tree.rows_env_steps(name, phase) for phase in acting] for name in "abc"} == {
        "a": [1, 1, 1], "b": [5, 5, 5], "c": [50, 50, 50],
    }  # fmt: skip
    assert {name: [tree.rows_env_steps(name, phase) for phase in watched] for name in "abc"} == {
        "a": [1, 1], "b": [1, 1], "c": [5, 5],
    }  # fmt: skip


def test_the_blocks_of_a_level_are_dealt_out_in_turn_unless_they_say_who_learns_them() -> None:
    assert {name: hand().learner_of(name, "policy") for name in ("thumb", "index", "hand")} == {
        "thumb": 0, "index": 0, "hand": 0,
    }  # fmt: skip
    fingers = [{"name": f"finger{number}"} for number in range(5)]
    five = parse({"scenario": "x", "block": fingers, "learners": {"encoder": 2, "policy": 3}}, origin="x")
    assert [five.learner_of(block.name, "encoder") for block in five.block] == [0, 1, 0, 1, 0]
    assert [five.learner_of(block.name, "policy") for block in five.block] == [0, 1, 2, 0, 1]


def test_a_tree_is_the_same_when_it_was_written_down_or_announced() -> None:
    written = tomli_w.dumps(hand().model_dump(mode="json", exclude_none=True))
    assert parse(tomllib.loads(written), origin="config.toml") == hand()
    assert parse_announced(announced_text(hand()), origin="announced") == hand()


def test_a_reward_that_only_one_level_weighs_must_exist_too() -> None:
    weighing = hand(level=[{}, {"goals": {"external_weight": 0.5}}])
    weighing.check_rewarded(rewarded=True)
    with pytest.raises(SettingsError, match=r"external_weight is 0\.5, and the world Cuboid has no reward"):
        weighing.check_rewarded(rewarded=False)


@pytest.mark.parametrize(
    ("level", "sentence"),
    [
        ({"policy": {"epoch": 1}}, r"origin: level\.1\.policy\.epoch: is not a known key"),
        ({"policy": {"epochs": 0}}, r"origin: level\.1\.policy\.epochs: .*greater than or equal to 1, got 0"),
        ({"encoder": {"encode": {"updates": -1}}}, r"level\.1\.encoder\.encode\.updates: .* got -1"),
        ({"encoder": {"encode": 3}}, r"level\.1\.encoder\.encode: "),
        ({"wire": {}}, r"level\.1\.wire: is not a known key"),
        ({"goals": {"goal_weight": 0}}, r"level\.1\.goals: .*nothing would be rewarded"),
        ({"goals": {"period_steps": 25}}, r"level\.1\.goals\.period_steps: must be a multiple of the 10 "),
        ({"goals": {"walk_steps_per_goal": 5}}, r"level\.1\.goals\.walk_steps_per_goal: must be a multiple"),
        ({"evaluation": {"leg_steps": 101}}, r"level\.1\.evaluation\.leg_steps: must be a multiple .* 101"),
        ({"evaluation": {"legs": 1 << 20}}, r"level\.1\.evaluation: legs x leg_steps may be at most"),
        ({"babbling": {"subgoal_steps": [9, 8]}}, r"level\.1\.babbling: .*9 is more than 8"),
        ({"policy": {"rollout_columns": 1}}, r"actors\.envs_per_actor: may be at most 3, .* of block hand"),
        ({"decision_steps": 0}, r"level\.1\.decision_steps: .*greater than or equal to 1"),
    ],
)
def test_what_a_level_cannot_have_is_named_with_its_place(level: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence) as refusal:
        hand(level=[{}, level])
    assert "\n" not in str(refusal.value)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"level": [{"decision_steps": 2}]}, r"level\.0\.decision_steps: .*may only be 1, got 2"),
        ({"level": [{}, {}, {}]}, r"level\.2: the blocks make levels 0 to 1; leave out what is above"),
        ({"learners": {"policy": 4}}, r"learners\.policy: there are only 3 blocks to learn, got 4"),
        ({"babbling": {"subgoal_steps": [0, 8]}}, r"babbling\.subgoal_steps\.0: .*equal to 1, got 0"),
        ({"policy": {"subgoals": "hard"}}, r"policy\.subgoals: .*'one-hot' or 'softmax', got 'hard'"),
        (
            {"block": [{"name": "a", "learner": 1}, {"name": "b"}], "level": [], "learners": {"policy": 2}},
            r"block\.0\.learner: must be below 1, .* got 1",
        ),
        (
            {"block": [{"name": "a", "encoder": {"blend": 0}}, {"name": "b"}], "level": []},
            r"block\.0\.encoder\.blend: .*greater than 0, got 0",
        ),
        (
            {"block": [{"name": "a", "observes": [0, "x"]}, {"name": "b"}], "level": []},
            r"block\.0\.observes: .*a list of indices or a list of patterns of names",
        ),
    ],
)
def test_what_a_tree_cannot_have_is_named_with_its_place(changes: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError, match=sentence):
        hand(**changes)


def test_a_decision_that_is_no_multiple_of_the_one_below_is_refused() -> None:
    with pytest.raises(SettingsError, match=r"level\.2\.decision_steps: must be a multiple of the 20 of"):
        chain({}, {"decision_steps": 20}, {"decision_steps": 50})


@pytest.mark.parametrize(
    ("blocks", "sentence"),
    [
        ([{"name": "a", "children": ["b"]}], "block 'a' has an unknown child 'b'"),
        ([{"name": "a", "children": ["a"]}], "block 'a' is its own ancestor"),
    ],
)
def test_blocks_that_make_no_tree_have_no_levels(blocks: list[dict[str, Any]], sentence: str) -> None:
    broken = parse({"scenario": "x", "block": blocks}, origin="x")
    for ask in (lambda: broken.levels, lambda: broken.decision_steps, lambda: broken.of_block("a")):
        with pytest.raises(SettingsError, match=sentence):
            ask()


@pytest.mark.parametrize("number", ["nan", "inf"])
def test_a_number_that_is_none_is_refused_at_every_level(number: str) -> None:
    for table in (f"[level.policy]\nlog_std = {number}", f"[level.policy]\nlearning_rate = {number}"):
        scenario = f'scenario = "x"\n[[level]]\n{table}'
        with pytest.raises(SettingsError, match=r"level\.0\.policy\.l\w+: .*finite number"):
            parse(tomllib.loads(scenario), origin="x")


def test_more_blocks_than_a_status_can_name_are_refused() -> None:
    blocks = [{"name": f"b{number}"} for number in range(MOST_BLOCKS + 1)]
    assert len(parse({"scenario": "x", "block": blocks[:-1]}, origin="x").block) == MOST_BLOCKS
    with pytest.raises(SettingsError, match=rf"^x: block: .*at most {MOST_BLOCKS} items") as refusal:
        parse({"scenario": "x", "block": blocks}, origin="x")
    assert len(str(refusal.value)) < 500
