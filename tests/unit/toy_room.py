"""A room for tests of vision: two eyes that look along +y, a floor, and a red ball put where one likes."""

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from babble.worlds.senses.screen import RendererError, screen

PIXELS = 64
FOVY_DEG = 60.0
FOCAL_PX = PIXELS / 2 / np.tan(np.radians(FOVY_DEG / 2))
EYES_APART_M = 0.06
LEFT, RIGHT = 0, 1
ROOM = f"""
<mujoco>
  <visual><headlight ambient=".5 .5 .5" diffuse=".4 .4 .4" specular="0 0 0"/></visual>
  <worldbody>
    <light type="directional" dir="0 .3 -1" diffuse=".4 .4 .4"/>
    <geom name="floor" type="plane" size="0 0 .1" pos="0 0 -.5" rgba=".4 .4 .4 1"/>
    <body name="head">
      <camera name="eye_left" pos="{-EYES_APART_M / 2} 0 0" euler="90 0 0" fovy="{FOVY_DEG}"/>
      <camera name="eye_right" pos="{EYES_APART_M / 2} 0 0" euler="90 0 0" fovy="{FOVY_DEG}"/>
      <site name="mark" pos="0 .3 0" size=".05" rgba="1 0 0 1"/>
    </body>
    <body name="toy" mocap="true"><geom type="sphere" size=".05" rgba="1 0 0 1"/></body>
  </worldbody>
</mujoco>
"""
"""The eyes look along +y; x is to the right, z is up."""


def skip_without_renderer() -> None:
    """Skips the test where nothing can be drawn, saying why."""
    try:
        with screen.current():
            pass
    except RendererError as error:
        pytest.skip(str(error))


def room() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_string(ROOM)


def with_toy_at(model: mujoco.MjModel, x: float, y: float, z: float) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.mocap_pos[0] = x, y, z
    mujoco.mj_forward(model, data)
    return data


def red(image: NDArray[np.floating]) -> tuple[float, float, int]:
    """(x, y, pixels) of what is red: to the right and upwards of the image's centre, in pixels."""
    height, width = image.shape[:2]
    rows, columns = np.nonzero((image[..., 0] > 100) & (image[..., 0] > 2 * image[..., 1]))
    return float(columns.mean() - (width - 1) / 2), float((height - 1) / 2 - rows.mean()), len(rows)
