"""Coloured noise: its spectrum, that it is stationary, and when its blocks change."""

import numpy as np
import pytest

from babble.noise import Coloured, make_noise


def coloured(exponents, *, block_steps=1024, columns=32, size=4, scale=0.6, seed=0):
    noise = make_noise(
        "coloured",
        scale=scale,
        columns=columns,
        size=size,
        rng=np.random.default_rng(seed),
        exponents=exponents,
        block_steps=block_steps,
    )
    assert isinstance(noise, Coloured)
    return noise


def taken(noise, steps):
    return np.stack([noise.sample() for _ in range(steps)])


def slope(values, low, high):
    """The exponent of the power spectrum between two frequencies, in cycles per step."""
    frequency = np.fft.rfftfreq(len(values))
    power = (np.abs(np.fft.rfft(values, axis=0)) ** 2).reshape(len(frequency), -1).mean(axis=1)
    band = (frequency > low) & (frequency < high)
    return np.polyfit(np.log(frequency[band]), np.log(power[band]), 1)[0]


@pytest.mark.parametrize("beta", [0.0, 0.7, 0.9, 1.0, 2.0])
@pytest.mark.parametrize("block_steps", [1024, 1023])
def test_the_spectrum_of_a_block_falls_with_its_exponent_at_all_frequencies(beta, block_steps):
    noise = coloured((beta, beta), block_steps=block_steps)
    noise.sample()
    blocks = noise._blocks.transpose(1, 0, 2)
    assert slope(blocks, 0.0, 0.49) == pytest.approx(-beta, abs=0.03)
    power = (np.abs(np.fft.rfft(blocks, axis=0)) ** 2).mean(axis=(1, 2))
    frequency = np.arange(1, len(power))
    level = power[1:] * frequency**beta
    assert level[:20].mean() == pytest.approx(level[-20:].mean(), rel=0.1), "also at both ends"


@pytest.mark.parametrize(("exponents", "progress", "beta"), [
    ((0.0, 0.0), 0.0, 0.0), ((1.0, 1.0), 0.5, 1.0), ((0.7, 0.9), 0.0, 0.7), ((0.7, 0.9), 1.0, 0.9),
])  # fmt: skip
def test_white_pink_and_baby_noise_have_their_colours_across_the_borders_of_blocks(exponents, progress, beta):
    noise = coloured(exponents, columns=64)
    noise.progress = progress
    values = taken(noise, 4096)
    assert slope(values, 0.004, 0.4) == pytest.approx(-beta, abs=0.06)


def test_the_exponent_of_a_block_is_that_of_the_moment_at_which_it_is_drawn():
    noise = coloured((0.0, 2.0), block_steps=512)
    first = taken(noise, 512)
    noise.progress = 1.0
    unchanged = noise._blocks.copy()
    noise.sample()
    assert (noise._blocks == unchanged).mean() > 0.9, "blocks that are not used up stay"
    taken(noise, 511)
    last = taken(noise, 512)
    assert abs(slope(first, 0.01, 0.3)) < 0.1
    assert slope(last, 0.01, 0.3) < -1.5
    late = coloured((0.0, 2.0), block_steps=512)
    late.progress = 1.0
    assert slope(taken(late, 512), 0.01, 0.3) < -1.5, "an actor that joins late does not begin anew"


def test_ou_noise_has_half_its_power_at_its_corner():
    correlation = 0.85
    noise = make_noise(
        "ou", scale=0.2 / np.sqrt(1 - correlation**2), columns=128, size=2,
        rng=np.random.default_rng(0), correlation=correlation,
    )  # fmt: skip
    values = taken(noise, 4096).astype(np.float64)
    assert values.std() == pytest.approx(0.3797, rel=0.02)
    assert (values[1:] - correlation * values[:-1]).std() == pytest.approx(0.2, rel=0.01)
    power = (np.abs(np.fft.rfft(values, axis=0)) ** 2).mean(axis=(1, 2))
    corner = np.arccos(1 - (1 - correlation) ** 2 / (2 * correlation)) / (2 * np.pi) * 4096
    there = power[int(corner) - 10 : int(corner) + 11].mean()
    assert power[1:20].mean() / there == pytest.approx(2.0, rel=0.1)


@pytest.mark.parametrize("beta", [0.7, 1.0])
def test_the_deviation_is_the_scale_at_every_step_also_at_the_borders_of_blocks(beta):
    values = taken(coloured((beta, beta), block_steps=64, columns=4000, size=2), 200)
    deviation = values.reshape(200, -1).std(axis=1)
    np.testing.assert_allclose(deviation, 0.6, rtol=0.05)
    np.testing.assert_allclose(values.reshape(200, -1).mean(axis=1), 0, atol=0.03)
    first, last = values[:64], values[-64:]
    assert first.var() == pytest.approx(last.var(), rel=0.02)


def test_each_column_has_blocks_that_sum_to_0_and_begin_at_a_time_of_its_own():
    values = taken(coloured((1.0, 1.0), block_steps=50, columns=40, size=3), 250)
    sums = np.concatenate([np.zeros((1, 40, 3)), np.cumsum(values, axis=0, dtype=np.float64)])
    begun = []
    for column in range(40):
        totals = [
            np.abs(np.diff(sums[start::50, column], axis=0)).max() for start in range(50)
        ]  # of whole blocks that begin at `start`
        begun.append(int(np.argmin(totals)))
        assert totals[begun[-1]] < 1e-4
    assert len(set(begun)) > 20


def test_components_and_columns_are_independent_of_one_another():
    values = taken(coloured((1.0, 1.0), block_steps=256, columns=4, size=6), 12_800).reshape(12_800, -1)
    found = np.corrcoef(values.T)[np.triu_indices(24, 1)]
    assert np.abs(found).max() < 0.2
    assert abs(found.mean()) < 0.01


def test_the_seed_decides():
    one, again, other = (taken(coloured((0.7, 0.9), block_steps=64, seed=seed), 200) for seed in (5, 5, 6))
    np.testing.assert_array_equal(one, again)
    assert (one != other).all(axis=(1, 2)).all()
    assert one.dtype == np.float32
    assert one.shape == (200, 32, 4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"exponents": (-0.1, 1.0)},
        {"exponents": (0.7, float("nan"))},
        {"exponents": (1, 1), "block_steps": 1},
    ],
)
def test_coloured_noise_that_cannot_be_is_refused(wrong):
    with pytest.raises(ValueError, match="two exponents from 0 on and block_steps >= 2"):
        coloured(**wrong)


@pytest.mark.parametrize("share", [-0.01, 1.01, float("nan")])
def test_a_progress_outside_0_to_1_is_refused(share):
    with pytest.raises(ValueError, match="progress"):
        coloured((0.7, 0.9)).progress = share
