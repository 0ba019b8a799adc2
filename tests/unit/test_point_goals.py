"""Goals that are random points of the simplex (thesis 4.5, C4)."""

import numpy as np
import pytest

from babble.policy.goals import PointClock


def clock_of(columns=64, latent_dim=4, period_steps=None, seed=0):
    return PointClock(columns, latent_dim, period_steps, np.random.default_rng(seed))


def test_goals_are_uniform_on_the_simplex_and_not_its_vertices():
    goal = clock_of(columns=20_000).goal
    assert goal.dtype == np.float32
    assert (goal > 0).all()
    np.testing.assert_allclose(goal.sum(axis=1), 1, atol=1e-6)
    np.testing.assert_allclose(goal.mean(axis=0), 0.25, atol=0.01)
    # Dirichlet(1, 1, 1, 1): each component has P(g > x) = (1 - x)^3.
    for x in (0.1, 0.5, 0.9):
        np.testing.assert_allclose((goal > x).mean(axis=0), (1 - x) ** 3, atol=0.01)


def test_a_goal_holds_until_the_episode_of_its_own_column_ends():
    clock, rng = clock_of(), np.random.default_rng(1)
    for _ in range(300):
        before, ended = clock.goal, rng.random(64) < 0.05
        kept = before.copy()
        np.testing.assert_array_equal(clock.tick(ended), ended)
        assert (clock.goal[ended] != before[ended]).all()
        np.testing.assert_array_equal(clock.goal[~ended], before[~ended])
        np.testing.assert_array_equal(before, kept)
    assert not clock.tick().any()


def test_goals_of_columns_and_of_episodes_are_not_correlated():
    clock, drawn = clock_of(columns=2), []
    for _ in range(4000):
        drawn.append(clock.goal)
        clock.tick(np.array([True, True]))
    first, second = np.stack(drawn).transpose(1, 0, 2)
    for one, other in ((first, second), (first[1:], first[:-1])):
        assert np.abs(np.corrcoef(one.T, other.T)[:4, 4:]).max() < 0.06


def test_without_episodes_goals_change_every_period_out_of_phase():
    clock = clock_of(period_steps=20)
    switched = np.stack([clock.tick(np.zeros(64, bool)) for _ in range(100)])
    assert (switched.sum(axis=0) == 5).all()
    for column in switched.T:
        assert set(np.diff(np.flatnonzero(column))) == {20}
    assert len(np.unique(switched.argmax(axis=0))) > 12


def test_an_end_within_a_period_begins_another():
    clock = clock_of(columns=1, period_steps=10)
    while not clock.tick()[0]:
        pass
    for _ in range(6):
        assert not clock.tick(np.array([False]))[0]
    assert clock.tick(np.array([True]))[0]
    assert [bool(clock.tick()[0]) for _ in range(10)] == [False] * 9 + [True]


@pytest.mark.parametrize("wrong", [(0, 2, None), (1, 1, None), (1, 2, 0)])
def test_clocks_that_cannot_be_are_refused(wrong):
    with pytest.raises(ValueError, match="goals need"):
        PointClock(*wrong, np.random.default_rng(0))
