"""What the eyes of a body see."""

from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import load
from babble.worlds.senses.vision import Vision
from tests.unit.toy_room import (
    EYES_APART_M,
    FOCAL_PX,
    LEFT,
    PIXELS,
    RIGHT,
    ROOM,
    red,
    room,
    skip_without_renderer,
    with_toy_at,
)


@pytest.fixture
def _drawing() -> None:
    skip_without_renderer()


@pytest.fixture
def model(_drawing: None) -> mujoco.MjModel:
    return room()


def test_a_red_ball_is_seen_red_where_it_is(model: mujoco.MjModel) -> None:
    image = Vision(model, cameras=["eye_left"]).read([with_toy_at(model, 0.2, 0.8, 0.12)])[0, 0]
    x, y, pixels = red(image)
    assert x == pytest.approx(FOCAL_PX * (0.2 + EYES_APART_M / 2) / 0.8, abs=1)
    assert y == pytest.approx(FOCAL_PX * 0.12 / 0.8, abs=1)
    assert pixels == pytest.approx(np.pi * (FOCAL_PX * 0.05 / 0.8) ** 2, rel=0.3)


def test_the_eyes_see_it_apart_by_their_parallax(model: mujoco.MjModel) -> None:
    vision = Vision(model, resolution=256)
    assert vision.shape == (2, 256, 256, 3)
    for distance_m in (0.4, 0.8, 1.6):
        seen = vision.read([with_toy_at(model, 0, distance_m, 0)])[0]
        parallax_px = red(seen[LEFT])[0] - red(seen[RIGHT])[0]
        assert parallax_px == pytest.approx(4 * FOCAL_PX * EYES_APART_M / distance_m, rel=0.05)


def test_an_image_may_be_oblong(model: mujoco.MjModel) -> None:
    vision = Vision(model, resolution=(32, 64))
    data = with_toy_at(model, 0, 1, 0)
    assert vision.shape == (2, 32, 64, 3)
    assert vision.read([data]).shape == (1, 2, 32, 64, 3)
    assert red(vision.read([data])[0, LEFT])[0] == pytest.approx(FOCAL_PX / 2 * EYES_APART_M / 2, abs=0.6)


def test_each_copy_has_its_own_image(model: mujoco.MjModel) -> None:
    vision = Vision(model)
    copies = [with_toy_at(model, x, 0.7, 0) for x in (-0.2, 0.0, 0.2)]
    together = vision.read(copies)
    assert together.shape == (3, 2, PIXELS, PIXELS, 3)
    for data, seen in zip(copies, together, strict=True):
        np.testing.assert_array_equal(vision.read([data])[0], seen)
    assert np.all(np.diff([red(seen[LEFT])[0] for seen in together]) > 5)


def test_values_are_whole_numbers_of_a_byte(model: mujoco.MjModel) -> None:
    seen = Vision(model).read([with_toy_at(model, 0, 0.5, 0)])
    assert seen.dtype == np.float32
    np.testing.assert_array_equal(seen, seen.astype(np.uint8))


def test_shadows_fall_only_when_asked_for(model: mujoco.MjModel) -> None:
    data = with_toy_at(model, 0, 1.2, -0.35)
    unasked, plain, shaded = (
        Vision(model, resolution=256, **how).read([data])[0, LEFT]
        for how in ({}, {"shadows": False}, {"shadows": True})
    )
    np.testing.assert_array_equal(unasked, plain)
    rows, columns = np.nonzero((shaded < 0.8 * plain).all(axis=-1))
    assert 50 < len(rows) < 1000
    assert rows.min() > 256 / 2  # on the floor, below the eyes
    assert abs(columns.mean() - 256 / 2) < 20


def test_marks_are_not_seen(model: mujoco.MjModel) -> None:
    seen = Vision(model).read([with_toy_at(model, 0, -5, 0)])
    assert not ((seen[..., 0] > 100) & (seen[..., 0] > 2 * seen[..., 1])).any()


def test_one_closed_eye_and_one_blurred_and_dim(model: mujoco.MjModel) -> None:
    data = with_toy_at(model, 0, 0.5, 0)
    good = Vision(model).read([data])[0]
    closed = Vision(model, closed_eyes=["*_left"]).read([data])[0]
    assert (closed[LEFT] == 0).all()
    np.testing.assert_array_equal(closed[RIGHT], good[RIGHT])
    worse = Vision(model, blur_sigma_px=(0, 4), brightness=(1, 0.5)).read([data])[0]
    np.testing.assert_array_equal(worse[LEFT], good[LEFT])
    assert worse[RIGHT].mean() == pytest.approx(good[RIGHT].mean() / 2, rel=0.02)
    assert worse[RIGHT].std() < 0.45 * good[RIGHT].std()


def test_sees_the_same_again_after_closing_and_beside_another(model: mujoco.MjModel) -> None:
    vision, other, data = Vision(model), Vision(model, resolution=32), with_toy_at(model, 0, 0.5, 0)
    before = vision.read([data])
    other.read([data])
    np.testing.assert_array_equal(vision.read([data]), before)
    vision.close()
    other.close()
    np.testing.assert_array_equal(vision.read([data]), before)


@pytest.mark.usefixtures("_drawing")
@pytest.mark.parametrize("floor", ["", 'material="squares"'])
def test_an_endless_floor_looks_like_a_very_large_one(floor: str) -> None:
    room = ROOM.replace(
        "<worldbody>",
        """<asset>
          <texture name="squares" type="2d" builtin="checker" rgb1="1 1 1" width="64" height="64"/>
          <material name="squares" texture="squares" texuniform="true" texrepeat="2 2"/>
        </asset><worldbody>""",
    ).replace('rgba=".4 .4 .4 1"', floor or 'rgba=".4 .4 .4 1"')
    seen = []
    for size in ("0 0 .1", "20 20 .1"):
        model = mujoco.MjModel.from_xml_string(room.replace("0 0 .1", size))
        seen.append(Vision(model).read([with_toy_at(model, 0, 0.8, 0)])[0, LEFT, PIXELS // 2 + 4 :])
    assert np.abs(seen[0] - seen[1]).mean() < 2
    assert (seen[0].std() > 30) == bool(floor)


@pytest.mark.usefixtures("_drawing")
def test_the_infant_sees_a_ball_with_both_eyes() -> None:
    spec = infant(load("mitten"), free=False)
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.04, 0, 0), rgba=(1, 0, 0, 1), name="ball"
    )
    spec.worldbody.add_light(pos=(0, 0, 3))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    eyes = [model.camera(name).id for name in ("eye_left", "eye_right")]
    ahead = -data.cam_xmat[eyes].reshape(2, 3, 3)[:, :, 2].mean(axis=0)
    data.geom("ball").xpos[:] = data.cam_xpos[eyes].mean(axis=0) + 0.3 * ahead
    left, right = Vision(model).read([data])[0]
    assert red(left)[0] > 1 > -1 > red(right)[0]
    assert red(left)[2] > 30 < red(right)[2]


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"cameras": ["nose"]}, "no camera matches 'nose'; .*eye_left"),
        ({"cameras": "eye_left"}, "cameras are chosen by a list"),
        ({"closed_eyes": ["third"]}, "no eye matches 'third'; .*eye_left"),
        ({"resolution": 0}, "height must be a whole number from 1"),
        ({"resolution": (64, 64.5)}, "width must be a whole number from 1"),
        ({"resolution": (64,)}, "resolution is the pixels of a side"),
        ({"shadows": 1}, "shadows must be true or false"),
        ({"blur": 2}, "vision has no option 'blur'; its options are .*blur_sigma_px"),
        ({"brightness": -1}, "brightness must be a number from 0"),
        ({"brightness": (1, 1, 1)}, "3 numbers for 2 eyes"),
    ],
)
def test_a_wrong_option_gets_a_sentence(options: Mapping[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Vision(room(), **options)


def test_a_body_without_eyes_gets_a_sentence() -> None:
    blind = mujoco.MjModel.from_xml_string("<mujoco><worldbody><camera name='ceiling'/></worldbody></mujoco>")
    with pytest.raises(ValueError, match=r"no camera matches 'eye_left'; .*ceiling"):
        Vision(blind)
