"""What turning, moving, scaling and shuffling a cloud do to its metrics, and what they do not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from babble.coverage import Coverage, coverage, visited_cells_entropy
from tests.unit.coverage_clouds import Floats, gaussian, rotation

LENGTHS = ("diameter", "radius", "centre_first", "centre_last", "centre_sum")
SHAPES = ("participation_ratio", "twonn", "twonn_all", "intrinsic_check")
ROWS, DIMS = 250, 6
seeds = st.integers(0, 2**16)


def cloud(seed: int) -> Floats:
    return gaussian(ROWS, np.linspace(3, 0.5, DIMS), seed).astype(np.float32)


def of(states: Floats) -> Coverage:
    return coverage(states.astype(np.float32), centres=12)


def same(one: Coverage, other: Coverage, names: tuple[str, ...], factor: float = 1.0) -> None:
    # Greedy k-centre may choose another of two rows that are equally far up to rounding.
    assert [getattr(other, name) for name in names] == pytest.approx(
        [factor * getattr(one, name) for name in names], rel=2e-3
    )


@settings(max_examples=15, deadline=None)
@given(seeds, seeds)
def test_a_turned_cloud_is_as_large_and_of_the_same_shape(seed: int, turn: int) -> None:
    states = cloud(seed)
    turned = of((states @ rotation(DIMS, turn)).astype(np.float32))
    same(of(states), turned, LENGTHS + SHAPES)
    assert turned.diameter <= turned.box_diagonal * (1 + 1e-6)


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(-1000, 1000, width=32))
def test_a_moved_cloud_is_as_large_and_of_the_same_shape(seed: int, shift: float) -> None:
    states = cloud(seed)
    same(of(states), of(states + np.float32(shift)), (*LENGTHS, "box_diagonal", *SHAPES))


@settings(max_examples=15, deadline=None)
@given(seeds, st.floats(0.01, 100.0))
def test_a_scaled_cloud_has_scaled_distances_and_the_same_dimensions(seed: int, factor: float) -> None:
    states = cloud(seed)
    scaled = of(states * np.float32(factor))
    same(of(states), scaled, (*LENGTHS, "box_diagonal"), factor)
    same(of(states), scaled, SHAPES)
    assert scaled.variances == pytest.approx([factor**2 * value for value in of(states).variances], rel=1e-4)


@settings(max_examples=15, deadline=None)
@given(seeds, seeds)
def test_the_order_of_rows_does_not_matter_where_all_are_sampled(seed: int, shuffle: int) -> None:
    states = cloud(seed)
    shuffled = np.random.default_rng(shuffle).permutation(states)
    same(of(states), of(shuffled), (*LENGTHS, "box_diagonal", *SHAPES, "visited_cells_entropy"))


@settings(max_examples=15, deadline=None)
@given(seeds)
def test_more_rows_never_make_a_cloud_smaller(seed: int) -> None:
    few, many = of(cloud(seed)[:150]), of(cloud(seed))
    assert few.diameter <= many.diameter * (1 + 1e-6)
    assert few.box_diagonal <= many.box_diagonal * (1 + 1e-6)


@settings(max_examples=15, deadline=None)
@given(seeds, st.integers(2, 4))
def test_the_entropy_of_repeated_rows_is_the_same(seed: int, times: int) -> None:
    states = cloud(seed)
    assert visited_cells_entropy(np.tile(states, (times, 1))) == pytest.approx(visited_cells_entropy(states))
