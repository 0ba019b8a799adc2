"""Any MuJoCo model as a world: chosen by pattern, refused with one sentence where it does not fit."""

import importlib.util
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
from numpy.testing import assert_allclose

from babble.worlds import WorldError, make
from tests.unit.small_body import ARM

ANT = Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml"
ROBOTICS = importlib.util.find_spec("gymnasium_robotics")
assert ROBOTICS is not None
assert ROBOTICS.submodule_search_locations is not None
SHADOW_HAND = Path(ROBOTICS.submodule_search_locations[0]) / "envs/assets/hand/reach.xml"


@pytest.fixture
def arm_file(tmp_path: Path) -> str:
    path = tmp_path / "arm.xml"
    path.write_text(ARM)
    return str(path)


def test_a_quadruped_runs_with_all_its_hinges_and_motors() -> None:
    world = make("Mjcf", {"file": str(ANT), "senses": ["position", "velocity"]}, columns=2, seed=0)
    assert (world.posture_size, world.action_size, world.observation_size) == (8, 8, 16)
    start = world.reset()
    for _ in range(20):
        step = world.step(np.ones((2, 8), np.float32))
    assert step.failed is None
    assert np.abs(step.observation - start).max() > 0.1


def test_the_fingers_of_a_robot_hand_are_chosen_by_pattern() -> None:
    world = make(
        "Mjcf",
        {"file": str(SHADOW_HAND), "joints": ["robot0:FFJ*"], "actuators": ["robot0:A_FFJ*"]},
        columns=1,
        seed=0,
    )
    assert (world.posture_size, world.action_size) == (4, 3)
    low = world.reset()
    for _ in range(200):
        world.step(np.array([[0, 1, 1]], np.float32))
    assert (world.posture() - low)[0, 1:].min() > 0.5, "the finger closes"


def test_what_is_not_chosen_stays_at_rest(arm_file: str) -> None:
    world = make("Mjcf", {"file": arm_file, "actuators": ["lift"]}, columns=1, seed=0)
    world.reset()
    world.step(np.ones((1, 1), np.float32))
    assert_allclose(world.copies[0].ctrl, [1, 0])  # type: ignore[attr-defined]


def test_sensors_and_the_keyframe_are_chosen_by_name(arm_file: str) -> None:
    parameters = {
        "file": arm_file,
        "senses": ["position", "sensors"],
        "sensors": ["rot*"],
        "angles": "radians",
    }
    world = make("Mjcf", {**parameters, "keyframe": "bent"}, columns=1, seed=0)
    assert dict(world.senses) == {"position": (2,), "sensors": (3,)}
    assert_allclose(world.reset()[0, :2], [0.5, -1.5])


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"joints": ["knee*"]}, r"no joint matches 'knee\*'; there are shoulder, elbow"),
        ({"actuators": ["lfit"]}, "no actuator matches 'lfit'; the nearest are lift"),
        ({"senses": ["sensors"], "sensors": ["pain"]}, "no sensor matches 'pain'"),
        ({"senses": ["torque"]}, "the model has no torque sensor"),
        ({"keyframe": "home"}, "the model has no keyframe 'home'; it has bent"),
        ({"keyframe": 3}, "keyframe must be a text, got 3"),
        ({"joints": 3}, "joints must be a list of texts, got 3"),
        ({"senses": ["sensors"]}, 'senses has "sensors", but none is chosen'),
        ({"sensors": ["rot*"]}, 'sensors are chosen, but senses lacks "sensors"'),
        ({"file": "~nosuchuser/x.xml"}, "file '~nosuchuser/x.xml' cannot be looked for"),
        ({"joint": ["*"]}, "Mjcf has no parameter 'joint'; its parameters are"),
        ({"actuation": "muscles"}, None),
    ],
)
def test_what_the_model_lacks_is_named(
    arm_file: str, parameters: dict[str, Any], sentence: str | None
) -> None:
    if sentence is None:
        assert make("Mjcf", {"file": arm_file, **parameters}, columns=1, seed=0).action_size == 4
        return
    with pytest.raises(WorldError, match=sentence):
        make("Mjcf", {"file": arm_file, **parameters}, columns=1, seed=0)


def test_files_that_cannot_be_used_are_named(tmp_path: Path) -> None:
    with pytest.raises(WorldError, match="file is missing: name the MuJoCo model"):
        make("Mjcf", {}, columns=1, seed=0)
    with pytest.raises(WorldError, match=r"there is no model file .*nothing\.xml"):
        make("Mjcf", {"file": str(tmp_path / "nothing.xml")}, columns=1, seed=0)
    for name, text in (
        ("broken.xml", "<mujoco><worldbody>"),
        ("empty.mjb", ""),
        ("wrong.xml", "<mujoco><x/></mujoco>"),
    ):
        (tmp_path / name).write_text(text)
        with pytest.raises(WorldError, match=f"MuJoCo cannot use .*{name}: .") as caught:
            make("Mjcf", {"file": str(tmp_path / name)}, columns=1, seed=0)
        assert "\n" not in str(caught.value)


def test_a_free_joint_is_no_part_of_a_posture() -> None:
    with pytest.raises(
        WorldError, match="joint 'root' is neither a hinge nor a slide; take it out with '!root'"
    ):
        make("Mjcf", {"file": str(ANT), "joints": ["root", "hip_*"]}, columns=1, seed=0)
