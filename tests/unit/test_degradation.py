"""Degraded senses: weaker, deaf below a threshold, noisy, partly dead, late."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from babble.worlds.senses.degradation import Degradation, Degraded

ALL = np.ones(2, np.bool_)


def degraded(columns: int = 2, size: int = 3, **how: Any) -> Degraded:
    return Degraded(Degradation(**how), (size,), columns, np.random.default_rng(0))


def test_weak_and_deaf() -> None:
    sense = degraded(gain=0.5, threshold=0.2)
    value = np.array([[0.1, -0.15, 0.4], [-1, 0.2, 0]], np.float32)
    assert_allclose(sense.next(value), [[0, 0, 0.2], [-0.5, 0.1, 0]])


def test_everything_comes_late_and_a_beginning_has_no_past() -> None:
    sense = degraded(size=1, delay_steps=2)
    assert_array_equal(sense.begin(np.zeros((2, 1), np.float32), ALL), [[0], [0]])
    came = [sense.next(np.full((2, 1), step, np.float32))[0, 0] for step in (1, 2, 3, 4)]
    assert came == [0, 0, 1, 2]
    fresh = sense.begin(np.array([[9], [9]], np.float32), np.array([True, False]))
    assert_array_equal(fresh, [[9], [2]])
    assert_array_equal(sense.next(np.full((2, 1), 5, np.float32)), [[9], [3]])


def test_noise_has_the_stated_spread_and_differs_between_copies() -> None:
    sense = degraded(columns=2, size=20_000, noise_std=0.3)
    felt = sense.next(np.ones((2, 20_000), np.float32))
    assert felt.std() == pytest.approx(0.3, rel=0.02)
    assert felt.mean() == pytest.approx(1, abs=0.01)
    assert not np.array_equal(felt[0], felt[1])


def test_dead_components_stay_dead_and_are_the_same_in_every_process() -> None:
    felt = [degraded(size=1000, lost_share=0.25).next(np.ones((2, 1000), np.float32)) for _ in range(2)]
    assert_array_equal(felt[0], felt[1])
    assert_array_equal(felt[0][0], felt[0][1])
    assert (felt[0] == 0).mean() == pytest.approx(0.25, abs=0.05)


def test_noisy_images_stay_images() -> None:
    sense = Degraded(Degradation(noise_std=90), (1, 4, 4, 3), 2, np.random.default_rng(0))
    seen = sense.next(np.full((2, 1, 4, 4, 3), 200, np.float32))
    assert_array_equal(seen, np.rint(seen))
    assert seen.min() >= 0
    assert seen.max() == 255


@pytest.mark.parametrize(
    "how", [{"gain": -1}, {"threshold": "x"}, {"lost_share": 1}, {"delay_steps": 0.5}, {"delay_steps": 1000}]
)
def test_impossible_degradations_are_refused(how: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=f"degradation: {next(iter(how))} must"):
        Degradation(**how)
