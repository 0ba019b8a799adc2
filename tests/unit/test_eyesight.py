"""Worse eyes: what a blurred, dim, pale, noisy or closed eye makes of an image."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from babble.worlds.senses.eyesight import Eyesight, Sight, acuity_sigma_px, blur_matrix

HEIGHT, WIDTH = 48, 64
FOVY_DEG = 60.0
LEFT, RIGHT = 0, 1


def sight(is_open: tuple[bool, bool] = (True, True), seed: int = 0, **how: Any) -> Sight:
    return Sight(
        Eyesight(**how),
        is_open=is_open,
        height=HEIGHT,
        width=WIDTH,
        fovy_deg=(FOVY_DEG, FOVY_DEG),
        rng=np.random.default_rng(seed),
    )


@pytest.fixture
def images() -> NDArray[np.uint8]:
    """(3 copies, 2 eyes, H, W, 3) of coloured noise."""
    return np.random.default_rng(1).integers(0, 256, (3, 2, HEIGHT, WIDTH, 3), dtype=np.uint8)


def test_good_eyes_see_what_is_there(images: NDArray[np.uint8]) -> None:
    seen = sight()(images)
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen, images)


def test_blur_keeps_the_mean_and_lowers_the_contrast_of_its_own_eye_only(images: NDArray[np.uint8]) -> None:
    seen = sight(blur_sigma_px=(0, 2))(images)
    np.testing.assert_array_equal(seen[:, LEFT], images[:, LEFT])
    np.testing.assert_allclose(seen[:, RIGHT].mean((1, 2)), images[:, RIGHT].mean((1, 2)), atol=0.05)
    assert seen[:, RIGHT].std() < 0.2 * images[:, RIGHT].std()


def test_a_point_of_light_becomes_a_gaussian_of_that_width() -> None:
    images = np.zeros((1, 2, HEIGHT, WIDTH, 3), np.float32)
    images[..., 20, 30, :] = 40_000  # so bright that rounding does not matter, and nothing exceeds white
    spot = sight(blur_sigma_px=5)(images)[0, LEFT, :, :, 0].astype(float)
    weight = spot / spot.sum()
    across, down = np.arange(WIDTH) - 30, np.arange(HEIGHT) - 20
    assert math.sqrt((weight.sum(0) * across**2).sum()) == pytest.approx(5, rel=0.02)
    assert math.sqrt((weight.sum(1) * down**2).sum()) == pytest.approx(5, rel=0.02)


@given(length=st.integers(1, 40), sigma_px=st.floats(0.1, 1e6))
def test_even_light_stays_even_and_none_is_lost(length: int, sigma_px: float) -> None:
    matrix = blur_matrix(length, sigma_px)
    np.testing.assert_allclose(matrix.sum(axis=0), 1, atol=1e-5)
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-5)


@pytest.mark.parametrize(("share_of_acuity", "left"), [(1.0, 0.028), (0.5, 0.41), (0.25, 0.80)])
def test_the_finest_grating_keeps_a_few_percent_of_its_contrast(share_of_acuity: float, left: float) -> None:
    px_per_degree = HEIGHT / 2 / math.tan(math.radians(FOVY_DEG / 2)) * math.radians(1)
    acuity_cpd = 0.25 * px_per_degree  # at the acuity a cycle is 4 pixels
    phase = 2 * np.pi * 0.25 * share_of_acuity * np.arange(WIDTH)
    stripes = 127.5 + 127 * np.cos(phase)
    images = np.broadcast_to(stripes[:, None], (1, 2, HEIGHT, WIDTH, 3)).astype(np.float32)
    seen = sight(acuity_cpd=acuity_cpd)(images)[0, LEFT, 0, :, 0] - 127.5
    amplitude = 2 * np.mean(seen * np.cos(phase))
    assert amplitude / 127 == pytest.approx(left, abs=0.01)


def test_a_narrower_field_of_view_shows_more_of_a_poor_acuity() -> None:
    assert acuity_sigma_px(0.7, 20, 64) > 2 * acuity_sigma_px(0.7, 60, 64)
    assert acuity_sigma_px(math.inf, 60, 64) == 0


def test_a_dim_eye_gets_less_light_and_a_dazzled_one_no_more_than_white(images: NDArray[np.uint8]) -> None:
    seen = sight(brightness=[0.3, 4])(images)
    np.testing.assert_allclose(seen[:, LEFT], 0.3 * images[:, LEFT], atol=0.5)
    np.testing.assert_array_equal(seen[:, RIGHT], np.minimum(4.0 * images[:, RIGHT], 255))


def test_without_contrast_only_the_mean_colour_is_left(images: NDArray[np.uint8]) -> None:
    images[..., 0] //= 4
    seen = sight(contrast=(0, 0.5))(images)
    fog = images[:, LEFT].mean((1, 2))[:, None, None]
    np.testing.assert_allclose(seen[:, LEFT], np.broadcast_to(fog, seen[:, LEFT].shape), atol=0.51)
    np.testing.assert_allclose(seen[:, RIGHT].mean((1, 2)), images[:, RIGHT].mean((1, 2)), atol=0.5)
    assert seen[:, RIGHT].std((1, 2)) == pytest.approx(images[:, RIGHT].std((1, 2)) / 2, rel=0.02)


def test_noise_is_as_strong_as_said_and_follows_the_seed() -> None:
    grey = np.full((1, 2, HEIGHT, WIDTH, 3), 128, np.uint8)
    seen = sight(noise_std=(0, 20), seed=5)(grey)
    assert (seen[:, LEFT] == 128).all()
    assert seen[:, RIGHT].std() == pytest.approx(20, rel=0.05)
    np.testing.assert_array_equal(seen, sight(noise_std=(0, 20), seed=5)(grey))
    assert (seen != sight(noise_std=(0, 20), seed=6)(grey)).any()


def test_a_closed_eye_sees_black_without_noise(images: NDArray[np.uint8]) -> None:
    seen = sight(is_open=(False, True), noise_std=30, brightness=2)(images)
    assert (seen[:, LEFT] == 0).all()
    assert seen[:, RIGHT].mean() > 100


@given(
    how=st.fixed_dictionaries(
        {
            "blur_sigma_px": st.floats(0, 1000),
            "acuity_cpd": st.floats(0, exclude_min=True),
            "brightness": st.floats(0, 10_000),
            "contrast": st.floats(0, 10_000),
            "noise_std": st.floats(0, 10_000),
        }
    )
)
def test_what_is_seen_are_always_whole_numbers_of_a_byte(how: dict[str, float]) -> None:
    images = np.random.default_rng(1).integers(0, 256, (1, 2, HEIGHT, WIDTH, 3), dtype=np.uint8)
    seen = sight(**how)(images)
    assert seen.min() >= 0
    assert seen.max() <= 255
    np.testing.assert_array_equal(seen, np.rint(seen))


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"blur_sigma_px": -1}, "blur_sigma_px must be a number from 0 to 10000"),
        ({"brightness": (1, math.nan)}, "brightness must be a number from 0 to 10000"),
        ({"contrast": "low"}, "contrast must be a number from 0 to 10000"),
        ({"noise_std": []}, "noise_std must be a number from 0 to 10000"),
        ({"acuity_cpd": 0}, "acuity_cpd must be a number above 0"),
        ({"brightness": True}, "brightness must be a number from 0 to 10000"),
        ({"brightness": (1, 1, 1)}, "brightness has 3 numbers for 2 eyes"),
        ({"closed_eyes": "eye_left"}, "closed_eyes must be a list of texts"),
    ],
)
def test_a_wrong_value_gets_a_sentence(how: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        sight(**how)
