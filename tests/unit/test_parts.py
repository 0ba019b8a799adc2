"""The part of a body that a block moves, and by which it is scored."""

from dataclasses import replace

import numpy as np
import pytest

from babble.bodies import tree_of
from babble.legs import Legs
from babble.parts import part_of_block
from babble.policy.goals import one_hot
from babble.scores import score
from babble.worlds import make
from tests.unit.test_bodies import Block, hand

NEAR = 0.85


def legs_of(posture: np.ndarray) -> Legs:
    """Legs (L, p) of one column, whose goals alternate."""
    goal = np.arange(len(posture))[:, None] % 2
    return Legs(posture[:, None], one_hot(goal, 2), goal, start_posture=posture[:1])


def bent(world, index: float, others: float) -> np.ndarray:
    """(p,) a hand whose index finger's joints are at `index` and all others at `others`."""
    return np.array([index if "_ff_" in name else others for name in world.posture_names])


def test_a_finger_of_a_hand_is_scored_by_itself() -> None:
    world = make("MimoHand", {}, 1, 0)
    part = part_of_block(world, hand(world), "index")
    assert part.components.tolist() == [0, 1, 2]
    assert part.diameter == pytest.approx(2 * np.sqrt(3))
    legs = legs_of(np.array([bent(world, 1, 0.1), bent(world, -1, 0.3), bent(world, 1, -1)] * 2))
    cut = part.cut(legs)
    assert cut.posture.shape == (6, 1, 3)
    assert cut.start_posture.shape == (1, 3)
    found = score(cut, part.diameter, part.crossing_axis, part.landmarks)
    assert found["separation"] == pytest.approx(0.75), "each fourth pair of legs ends alike"
    assert set(found["landmarks"]) == {"open", "closed"}


def test_a_finger_is_closed_when_each_of_its_joints_is_and_a_hand_by_each_fingers_mean() -> None:
    world = make("MimoHand", {}, 1, 0)
    closed = {
        block: next(
            landmark
            for landmark in part_of_block(world, hand(world), block).landmarks
            if landmark.name == "closed"
        )
        for block in ("index", "hand")
    }
    posture = bent(world, NEAR, NEAR)
    posture[1], posture[0] = 0.7, 1.0
    assert closed["hand"].at(posture)
    assert not closed["index"].at(posture[:3])
    assert closed["index"].at(bent(world, NEAR, -1)[:3])
    assert not closed["hand"].at(bent(world, NEAR, -1))


def test_the_block_above_all_fingers_has_the_whole_hand() -> None:
    world = make("MimoHand", {}, 1, 0)
    for part in (
        part_of_block(world, hand(world), "hand"),
        part_of_block(world, tree_of([Block("hand")], world), "hand"),
    ):
        assert part.components.tolist() == list(range(14))
        assert (part.diameter, part.landmarks) == (world.diameter, world.landmarks)


def test_a_block_between_has_the_fingers_below_it() -> None:
    world = make("MimoHand", {}, 1, 0)
    leaves = [
        Block("index", drives=["*_ff_*"]),
        Block("thumb", drives=["*thumb*"]),
        Block("others", drives=["*", "!*_ff_*", "!*thumb*"]),
    ]
    between = Block("pinch", children=["thumb", "index"])
    tree = tree_of([*leaves, between, Block("hand", children=["pinch", "others"])], world)
    part = part_of_block(world, tree, "pinch")
    assert part.components.tolist() == [0, 1, 2, 12, 13]
    assert [landmark.groups for landmark in part.landmarks] == [((0, 1, 2), (3, 4))] * 2


@pytest.mark.parametrize(
    ("id", "components", "diameter", "crossing_axis"),
    [
        ("Cuboid", [0], 2.0, None),
        ("Cuboid", [1, 2], 2 * np.hypot(0.6, 0.3), None),
        ("Ellipsoid", [1, 2], 1.2, None),
        ("Dumbbell", [1, 2], 1.0, None),
        ("Dumbbell", [0, 2], 2.8, 0),
        ("Dumbbell", [0, 1, 2], 2.8, 0),
    ],
)
def test_a_point_has_the_span_of_its_axes_and_crosses_along_one(
    id: str, components: list[int], diameter: float, crossing_axis: int | None
) -> None:
    world = make(id, {}, 1, 0)
    rest = [axis for axis in range(3) if axis not in components]
    blocks = [Block("part", drives=components), *([Block("rest", drives=rest)] if rest else [])]
    part = part_of_block(world, tree_of(blocks, world), "part")
    assert part.components.tolist() == components
    assert part.diameter == pytest.approx(diameter)
    assert part.crossing_axis == crossing_axis
    points = world.uniform_points(3000, np.random.default_rng(0))[:, components]
    apart = np.linalg.norm(points[:, None] - points[None, :300], axis=2).max()
    assert 0.85 * diameter < apart <= diameter + 1e-6


def test_actuators_that_move_nothing_of_the_posture_have_the_whole_of_it() -> None:
    world = make("MimoHand", {}, 1, 0)
    tree = hand(world)
    world.moves = tuple(
        () if "_ff_" in name else moved for name, moved in zip(world.action_names, world.moves, strict=True)
    )
    assert part_of_block(world, tree, "index").components.size == 14
    assert part_of_block(world, tree, "ring").components.tolist() == [6, 7, 8]


def test_a_cut_leaves_the_rest_of_the_legs_as_it_is() -> None:
    world = make("MimoHand", {}, 1, 0)
    legs = replace(legs_of(np.zeros((3, 14))), start_posture=None)
    cut = part_of_block(world, hand(world), "thumb").cut(legs)
    assert cut.start_posture is None
    assert cut.posture.shape == (3, 1, 2)
    np.testing.assert_array_equal(cut.goal, legs.goal)


def test_only_a_block_that_drives_the_whole_body_is_scored_by_the_side_it_lies_on() -> None:
    world = make("MimoHand", {}, 1, 0)
    legs = replace(legs_of(np.zeros((3, 14))), side=np.array([[1.0], [-1.0], [1.0]]))
    crossing = {
        block: score(part_of_block(world, hand(world), block).cut(legs), 1.0)["crossing"]
        for block in ("index", "hand")
    }
    assert crossing == {"index": None, "hand": 1.0}
