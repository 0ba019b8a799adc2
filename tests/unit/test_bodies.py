"""Blocks described by patterns of names, made a tree on a world."""

from dataclasses import dataclass
from typing import Any

import pytest

from babble.blocks import BlockError, BlockTree
from babble.bodies import remarks, tree_of
from babble.worlds import World, make

FINGERS = {"index": "ff", "middle": "mf", "ring": "rf", "little": "lf", "thumb": "th"}
SEEING = {"senses": ["position", "vision"], "vision": {"resolution": 4}}


@dataclass(frozen=True)
class Block:
    """A block as a scenario describes it."""

    name: str
    observes: Any = None
    drives: Any = None
    children: Any = ()
    latent_dim: int = 2


def world_of(id: str = "MimoHand", **parameters: Any) -> World:
    return make(id, parameters, columns=1, seed=0)


def hand(world: World) -> BlockTree:
    leaves = [Block(name, [f"*_{short}_*"], [f"*_{short}*_*"]) for name, short in FINGERS.items()]
    return tree_of([*leaves, Block("hand", children=list(FINGERS))], world)


def test_a_pattern_without_a_sense_chooses_from_all_senses_in_the_order_of_the_body() -> None:
    world = world_of(senses=["velocity", "position"])
    tree = hand(world)
    assert tree.levels == 2
    chosen = [world.observation_names[index] for index in tree.observed("thumb")]
    assert chosen == [
        "velocity/robot:right_th_middle",
        "velocity/robot:right_th_distal",
        "position/robot:right_th_middle",
        "position/robot:right_th_distal",
    ]
    assert [world.action_names[index] for index in tree.driven("thumb")] == [
        "act:right_thumb_middle",
        "act:right_thumb_distal",
    ]
    assert tree.driven_through("hand").tolist() == list(range(14))
    assert [leaf.name for leaf in tree.leaves_of("hand")] == list(FINGERS)


def test_a_pattern_with_a_slash_names_the_sense_too() -> None:
    world = world_of(senses=["position", "velocity"])
    tree = tree_of([Block("hand", ["position/*", "velocity/*_ff_*", "!*_distal"])], world)
    names = [world.observation_names[index] for index in tree.observed("hand")]
    assert len(names) == 9 + 2
    assert names[-2:] == ["velocity/robot:right_ff_knuckle", "velocity/robot:right_ff_middle"]
    assert not any("distal" in name for name in names)


def test_numbers_and_nothing_at_all_mean_what_they_always_did() -> None:
    tree = tree_of([Block("x", [0], [0]), Block("yz", [2, 1], [1, 2])], world_of("Cuboid"))
    assert tree.observed("yz").tolist() == [2, 1]
    assert tree_of([Block("body")], world_of("Cuboid")).driven("body").tolist() == [0, 1, 2]


def test_what_senses_with_several_numbers_per_name_are_called() -> None:
    world = world_of("MimoRollover", senses=["vestibular", "touch"], touch={"resolution": 0.5})
    tree = tree_of([Block("body", ["vestibular_gyro", "touch/left_*"])], world)
    names = [world.observation_names[index] for index in tree.observed("body")]
    assert names[:3] == ["vestibular/vestibular_gyro"] * 3
    assert {name.partition("_")[0] for name in names[3:]} == {"touch/left"}
    muscles = world_of(actuation="muscles", senses=["actuation"])
    assert tree_of([Block("hand", drives=["*"])], muscles).driven("hand").size == 28
    assert muscles.observation_names[:1] == ("actuation/act:right_ff_knuckle",)
    assert len(muscles.observation_names) == muscles.observation_size == 56


def test_eyes_are_observed_whole_or_not_at_all() -> None:
    world = world_of("MimoRollover", **SEEING)
    both = tree_of([Block("body", ["vision/*"])], world)
    assert both.observation_size_of("body") == 2 * 4 * 4 * 3
    with pytest.raises(BlockError, match=r"block 'body' observes what it cannot: .*images whole"):
        tree_of([Block("body", ["eye_left"])], world)


@pytest.mark.parametrize(
    ("blocks", "sentence"),
    [
        (
            [Block("a", drives=["act:right_ff_knucle"])],
            "block 'a' drives: no actuator matches 'act:right_ff_knucle'; the nearest are act:right_ff_knuck",
        ),
        (
            [Block("a", ["positon/robot:right_ff_distal"])],
            "block 'a' observes: no component of the observation matches .* position/robot:right_ff_distal",
        ),
        ([Block("a", ["*", "!*"])], r"block 'a' observes: the patterns .* leave no component"),
        ([Block("a", ["*", 3])], "block 'a' observes numbers and patterns of names; give one or the other"),
        ([Block("a", [1, 2, 1])], "block 'a' observes 1 twice"),
        (
            [Block("index", drives=["*", "!*_rf_*"]), Block("ring", drives=["*_rf_*", "*_knuckle"])],
            "actuator act:right_ff_knuckle is driven by both 'index' and 'ring'; take it out of one",
        ),
        (
            [Block("a", drives=["*", "!*_distal"])],
            r"no block drives 5 of the world's 14 actuators \(act:right_ff_distal, act:right_mf_distal, "
            r"act:right_rf_distal, \.\.\.\)",
        ),
    ],
)
def test_patterns_that_make_no_tree_are_refused_by_name(blocks: list[Block], sentence: str) -> None:
    with pytest.raises(BlockError, match=sentence):
        tree_of(blocks, world_of())


def test_what_blocks_leave_out_or_share_is_remarked() -> None:
    world = world_of()
    assert remarks(hand(world), world) == []
    assert remarks(tree_of([Block("hand", ["*_ff_*"])], world), world) == [], (
        "one block may see what it likes"
    )
    blocks = [Block("a", ["*_ff_*", "*_mf_*"], ["*_ff_*"]), Block("b", ["*_mf_*"], ["*", "!*_ff_*"])]
    assert remarks(tree_of(blocks, world), world) == [
        "nobody observes 8 of 14 components (position/robot:right_rf_knuckle, "
        "position/robot:right_rf_middle, position/robot:right_rf_distal, ...)",
        "more than one block observes 3 of 14 components (position/robot:right_mf_knuckle, "
        "position/robot:right_mf_middle, position/robot:right_mf_distal)",
    ]
