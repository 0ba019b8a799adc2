"""Intrinsic dimensions of clouds with known ones, against the thesis's equations and scikit-dimension."""

import numpy as np
import pytest
from skdim.id import MLE, TwoNN

from babble.coverage import neighbour_ratios, spread_rows, twonn
from babble.coverage_neighbours import dimensions, likely_dimension, neighbour_distances
from tests.unit.coverage_clouds import Floats, embedded, gaussian, sphere, swiss_roll

TRUE = {
    "circle": (embedded(sphere(3000, 1)), 1),
    "sphere of 2": (embedded(sphere(3000, 2)), 2),
    "sphere of 5": (embedded(sphere(3000, 5)), 5),
    "swiss roll": (embedded(swiss_roll(3000)), 2),
    "ball of 8": (embedded(gaussian(3000, np.ones(8))), 8),
    "pancake": (embedded(gaussian(3000, np.array([5.0, 5.0, 1e-4]))), 2),
}


@pytest.mark.parametrize("name", TRUE)
def test_the_dimension_of_a_low_cloud_is_found_by_all_three(name: str) -> None:
    states, true = TRUE[name]
    rows, without_tail, with_all, check = dimensions(states)
    assert rows == 3000
    assert [without_tail, with_all, check] == pytest.approx([true] * 3, rel=0.12)


def test_a_high_dimension_is_underestimated_as_the_page_says() -> None:
    _, without_tail, _, check = dimensions(embedded(gaussian(6000, np.ones(30))))
    assert 22 < without_tail < 27
    assert 20 < check < without_tail


@pytest.mark.parametrize("discard", [0.0, 0.1, 0.5])
def test_exact_quantiles_of_the_power_law_give_the_dimension_itself(discard: float) -> None:
    share = (np.arange(1, 1001) - 0.5) / 1000
    assert twonn((1 - share) ** (-1 / 27.28), discard) == pytest.approx(27.28)


def test_the_regression_is_that_of_numpy_on_the_kept_ratios() -> None:
    ratios = neighbour_ratios(TRUE["sphere of 5"][0])
    share = (np.arange(1, 3001) - 0.5) / 3000
    x, y = np.log(ratios)[:2700], -np.log(1 - share)[:2700]
    (slope,), *_ = np.linalg.lstsq(x[:, None], y, rcond=None)
    assert twonn(ratios) == pytest.approx(slope)


@pytest.mark.parametrize("dims", [2, 8, 25])
def test_scikit_dimension_agrees_on_twonn_and_on_the_check(dims: int) -> None:
    states = embedded(gaussian(2000, np.linspace(2, 1, dims)))
    # Its F_i is (i - 1) / N, ours (i - 0.5) / N.
    assert twonn(neighbour_ratios(states)) == pytest.approx(TwoNN().fit(states).dimension_, rel=0.005)
    theirs = MLE().fit(states.astype(np.float64), n_neighbors=20).dimension_
    assert dimensions(states)[3] == pytest.approx(theirs, rel=1e-5)


def test_the_check_is_the_formula_of_levina_and_bickel() -> None:
    distances = neighbour_distances(gaussian(500, np.ones(4)), 20)
    logs = np.log(distances[:, -1:] / distances[:, :-1])
    assert likely_dimension(distances) == pytest.approx(1 / logs.mean(axis=1).mean())


def test_neighbours_are_the_nearest_even_far_from_the_origin() -> None:
    states = gaussian(300, np.full(6, 1e-3)) + 1000.0
    apart = np.linalg.norm(states[:, None] - states, axis=2)
    assert neighbour_distances(states, 3) == pytest.approx(np.sort(apart, axis=1)[:, 1:4])


def test_equal_rows_count_once() -> None:
    states: Floats = embedded(gaussian(200, np.ones(3)))
    doubled = np.concatenate([states, states, states[:50]])
    assert neighbour_ratios(doubled) == pytest.approx(neighbour_ratios(states))
    with pytest.raises(ValueError, match="three or more different rows, got 2"):
        neighbour_ratios(np.array([[0.0], [1.0], [-0.0]]))


def test_discarding_all_or_a_grid_is_refused() -> None:
    with pytest.raises(ValueError, match=r"discarding 1\.0 of 3 neighbour ratios leaves nothing"):
        twonn(np.array([1.1, 1.2, 1.3]), discard=1.0)
    with pytest.raises(ValueError, match="a grid"):
        twonn(np.ones(10))


def test_sampled_rows_lie_one_in_each_part_of_the_run() -> None:
    rows = spread_rows(1_000_000, 6000, seed=4)
    assert (np.floor(rows * 6000 / 1_000_000) == np.arange(6000)).mean() > 0.98
    assert np.diff(rows).min() >= 1
    assert rows[-1] < 1_000_000
    assert rows.tolist() == spread_rows(1_000_000, 6000, seed=4).tolist()
    assert spread_rows(100, 6000).tolist() == list(range(100))


def test_samples_do_not_beat_against_episodes() -> None:
    """Evenly spaced, 6000 of a million rows would meet an episode of 500 steps at three places only."""
    place = spread_rows(1_000_000, 6000) % 500
    counts, _ = np.histogram(place, bins=10, range=(0, 500))
    assert counts.min() > 450


def test_dense_samples_measure_the_trajectory() -> None:
    """A slow walk in ten dimensions: neighbouring rows lie on a curve, spread ones fill the ball."""
    rng, walk = np.random.default_rng(0), np.zeros((60_000, 10))
    for row in range(1, len(walk)):
        walk[row] = 0.98 * walk[row - 1] + 0.2 * rng.standard_normal(10)
    dense, spread = walk[:1500], walk[spread_rows(len(walk), 1500)]
    assert twonn(neighbour_ratios(dense), 0.0) < 0.8 * twonn(neighbour_ratios(spread), 0.0)
