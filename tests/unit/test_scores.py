import numpy as np
import pytest

from babble.landmarks import Landmark
from babble.policy.goals import one_hot
from babble.scores import Legs, Walker, score, walk_blocks, walk_legs
from babble.worlds import make

ENDS = np.array([[-1.0, 0.0, 0.0], [1.0, 0.0, 0.0]])


def perfect(goal):
    goal = np.asarray(goal)
    return Legs(ENDS[goal], one_hot(goal, 2), goal)


def test_a_perfect_walk():
    found = score(perfect([[0, 1], [1, 0], [0, 1], [1, 0]]), 2.0, 0)
    assert found == {
        "separation": 1.0,
        "separation_worst": 1.0,
        "z_min": 1.0,
        "z_goal": 1.0,
        "switch_success": 1.0,
        "crossing": 1.0,
        "landmarks": {},
        "landmark_vertices": {},
        "external_reward": None,
        "external_reward_by_vertex": None,
    }


def test_the_first_leg_is_not_scored():
    legs = perfect([[0, 1], [1, 0], [0, 1]])
    legs.posture[0] = 50.0
    legs.latent[0] = 0.5
    assert score(legs, 2.0, 0)["z_min"] == 1.0
    assert score(legs, 2.0, 0)["separation"] == 1.0


def test_the_worst_vertex_counts():
    legs = perfect([[0], [1], [0], [1]])
    legs.latent[1] = legs.latent[3] = [0.4, 0.6]
    found = score(legs, 2.0)
    assert found["z_min"] == pytest.approx(0.6)
    assert found["z_goal"] == pytest.approx((0.6 + 1 + 0.6) / 3)
    assert found["switch_success"] == pytest.approx(1 / 3)
    assert found["crossing"] is None


def test_separation_is_over_the_diameter_and_has_a_worst_pair():
    legs = perfect([[0, 0], [1, 1], [0, 0], [1, 1]])
    legs.posture[3, 1] = [0.0, 0.0, 0.0]
    found = score(legs, 4.0, 0)
    assert found["separation"] == pytest.approx((2 + 2 + 2 + 1) / 4 / 4)
    assert found["separation_worst"] == pytest.approx(0.25)
    assert found["crossing"] == pytest.approx(0.75)


def test_the_other_side_must_be_reached_to_cross():
    legs = perfect([[0], [1], [0]])
    legs.posture[:] = [0.2, 0.0, 0.0]
    assert score(legs, 2.0, 0)["crossing"] == 0.0


def lying(*sides):
    """Legs of one column that ended with these sides, after a first one that is not scored."""
    goal = np.arange(len(sides) + 1)[:, None] % 2
    return Legs(ENDS[goal], one_hot(goal, 2), goal, side=np.array([0.9, *sides])[:, None])


@pytest.mark.parametrize(
    ("sides", "crossing"),
    [
        ((1.0, -1.0, 1.0), 1.0),
        ((0.6, -0.6, -0.9), 0.5),
        ((1.0, 0.9, 1.0), 0.0),
        ((1.0, -0.5, 1.0), 0.0),
        ((0.4, -0.4, 0.4), 0.0),
        ((1.0, 0.1, -1.0, 1.0), pytest.approx(1 / 3)),
    ],
    ids=["rolls", "rolls once", "stays", "only to a flank", "rocks on a flank", "a flank on the way"],
)
def test_a_body_crosses_when_it_rolls_from_back_to_belly_or_back(sides, crossing):
    assert score(lying(*sides), 2.0)["crossing"] == crossing


def test_sides_are_for_worlds_without_halves():
    assert score(lying(1.0, 1.0, 1.0), 2.0, 0)["crossing"] == 1.0, "of the axis, whose sides do change"


def test_more_than_two_vertices_are_compared_in_pairs_of_their_mean_ends():
    corners = np.array([[0.0, 0.0], [3.0, 4.0], [0.0, 4.0], [9.0, 9.0]])
    goal = np.array([[0, 1], [0, 1], [1, 2], [2, 0]])
    found = score(Legs(corners[goal], one_hot(goal, 4), goal), 10.0)
    assert found["separation"] == pytest.approx((5 + 4 + 3) / 3 / 10)
    assert found["separation_worst"] == pytest.approx(0.3)
    assert found["z_min"] == 1.0, "a vertex that was never a goal says nothing"


LEFT, RIGHT = Landmark("left", ((0,),), -1.0, -0.8), Landmark("right", ((0,),), 0.8, 1.0)


def test_a_landmark_is_reached_by_the_legs_to_the_vertex_that_stands_for_it():
    legs = perfect([[0, 0], [1, 1], [0, 0], [1, 1], [0, 0]])
    legs.posture[3, 0] = 0.0
    found = score(legs, 2.0, landmarks=[RIGHT, LEFT])
    assert found["landmark_vertices"] == {"right": 1, "left": 0}
    assert found["landmarks"] == {"right": 0.75, "left": 1.0}


def test_the_first_leg_counts_for_no_landmark():
    legs = perfect([[0], [1], [0]])
    legs.posture[0] = 0.0
    assert score(legs, 2.0, landmarks=[LEFT])["landmarks"] == {"left": 1.0}


def test_a_landmark_that_no_leg_reaches_has_no_vertex():
    found = score(perfect([[0], [1], [0]]), 2.0, landmarks=[LEFT, Landmark("up", ((1,),), 0.5, 1.0)])
    assert found["landmarks"] == {"left": 1.0, "up": 0.0}
    assert found["landmark_vertices"] == {"left": 0}


def test_vertices_are_given_to_landmarks_so_that_the_sum_of_shares_is_greatest():
    ends = np.array([[0.2, 0.2, 0.2, 0.5], [0.6, 0.6, 0.6, -1.0]])  # by vertex and column
    goal = np.repeat([[0], [1], [0], [1]], 4, axis=1)
    legs = Legs(ends[goal, np.arange(4)][:, :, None], one_hot(goal, 2), goal)
    wide, narrow = Landmark("wide", ((0,),), 0.1, 1.0), Landmark("narrow", ((0,),), 0.15, 0.3)
    found = score(legs, 1.0, landmarks=[wide, narrow])
    assert found["landmark_vertices"] == {"wide": 1, "narrow": 0}, (
        "all of vertex 0 is wide, but no other narrow"
    )
    assert found["landmarks"] == {"wide": 0.75, "narrow": 0.75}


def test_more_landmarks_than_vertices_leave_some_without():
    landmarks = [LEFT, RIGHT, Landmark("anywhere", ((1,),), -1.0, 1.0)]
    found = score(perfect([[0], [1], [0]]), 2.0, landmarks=landmarks)
    assert sum(found["landmarks"].values()) == 2.0
    assert len(found["landmark_vertices"]) == 2


def test_a_landmark_needs_all_of_its_groups_there():
    hand = Landmark("closed", ((0,), (1, 2)), 0.8, 1.0)
    posture = np.array([[1.0, 1.0, 1.0], [1.0, 1.0, 0.0], [0.0, 1.0, 1.0], [0.8, 0.7, 0.9]])
    np.testing.assert_array_equal(hand.at(posture), [True, False, False, True])


def test_the_external_reward_is_the_mean_over_scored_legs_and_by_vertex():
    goal = np.array([[0, 0], [1, 1], [0, 0]])
    rewards = np.array([[9.0, 9.0], [1.0, 2.0], [-1.0, 0.0]])
    found = score(Legs(np.zeros((3, 2, 1)), one_hot(goal, 3), goal, external_reward=rewards), 1.0)
    assert found["external_reward"] == 0.5
    assert found["external_reward_by_vertex"] == [-0.5, 1.5, None]


def test_a_task_that_gave_nothing_has_a_reward_of_nothing():
    goal = np.array([[0, 1], [1, 0], [0, 1]])
    legs = Legs(np.zeros((3, 2, 1)), one_hot(goal, 2), goal, external_reward=np.zeros((3, 2)))
    found = score(legs, 1.0)
    assert found["external_reward"] == 0.0
    assert found["external_reward_by_vertex"] == [0.0, 0.0]


def test_rewards_of_another_shape_are_refused():
    goal = np.zeros((3, 2), int)
    legs = Legs(np.zeros((3, 2, 1)), one_hot(goal, 2), goal, external_reward=np.zeros((3, 1)))
    with pytest.raises(ValueError, match=r"external_reward \(3, 1\)"):
        score(legs, 1.0)


@pytest.mark.parametrize("goal", [[[0], [1]], []])
def test_too_few_legs_are_refused(goal):
    goal = np.array(goal, int).reshape(-1, 1)
    with pytest.raises(ValueError, match="three or more legs"):
        score(perfect(goal), 2.0)


class Slope:
    """A latent that is linear in the first number it sees, for tests."""

    latent_dim = 2

    def latent(self, observation):
        first = (observation[:, :1] + 1) / 2
        return np.concatenate([1 - first, first], axis=1)


class TowardsGoal:
    """Drives its first actuator to the end that the goal names, and leaves the others."""

    def __init__(self, actuators=3):
        self.actuators = actuators
        self.modes = set()

    def act(self, z, g, rng, mode="sampled"):
        self.modes.add(mode)
        action = np.zeros((len(z), self.actuators), np.float32)
        action[:, 0] = g[:, 1] - g[:, 0]
        return action, np.zeros(len(z), np.float32)


def test_a_walk_in_a_world_ends_where_the_goals_are():
    world, policy = make("Cuboid", {"half_sizes": (1, 0.2, 0.2)}, 6, 0), TowardsGoal()
    legs = walk_legs(world, Slope(), policy, np.random.default_rng(0), 5, 30, "mean")
    assert (legs.posture.shape, legs.latent.shape, legs.goal.shape) == ((5, 6, 3), (5, 6, 2), (5, 6))
    np.testing.assert_allclose(legs.posture[:, :, 0], 2 * legs.goal - 1)
    assert (legs.goal[1:] != legs.goal[:-1]).all()
    assert len(np.unique(legs.start_posture, axis=0)) == 6, "each column starts somewhere else"
    assert policy.modes == {"mean"}
    assert score(legs, 2.0, 0)["z_min"] == pytest.approx(1.0)


def test_legs_that_are_too_short_do_not_arrive():
    world = make("Cuboid", {"half_sizes": (1, 0.2, 0.2)}, 6, 0)
    legs = walk_legs(world, Slope(), TowardsGoal(), np.random.default_rng(0), 4, 5)
    found = score(legs, world.diameter)
    assert found["switch_success"] < 0.5
    assert found["separation"] < 0.3


def test_blocks_walk_at_once_each_to_its_own_vertices_with_its_own_part_of_the_body():
    world = make("Cuboid", {"half_sizes": (1, 1, 1)}, 8, 0)
    walkers = {
        "x": Walker(Slope(), TowardsGoal(1), np.array([0]), np.array([0])),
        "zy": Walker(Slope(), TowardsGoal(2), np.array([2, 1]), np.array([2, 1])),
    }
    legs = walk_blocks(world, walkers, np.random.default_rng(0), 4, 30)
    assert (legs["x"].goal != legs["zy"].goal).any()
    for block, axis in (("x", 0), ("zy", 2)):
        np.testing.assert_allclose(legs[block].posture[:, :, axis], 2 * legs[block].goal - 1)
        assert score(legs[block], 2.0)["z_min"] == pytest.approx(1.0)
    np.testing.assert_allclose(legs["x"].posture[-1, :, 1], legs["x"].start_posture[:, 1])


@pytest.mark.parametrize(("latent", "near"), [([5.0, -4.0], -3.0), ([1.0, 0.0], 1.0), ([1.2, 0.0], 0.86)])
def test_off_the_simplex_a_latent_far_beyond_a_vertex_has_not_reached_it(latent, near):
    legs = perfect([[0], [1], [0], [1]])
    legs.latent[2] = latent
    found = score(legs, 2.0)
    assert found["z_goal"] == pytest.approx((2 + near) / 3, abs=0.01)
    assert (found["switch_success"] == 1.0) is (near == 1.0)
