"""What can be seen of a world is what is there, and looking changes nothing."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from babble import worlds
from babble.worlds.batch import World
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.showing import shown
from tests.unit.drawn_things import things_file
from tests.unit.small_body import ARM

BALL = """
<mujoco>
  <option timestep="0.002" cone="elliptic"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 .1"/>
    <body name="ball" pos="0 0 {height}">
      <joint name="x" type="slide" axis="1 0 0" range="-1 1" limited="true"/>
      <joint name="z" type="slide" axis="0 0 1"/>
      <geom type="sphere" size=".1" mass="0.5"/>
    </body>
  </worldbody>
  <actuator><motor name="push" joint="x"/></actuator>
</mujoco>
"""


def simulated(id: str, parameters: dict[str, object], columns: int = 1) -> MujocoWorld:
    world = worlds.make(id, parameters, columns, 7)
    assert isinstance(world, MujocoWorld)
    return world


def ball(folder: Path, height: float) -> MujocoWorld:
    path = folder / "ball.xml"
    path.write_text(BALL.format(height=height))
    return simulated("Mjcf", {"file": str(path)})


def test_a_point_in_a_shape_has_neither_pose_nor_images() -> None:
    world = worlds.make("Cuboid", {}, 2, 0)
    seen = shown(world)
    assert seen.pose() is None
    assert seen.images(world.reset()) == {}


def test_a_shape_is_shown_without_loading_mujoco() -> None:
    code = (
        "import sys; from babble import worlds; from babble.worlds.showing import shown;"
        "shown(worlds.make('Cuboid', {}, 1, 0)).pose(); sys.exit('mujoco' in sys.modules)"
    )
    assert subprocess.run([sys.executable, "-c", code], timeout=60).returncode == 0


def test_the_pose_is_that_of_the_first_copy() -> None:
    world = simulated("MimoHand", {}, columns=3)
    world.reset("random")
    pose = shown(world).pose()
    assert pose is not None
    data = world.copies[0]
    np.testing.assert_array_equal(pose.position, data.xpos.astype(np.float32))
    np.testing.assert_array_equal(pose.quaternion, data.xquat.astype(np.float32))
    assert not np.array_equal(pose.position, world.copies[1].xpos.astype(np.float32))


def test_a_ball_that_lies_feels_its_weight_below_and_one_that_falls_feels_nothing(tmp_path: Path) -> None:
    world = ball(tmp_path, height=0.1)
    seen = shown(world)
    world.reset()
    for _ in range(200):
        world.step(np.zeros((1, 1), np.float32))
    pose = seen.pose()
    assert pose is not None
    assert pose.touch is not None
    assert seen.touch is not None
    assert pose.touch.sum() == pytest.approx(0.5 * 9.81, rel=0.05)
    (patch,) = seen.touch.patches
    felt = patch.points[pose.touch > 0]
    assert len(felt) > 0
    assert (felt[:, 2] < -0.05).all(), "only points below are near the floor"

    falling = ball(tmp_path, height=5.0)
    falling.reset()
    falling.step(np.zeros((1, 1), np.float32))
    pose = shown(falling).pose()
    assert pose is not None
    assert pose.touch is not None
    assert not pose.touch.any()


def test_looking_changes_nothing() -> None:
    def run(looking: bool) -> list[np.ndarray]:
        world = simulated("MimoRollover", {"senses": ["position", "velocity", "touch"]}, columns=2)
        seen = shown(world)
        rng = np.random.default_rng(0)
        found = [world.reset("random")]
        for step in range(30):
            if looking:
                pose = seen.pose()
                assert pose is not None
                seen.images(found[-1])
            found.append(
                world.step(rng.uniform(-1, 1, (2, world.action_size)).astype(np.float32)).observation
            )
            if step == 15:
                found.append(world.restart(np.array([True, False])))
        return found

    for with_looking, without in zip(run(True), run(False), strict=True):
        np.testing.assert_array_equal(with_looking, without)


def test_a_broken_simulation_shows_nothing() -> None:
    world = simulated("MimoHand", {})
    world.reset()
    seen = shown(world)
    world.copies[0].xpos[3, 0] = np.nan
    assert seen.pose() is None


def test_bodies_without_skin_show_no_touch() -> None:
    world = simulated("MimoHand", {"contacts": False})
    world.reset()
    pose = shown(world).pose()
    assert pose is not None
    assert pose.touch is None
    with_skin = simulated("MimoHand", {"contacts": True})
    with_skin.reset()
    pose = shown(with_skin, touch=False).pose()
    assert pose is not None
    assert pose.touch is None


def test_odd_models_are_shown_too(tmp_path: Path) -> None:
    world = simulated("Mjcf", {"file": things_file(tmp_path)})
    world.reset()
    pose = shown(world).pose()
    assert pose is not None
    assert pose.position.shape == (2, 3)


def eyed(id: str, **parameters: object) -> World:
    return worlds.make(id, {"senses": ["position", "vision"], **parameters}, 2, 0)


def test_images_are_those_of_the_first_row_by_the_name_of_the_eye() -> None:
    world = eyed("MimoStandUp", vision={"resolution": [5, 4]})
    rng = np.random.default_rng(0)
    pictures = rng.integers(0, 256, (2, 2, 5, 4, 3))
    observation = np.zeros((2, world.observation_size), np.float32)
    observation[:, -2 * 5 * 4 * 3 :] = pictures.reshape(2, -1)
    found = shown(world, touch=False).images(observation)
    assert list(found) == ["left eye", "right eye"]
    for eye, wanted in zip(found.values(), pictures[0], strict=True):
        assert eye.dtype == np.uint8
        np.testing.assert_array_equal(eye, wanted)


def test_an_eye_is_named_only_if_its_camera_is_known(tmp_path: Path) -> None:
    assert shown(eyed("MimoStandUp", vision={"cameras": ["eye_right"]}), touch=False).eyes == ("eye",)
    path = tmp_path / "arm.xml"
    path.write_text(ARM.replace('name="eye"', 'name="fish"'))
    world = eyed("Mjcf", file=str(path), vision={"cameras": ["fish"]})
    assert shown(world, touch=False).eyes == ("fish",)
