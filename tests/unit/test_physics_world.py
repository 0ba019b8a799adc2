"""Copies of a simulated body: they move as MuJoCo moves them, begin, end and break down one by one."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from babble.worlds.physics.env import BodyParameters, blueprint
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import MujocoWorld
from tests.unit.small_body import arm

BOTH = np.arange(2)


def world_of(
    columns: int = 3, seed: int = 0, model: mujoco.MjModel | None = None, **parameters: Any
) -> MujocoWorld:
    model = model or arm()
    plan = blueprint(
        "Arm",
        model,
        BodyParameters(**parameters),
        joints=BOTH,
        actuators=BOTH,
        task=lambda: Play(model, BOTH),
    )
    return MujocoWorld(plan, columns, np.random.default_rng(seed))


def test_each_copy_moves_as_the_bare_simulation_does() -> None:
    world = world_of(senses=["position", "velocity"], angles="radians")
    model = arm()
    alone = [mujoco.MjData(model) for _ in range(3)]
    rng = np.random.default_rng(1)
    world.reset()
    for _ in range(50):
        action = rng.uniform(-1, 1, (3, 2)).astype(np.float32)
        seen = world.step(action).observation
        for data, command in zip(alone, action.astype(float), strict=True):
            data.ctrl[:] = [command[0], 1 + 3 * command[1]]
            mujoco.mj_step(model, data, 2)
    assert_allclose(seen, [[*data.qpos, *data.qvel] for data in alone], rtol=1e-6)


def test_an_action_goes_from_one_end_of_the_control_range_to_the_other_and_no_further() -> None:
    world = world_of(columns=2)
    world.reset()
    world.step(np.array([[-1, -1], [7, 7]], np.float32))
    assert_allclose([data.ctrl for data in world.copies], [[-1, -2], [1, 4]])


def test_positions_and_postures_are_shares_of_the_range() -> None:
    world = world_of(columns=1)
    world.reset()
    world.copies[0].qpos[:] = np.radians([60, -120])
    assert_allclose(world.posture(), [[1, -1]], atol=1e-6)
    world.copies[0].qpos[:] = np.radians([-15, 10])
    assert_allclose(world.posture(), [[0, 1]], atol=1e-6)
    assert world.diameter == pytest.approx(2 * np.sqrt(2))


def test_random_starts_fill_the_ranges_and_the_usual_start_is_the_models_own_pose() -> None:
    world = world_of(columns=400)
    assert_allclose(world.reset(), np.tile([0.2, 1.0], (400, 1)), atol=1e-6)
    scattered = world.reset("random")
    assert (scattered.min(axis=0) < -0.9).all()
    assert (scattered.max(axis=0) > 0.9).all()
    assert_array_equal(world_of(columns=400).reset("random"), world_of(columns=400).reset("random"))


def test_an_episode_is_cut_off_after_its_steps_and_only_flagged_copies_begin_again() -> None:
    world = world_of(columns=2, episode_steps=3)
    world.reset()
    still = np.ones((2, 2), np.float32)
    steps = [world.step(still) for _ in range(3)]
    assert [step.truncated.tolist() for step in steps] == [[False, False], [False, False], [True, True]]
    before = steps[-1].observation
    after = world.restart(np.array([True, False]))
    assert_allclose(after[0], [0.2, 1.0], atol=1e-6)
    assert_array_equal(after[1], before[1])
    assert world.step(still).truncated.tolist() == [False, True]


def test_a_simulation_that_breaks_down_is_flagged_kept_finite_and_can_begin_again() -> None:
    world = world_of(columns=3, senses=["position", "velocity", "vestibular"])
    world.reset()
    world.copies[1].qvel[:] = np.nan
    step = world.step(np.zeros((3, 2), np.float32))
    assert step.failed is not None
    assert step.failed.tolist() == [False, True, False]
    assert np.isfinite(step.observation).all()
    assert np.isfinite(world.restart(step.failed)).all()
    assert world.step(np.zeros((3, 2), np.float32)).failed is None


def test_an_unstable_model_fails_instead_of_jumping_back_to_its_start() -> None:
    model = arm()
    model.opt.timestep = 1.0
    model.dof_damping[:] = 0
    model.jnt_stiffness[:] = 1e9
    world = world_of(columns=1, model=model)
    world.reset("random")
    steps = (world.step(np.ones((1, 2), np.float32)).failed for _ in range(200))
    assert any(failed is not None and failed[0] for failed in steps)


@pytest.mark.parametrize("action", [np.zeros((2, 2)), np.full((3, 2), np.nan), np.zeros((3, 3))])
def test_a_wrong_action_is_refused(action: np.ndarray) -> None:
    world = world_of()
    world.reset()
    with pytest.raises(ValueError, match=r"actions must be finite numbers of shape \(3, 2\)"):
        world.step(action.astype(np.float32))


def test_restricted_joints_and_weak_motors_do_less() -> None:
    stiff = world_of(columns=64, mobility={"elbow": 0.5}, senses=["position"], angles="radians")
    elbow = np.degrees(stiff.reset("random")[:, 1])
    assert elbow.min() == pytest.approx(-75, abs=5)
    assert elbow.max() == pytest.approx(-15, abs=5)
    full, half = world_of(columns=1), world_of(columns=1, strength={"lift": 0.5})
    for world in (full, half):
        world.reset()
        world.step(np.array([[1, -1 / 3]], np.float32))
    assert half.copies[0].qfrc_actuator[0] == pytest.approx(full.copies[0].qfrc_actuator[0] / 2)


def test_balanced_motors_are_as_strong_in_either_direction() -> None:
    torques = {}
    for balanced in (False, True):
        world = world_of(columns=2, balanced=balanced)
        world.reset()
        world.step(np.array([[1, 0], [-1, 0]], np.float32))
        torques[balanced] = [data.qfrc_actuator[0] for data in world.copies]
    assert_allclose(torques[False], [2, -1])
    assert_allclose(torques[True], [1, -1])


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"senses": ["taste"]}, "there is no sense 'taste'; the senses are position"),
        ({"senses": ["torque"]}, "the model has no torque sensor, which the sense 'torque' reads"),
        ({"senses": "position"}, "senses must be a list of distinct names"),
        ({"mobility": {"knee": 0.5}}, "no joint matches 'knee'; there are shoulder, elbow"),
        ({"mobility": {"elbow": 0}}, r"mobility of 'elbow' must be a share in \(0, 1\], got 0"),
        ({"strength": {"lift": 2}}, "strength of 'lift' must be a share"),
        ({"actuation": "magic"}, 'actuation is "motors" or "muscles"'),
        ({"physics_steps": 0}, "physics_steps must be a whole number of at least 1"),
        ({"angles": "degrees"}, 'the unit of positions is "range" or "radians"'),
        ({"degradation": {"touch": {"gain": 0.5}}}, "the body has no sense 'touch'; it has position"),
        ({"degradation": {"position": {"blur": 1}}}, "degradation of position: there is no 'blur'"),
        ({"touch": 3}, "touch must be a table, got 3"),
    ],
)
def test_wrong_parameters_get_one_sentence(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as caught:
        world_of(**parameters)
    assert "\n" not in str(caught.value)
