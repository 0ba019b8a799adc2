import numpy as np
import pytest

from babble.policy.goals import GoalClock, WalkClock, one_hot, reward


def test_vertices():
    np.testing.assert_array_equal(one_hot([2, 0], 3), [[0, 0, 1], [1, 0, 0]])
    assert one_hot(np.zeros((4, 5), int), 3).shape == (4, 5, 3)
    assert one_hot(1, 2).dtype == np.float32


@pytest.mark.parametrize(
    ("form", "expected"),
    [("squared", [-2.0, -0.02, 0.0]), ("dense", [-np.sqrt(2), -np.sqrt(0.02), 0.0]), ("sparse", [-1, -1, 0])],
)
def test_the_reward_of_three_states(form, expected):
    z = np.array([[0.0, 1.0], [0.9, 0.1], [1.0, 0.0]], np.float32)
    found = reward(z, one_hot([0, 0, 0], 2), form, 0.1)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert found.dtype == np.float32


def test_the_sparse_radius_decides():
    z, g = np.array([[[0.9, 0.1]]]), one_hot([[0]], 2)
    assert reward(z, g, "sparse", 0.15).tolist() == [[0.0]]
    assert reward(z, g, "sparse", 0.14).tolist() == [[-1.0]]


def test_another_reward_is_refused():
    with pytest.raises(ValueError, match="choose squared, dense or sparse"):
        reward(np.zeros(2), np.zeros(2), "cubed")


def switches(clock, steps):
    return np.stack([clock.tick() for _ in range(steps)])


def test_goals_change_every_period_out_of_phase():
    clock = GoalClock(64, 3, 20, np.random.default_rng(0))
    switched = switches(clock, 100)
    assert (switched.sum(axis=0) == 5).all()
    for column in switched.T:
        assert set(np.diff(np.flatnonzero(column))) == {20}
    first = switched.argmax(axis=0)
    assert len(np.unique(first)) > 12
    assert first.max() < 20


def test_goals_are_uniform_over_the_vertices_and_may_repeat():
    clock = GoalClock(400, 4, 1, np.random.default_rng(0))
    drawn = []
    for _ in range(50):
        drawn.append(clock.index)
        clock.tick()
    drawn = np.stack(drawn)
    np.testing.assert_allclose(np.bincount(drawn.ravel()) / drawn.size, 0.25, atol=0.02)
    assert (drawn[1:] == drawn[:-1]).mean() == pytest.approx(0.25, abs=0.02)


def test_a_goal_once_read_does_not_change():
    clock = GoalClock(8, 2, 3, np.random.default_rng(0))
    goal, index = clock.goal, clock.index
    kept = goal.copy(), index.copy()
    switches(clock, 30)
    np.testing.assert_array_equal(goal, kept[0])
    np.testing.assert_array_equal(index, kept[1])
    assert goal.shape == (8, 2)
    assert (goal.sum(axis=1) == 1).all()


def test_only_columns_that_switched_have_new_goals():
    clock = GoalClock(50, 5, 7, np.random.default_rng(0))
    for _ in range(40):
        before = clock.index
        switched = clock.tick()
        assert (clock.index == before)[~switched].all()


@pytest.mark.parametrize("d", [2, 3, 8])
def test_a_walk_goes_to_another_vertex_each_time_and_reaches_all(d):
    clock = WalkClock(30, d, 4, np.random.default_rng(0))
    visited = []
    for _ in range(100):
        before = clock.index
        switched = switches(clock, 4)
        assert not switched[:3].any()
        assert switched[3].all()
        assert (clock.index != before).all()
        visited.append(clock.index)
    np.testing.assert_allclose(np.bincount(np.concatenate(visited), minlength=d) / 3000, 1 / d, atol=0.03)


@pytest.mark.parametrize("wrong", [(0, 2, 5), (1, 1, 5), (1, 2, 0)])
def test_clocks_that_cannot_be_are_refused(wrong):
    with pytest.raises(ValueError, match="goals need"):
        GoalClock(*wrong, np.random.default_rng(0))
