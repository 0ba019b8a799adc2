"""The extent of clouds with known answers, and what all metrics together promise."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from babble import coverage_passes
from babble.coverage import (
    Coverage,
    coverage,
    coverage_curve,
    furthest_pair,
    insertion_distances,
    participation_ratio,
    visited_cells_entropy,
)
from babble.coverage_diameter import diameter
from babble.coverage_passes import moments
from tests.unit.coverage_clouds import Floats, cube_corners, embedded, gaussian, sphere

PANCAKE = embedded(gaussian(3000, np.array([9.0, 7.0, 5.0, *[0.1] * 7])))


def all_pairs_diameter(states: Floats) -> float:
    wide = states.astype(np.float64)
    return max(float(np.linalg.norm(wide - row, axis=1).max()) for row in wide)


def alike(one: Coverage, other: Coverage) -> None:
    """Equal up to rounding."""
    first, second = one.as_dict(), other.as_dict()
    assert first.pop("variances") == pytest.approx(second.pop("variances"), abs=1e-5)
    assert set(first.pop("furthest_rows")) == set(second.pop("furthest_rows"))
    assert first == pytest.approx(second, rel=1e-5)


@pytest.mark.parametrize("dims", [1, 3, 8])
def test_a_cube_has_the_diagonal_as_box_and_diameter(dims: int) -> None:
    found = diameter(cube_corners(dims, side=3.0), moments(cube_corners(dims, side=3.0)))
    assert found.distance == pytest.approx(3 * math.sqrt(dims))
    assert moments(cube_corners(dims, side=3.0)).box_diagonal == pytest.approx(3 * math.sqrt(dims))
    assert found.exact


@pytest.mark.parametrize("dims", [1, 2, 5])
def test_a_sphere_is_two_radii_wide(dims: int) -> None:
    states = embedded(sphere(5000, dims))
    one, other, distance = furthest_pair(states)
    assert distance == pytest.approx(np.linalg.norm(states[one] - states[other]), rel=1e-6)
    assert 1.95 < distance <= 2 + 1e-5


@pytest.mark.parametrize("dims", [2, 20, 98])
def test_the_diameter_is_that_of_all_pairs(dims: int) -> None:
    states = gaussian(1500, np.linspace(3, 1, dims)).astype(np.float32)
    assert furthest_pair(states, seed=3)[2] == pytest.approx(all_pairs_diameter(states), rel=1e-6)


def test_sweeps_alone_come_near_where_no_pair_can_be_excluded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("babble.coverage_diameter.MOST_PAIRED", 100)
    states = gaussian(3000, np.ones(98)).astype(np.float32)
    found, most = diameter(states, moments(states)), all_pairs_diameter(states)
    assert not found.exact
    assert 0.97 * most <= found.distance <= most * (1 + 1e-6)


def test_every_bound_of_the_diameter_holds() -> None:
    found = coverage(PANCAKE, neighbour_rows=300, centres=20)
    assert found.projection_width <= found.diameter <= min(2 * found.radius, found.box_diagonal)
    assert found.centre_last <= found.centre_first <= found.radius * 1.001
    assert 19 * found.centre_last <= found.centre_sum <= 19 * found.centre_first


def test_one_far_row_is_found() -> None:
    states = PANCAKE.copy()
    states[1234] += 500
    assert 1234 in furthest_pair(states)[:2]


def test_the_bulk_has_a_diameter_that_a_single_far_row_does_not_change() -> None:
    cloud = embedded(sphere(20_000, 3))
    flung = cloud.copy()
    flung[777] *= 50
    flung[4242] *= -40
    assert coverage(flung).diameter > 50
    assert coverage(flung).bulk_diameter == pytest.approx(2, abs=0.01)
    assert coverage(flung).participation_ratio < 3.9
    assert coverage(flung).bulk_participation_ratio == pytest.approx(4, abs=0.01)


def test_no_sweep_leaves_the_diameter_below_that_of_the_bulk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("babble.coverage_diameter.MOST_PAIRED", 0)
    for seed in range(8):
        found = coverage(gaussian(1000, np.ones(98), seed).astype(np.float32), seed=seed, centres=2)
        assert found.bulk_diameter <= found.diameter


def test_centres_are_inserted_as_the_plain_algorithm_does() -> None:
    middle = PANCAKE.mean(axis=0)
    first = np.linalg.norm(PANCAKE - middle, axis=1).argmin()
    near = np.linalg.norm(PANCAKE - PANCAKE[first], axis=1)
    plain = []
    for _ in range(49):
        chosen = near.argmax()
        plain.append(near[chosen])
        near = np.minimum(near, np.linalg.norm(PANCAKE - PANCAKE[chosen], axis=1))
    assert insertion_distances(PANCAKE, middle, 50) == pytest.approx(plain, rel=1e-5)


def test_centres_of_a_line_halve_the_gaps() -> None:
    line = np.arange(9, dtype=np.float32)[:, None]
    assert insertion_distances(line, np.array([4.0], np.float32), 5).tolist() == [4, 4, 2, 2]
    assert insertion_distances(line[[0, 0, 8]], np.array([4.0], np.float32), 4).tolist() == [8, 0, 0]


def test_the_participation_ratio_of_an_anisotropic_gaussian_is_analytic() -> None:
    deviations = np.linspace(4, 0.5, 25)
    states = embedded(gaussian(20_000, deviations))
    variances = np.sort(np.linalg.eigvalsh(moments(states).covariance))[::-1]
    assert participation_ratio(variances) == pytest.approx(participation_ratio(deviations**2), rel=0.02)
    assert variances[:25] == pytest.approx(deviations**2, rel=0.05)
    assert participation_ratio([1.0] * 7) == pytest.approx(7)
    assert participation_ratio([5.0, 0.0]) == pytest.approx(1)


def test_entropy_counts_cells_of_a_fixed_size() -> None:
    rng = np.random.default_rng(0)
    small = rng.uniform(-1e-3, 1e-3, (4000, 5)).astype(np.float32) + 0.3
    assert visited_cells_entropy(small) < 0.5
    wide = rng.uniform(-8, 8, (4000, 5)).astype(np.float32)
    assert visited_cells_entropy(wide) > visited_cells_entropy(wide / 2) + 1.5
    assert visited_cells_entropy(wide, width=1e-3) == pytest.approx(math.log2(4000), abs=0.01)
    halves = np.repeat(np.array([[-50.0] * 5, [70.0] * 5], np.float32), 100, axis=0)
    assert visited_cells_entropy(halves) == pytest.approx(1.0)


def test_a_chunked_pass_finds_what_one_pass_finds(monkeypatch: pytest.MonkeyPatch) -> None:
    at_once = coverage(PANCAKE, neighbour_rows=300, centres=20)
    monkeypatch.setattr(coverage_passes, "CHUNK_ROWS", 177)
    alike(coverage(PANCAKE, neighbour_rows=300, centres=20), at_once)


def test_a_seed_decides_everything() -> None:
    one, same, other = (coverage(PANCAKE, seed=seed, neighbour_rows=300) for seed in (1, 1, 2))
    assert one == same
    assert one.twonn != other.twonn
    assert (one.diameter, one.centre_sum) == (other.diameter, other.centre_sum)


def test_coverage_survives_json() -> None:
    found = coverage(PANCAKE, neighbour_rows=300)
    assert Coverage.from_dict(json.loads(json.dumps(found.as_dict()))) == found
    with pytest.raises(ValueError, match="lacks 'twonn'"):
        Coverage.from_dict({name: value for name, value in found.as_dict().items() if name != "twonn"})
    with pytest.raises(ValueError, match="unknown 'wisdom'"):
        Coverage.from_dict(found.as_dict() | {"wisdom": 1})


def test_a_curve_is_the_coverage_of_growing_prefixes() -> None:
    short, whole = coverage_curve(PANCAKE, [500, 3000], neighbour_rows=300)
    assert short == coverage(PANCAKE[:500], neighbour_rows=300)
    assert whole == coverage(PANCAKE, neighbour_rows=300)
    assert short.diameter <= whole.diameter
    with pytest.raises(ValueError, match="there are 3000 states, so no coverage of the first 3001"):
        coverage_curve(PANCAKE, [3001])


def test_a_memory_map_is_measured_like_an_array(tmp_path: Path) -> None:
    np.save(tmp_path / "states.npy", PANCAKE)
    mapped = np.load(tmp_path / "states.npy", mmap_mode="r")
    assert coverage(mapped, neighbour_rows=300) == coverage(PANCAKE, neighbour_rows=300)


def test_rows_that_repeat_are_counted_and_left_out_of_the_neighbours() -> None:
    twice = np.repeat(PANCAKE[:400], 2, axis=0)
    found, once = coverage(twice), coverage(PANCAKE[:400])
    assert (found.duplicates, once.duplicates) == (400, 0)
    pair = once.furthest_rows
    # One row is left out of the bulk: of two that are the same the other one stays in.
    alone = {"rows": 400, "neighbour_rows": 400, "duplicates": 0, "bulk_diameter": once.bulk_diameter}
    bulk = once.bulk_participation_ratio
    alike(replace(found, furthest_rows=pair, bulk_participation_ratio=bulk, **alone), once)


@pytest.mark.parametrize(
    ("states", "said"),
    [
        (np.full((50, 3), np.nan, np.float32), "row 0 of the states has nan in column 0"),
        (np.array([[0.0, 1], [2, np.inf]], np.float32), "row 1 of the states has inf in column 1"),
        (np.ones((50, 3), np.float32), "all 50 states are equal"),
        (np.ones((1, 3), np.float32), r"two or more states as rows \(N, s\), got shape \(1, 3\)"),
        (np.ones(9, np.float32), r"got shape \(9,\)"),
        (np.eye(5, dtype=np.float32), "22 different states, but of 5 sampled only 5 differ"),
        (cube_corners(6), r"equally far \(a grid\?\)"),
    ],
)
def test_what_cannot_be_measured_is_said_in_a_sentence(states: Floats, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        coverage(states, centres=4)


def test_one_centre_is_no_greedy_choice() -> None:
    with pytest.raises(ValueError, match="two or more centres, got 1"):
        coverage(PANCAKE, centres=1)
