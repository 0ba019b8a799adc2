"""Pictures without a screen: for people, by whichever renderer there is, and what is said without one."""

import os
import subprocess
import sys
from collections.abc import Mapping
from typing import Any

import mujoco
import numpy as np
import pytest

from babble.worlds.senses.rendering import Quality, Renderer, View, fixed_camera, picture
from tests.unit.toy_room import FOCAL_PX, ROOM, red, room, skip_without_renderer, with_toy_at


@pytest.fixture
def _drawing() -> None:
    skip_without_renderer()


@pytest.fixture
def model(_drawing: None) -> mujoco.MjModel:
    return room()


def test_a_picture_shows_what_it_is_pointed_at(model: mujoco.MjModel) -> None:
    data = with_toy_at(model, 1, 2, 0)
    view = View(lookat_m=(1, 2, 0), azimuth_deg=30, elevation_deg=-20, distance_m=0.5)
    image = picture(model, data, width=160, height=120, camera=view)
    assert image.shape == (120, 160, 3)
    assert image.dtype == np.uint8
    x, y, pixels = red(image.astype(float))
    assert abs(x) < 2 > abs(y)
    assert pixels > 300
    assert image[0].mean() > 150  # the backdrop is light
    by_eye = picture(model, with_toy_at(model, 0.2, 0.8, 0.1), width=64, height=64, camera="eye_left")
    assert red(by_eye.astype(float))[0] == pytest.approx(FOCAL_PX * 0.23 / 0.8, abs=1.5)


def test_a_picture_has_shadows_and_a_quick_one_need_not(model: mujoco.MjModel) -> None:
    data = with_toy_at(model, 0, 0.8, -0.4)
    view = View(lookat_m=(0, 0.8, -0.5), elevation_deg=-40, distance_m=0.6)
    shaded = picture(model, data, width=96, height=96, camera=view)
    plain = picture(model, data, width=96, height=96, camera=view, quality=Quality())
    floor = np.median(shaded.reshape(-1, 3), axis=0)
    assert ((shaded < 0.8 * floor).all(axis=-1)).sum() > 50
    assert not ((plain < 0.8 * np.median(plain.reshape(-1, 3), axis=0)).all(axis=-1)).any()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"camera": "nose"}, "no camera matches 'nose'"),
        ({"width": 0}, "width must be"),
        ({"height": 9999}, "2048"),
    ],
)
def test_a_picture_that_cannot_be_gets_a_sentence(
    model: mujoco.MjModel, given: Mapping[str, Any], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        picture(model, with_toy_at(model, 0, 1, 0), **{"width": 8, "height": 8, **given})


def test_renderers_that_are_dropped_give_back_what_they_held(model: mujoco.MjModel) -> None:
    data = with_toy_at(model, 0, 1, 0)
    for _ in range(3):
        renderer = Renderer(model, height=8, width=8)
        renderer.images([data], [fixed_camera(0)])
        resources = renderer._resources
        assert resources is not None
        assert resources.offFBO
        del renderer
        assert not resources.offFBO


SCRIPT = f"""
import sys
HINDRANCE
import mujoco
from babble.worlds.senses.vision import Vision
model = mujoco.MjModel.from_xml_string('''{ROOM}''')
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
vision, other = Vision(model), Vision(model, resolution=16)
print("OpenGL" in sys.modules)
try:
    print(vision.read([data, data]).shape, other.read([data]).shape)
except ValueError as error:
    print(type(error).__name__, error)
"""


def elsewhere(hindrance: str = "", **environment: str) -> list[str]:
    """The lines that SCRIPT prints in a fresh process, which must end well and silently."""
    clean = {name: value for name, value in os.environ.items() if name != "PYOPENGL_PLATFORM"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT.replace("HINDRANCE", hindrance)],
        env={**clean, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
    )
    assert done.stderr == ""
    return done.stdout.splitlines()


@pytest.mark.usefixtures("_drawing")
def test_opengl_waits_for_the_first_image_and_ends_silently() -> None:
    assert elsewhere(MUJOCO_GL="") == ["False", "(2, 2, 64, 64, 3) (1, 2, 16, 16, 3)"]


@pytest.mark.parametrize("backend", ["egl", "osmesa"])
def test_mujoco_gl_chooses(backend: str) -> None:
    other = {"egl": "osmesa", "osmesa": "egl"}[backend]
    without_other = f"sys.modules['mujoco.{other}'] = None"
    said = elsewhere(without_other, MUJOCO_GL="")[1]
    if said.startswith("RendererError"):
        pytest.skip(said)
    assert elsewhere(without_other, MUJOCO_GL=backend)[1] == "(2, 2, 64, 64, 3) (1, 2, 16, 16, 3)"


@pytest.mark.usefixtures("_drawing")
@pytest.mark.parametrize("order", [("egl", "osmesa"), ("osmesa", "egl")])
def test_one_renderer_that_is_missing_leaves_the_other_its_chance(order: tuple[str, str]) -> None:
    in_that_order = f"import babble.worlds.senses.screen as screens; screens.BACKENDS = {order}"
    assert elsewhere(in_that_order, MUJOCO_GL="")[1] == "(2, 2, 64, 64, 3) (1, 2, 16, 16, 3)"


def test_without_any_renderer_a_sentence_says_what_to_install() -> None:
    hindrance = "sys.modules['mujoco.egl'] = sys.modules['mujoco.osmesa'] = None"
    _, said = elsewhere(hindrance, MUJOCO_GL="")
    assert said.startswith("RendererError no off-screen renderer works here (egl: ")
    assert "install libegl1 and libgl1-mesa-dri, or libosmesa6" in said
    assert "MUJOCO_GL" in said


def test_a_renderer_that_needs_a_screen_gets_a_sentence() -> None:
    assert elsewhere(MUJOCO_GL="glfw")[1].startswith(
        "RendererError MUJOCO_GL=glfw cannot draw without a screen"
    )


@pytest.mark.usefixtures("_drawing")
def test_a_process_forked_after_drawing_gets_a_sentence_instead_of_hanging() -> None:
    forking = """
import multiprocessing
with multiprocessing.get_context("fork").Pool(1) as pool:
    pool.apply(look)
"""
    script = SCRIPT.replace("HINDRANCE", "") + "def look():\n    vision.read([data])\n" + forking
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "RendererError: this process was forked from one that had drawn pictures" in done.stderr
