"""Copies of a simulated body: they move as MuJoCo moves them, begin, end and break down one by one."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from babble.breakdowns import UnstableError
from babble.worlds.batch import Start
from babble.worlds.physics.env import BodyParameters, blueprint
from babble.worlds.physics.stability import run
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import MujocoWorld
from tests.unit.small_body import ARM, arm

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
    forces = [data.actuator_force for data in world.copies]
    assert_allclose(forces, [[-0.5, -2], [1, 4]], err_msg="lift is weaker backwards")


def test_positions_and_postures_are_shares_of_the_range() -> None:
    world = world_of(columns=1)
    world.reset()
    world.copies[0].qpos[:] = np.radians([60, -120])
    assert_allclose(world.posture(), [[1, -1]], atol=1e-6)
    world.copies[0].qpos[:] = np.radians([-15, 10])
    assert_allclose(world.posture(), [[0, 1]], atol=1e-6)
    assert world.diameter == pytest.approx(2 * np.sqrt(2))


def test_the_state_is_each_copys_joints_as_they_are() -> None:
    world = world_of(columns=2)
    assert world.state_names == tuple(
        f"{what}/{joint}" for what in ("position", "velocity") for joint in world.posture_names
    )
    world.reset()
    for column, data in enumerate(world.copies):
        data.qpos[:] = [10 + column, 20 + column]
        data.qvel[:] = [30 + column, 40 + column]
    state = world.state()
    assert_allclose(state, [[10, 20, 30, 40], [11, 21, 31, 41]])
    assert state.dtype == np.float32
    world.reset()
    assert_allclose(world.state()[:, 2:], 0)
    assert_allclose(state[0], [10, 20, 30, 40], err_msg="what was taken stays as it was")


def test_random_starts_fill_the_ranges_and_the_usual_start_is_the_models_own_pose() -> None:
    world = world_of(columns=400)
    assert_allclose(world.reset(), np.tile([0.2, 1.0], (400, 1)), atol=1e-6)
    scattered = world.reset("random")
    assert (scattered.min(axis=0) < -0.9).all()
    assert (scattered.max(axis=0) > 0.9).all()
    assert_array_equal(world_of(columns=400).reset("random"), world_of(columns=400).reset("random"))


def test_what_each_actuator_moves_is_known_also_through_tendons_and_without_names() -> None:
    text = ARM.replace(
        '<motor name="bend" joint="elbow"', '<motor tendon="both" gear="1"/><motor name="bend" joint="elbow"'
    ).replace(
        "<actuator>",
        '<tendon><fixed name="both"><joint joint="shoulder" coef="1"/><joint joint="elbow" coef="-1"/>'
        "</fixed></tendon><actuator>",
    )
    model = mujoco.MjModel.from_xml_string(text)
    plan = blueprint(
        "Arm",
        model,
        BodyParameters(senses=["velocity", "vestibular"]),
        joints=BOTH[::-1],
        actuators=np.arange(3),
        task=lambda: Play(model, BOTH),
    )
    world = MujocoWorld(plan, 1, np.random.default_rng(0))
    assert world.moves == ((1,), (0, 1), (0,))
    assert world.action_names == ("lift", "1", "bend")
    assert world.observation_names[:3] == (
        "velocity/elbow",
        "velocity/shoulder",
        "vestibular/acceleration",
    )
    assert world.observation_names[-1] == "vestibular/rotation"
    assert len(world.observation_names) == world.observation_size


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


def test_a_restricted_joint_begins_within_what_is_left_of_its_range() -> None:
    model = arm()
    model.qpos0[:] = np.radians([0, -5])
    model.qpos_spring[:] = np.radians([0, -90])
    world = world_of(columns=1, model=model, mobility={"elbow": 0.2}, senses=["position", "velocity"])
    world.reset()
    assert world.copies[0].qpos[1] == pytest.approx(np.radians(-90 + 0.2 * 90))
    assert np.abs(world.step(np.zeros((1, 2), np.float32)).observation[0, 2:]).max() < 2


def test_restricted_joints_do_not_make_muscles_stronger() -> None:
    torques = []
    for mobility in ({}, {"elbow": 0.5}):
        world = world_of(columns=1, actuation="muscles", mobility=mobility)
        world.reset()
        world.copies[0].qpos[:] = np.radians([-15, -60])
        world.step(np.array([[-1, 1, -1, -1]], np.float32))
        torques.append(world.copies[0].ctrl[1])
    assert torques[0] == pytest.approx(torques[1], rel=0.05)


def test_a_weak_servo_aims_at_the_same_place() -> None:
    servo = ARM.replace(
        '<motor name="bend" joint="elbow" gear="1"', '<position name="bend" joint="elbow" kp="5"'
    )
    ends = []
    for strength in ({}, {"bend": 0.5}):
        model = mujoco.MjModel.from_xml_string(servo)
        model.opt.gravity[:] = 0
        world = world_of(columns=1, model=model, strength=strength, angles="radians")
        world.reset()
        for _ in range(400):
            world.step(np.array([[0, -0.9]], np.float32))
        ends.append(world.posture()[0, 1])
    assert ends[0] == pytest.approx(ends[1], abs=0.1)
    with pytest.raises(ValueError, match="balanced needs motors, and actuator 'bend' is none"):
        world_of(columns=1, model=mujoco.MjModel.from_xml_string(servo), balanced=True)


def test_copies_that_go_on_see_what_they_saw_when_others_begin() -> None:
    world = world_of(columns=2, degradation={"position": {"noise_std": 0.5}})
    world.reset()
    seen = world.step(np.ones((2, 2), np.float32)).observation
    after = world.restart(np.array([True, False]))
    assert_array_equal(after[1], seen[1])
    assert not np.array_equal(after[0], seen[0])


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"senses": ["taste"]}, "there is no sense 'taste'; the senses are position"),
        ({"senses": ["torque"]}, "the model has no torque sensor, which the sense 'torque' reads"),
        ({"senses": "position"}, "senses must be a list of texts, got 'position'"),
        ({"mobility": {"knee": 0.5}}, "no joint matches 'knee'; there are shoulder, elbow"),
        ({"mobility": {"elbow": 0}}, "mobility of 'elbow' must be a number from 0.01 to 1, got 0"),
        ({"strength": {"lift": 2}}, "strength of 'lift' must be a number from 0.01 to 1, got 2"),
        ({"actuation": "magic"}, "actuation must be one of motors, muscles; got 'magic'"),
        ({"physics_steps": 0}, "physics_steps must be a whole number from 1 to 1000, got 0"),
        ({"angles": "degrees"}, "angles must be one of range, radians; got 'degrees'"),
        ({"degradation": {"touch": {"gain": 0.5}}}, "the body has no sense 'touch'; it has position"),
        (
            {"degradation": {"position": {"blur": 1}}},
            "degradation of position has no option 'blur'; there are threshold",
        ),
        ({"touch": 3}, "touch must be a table, got 3"),
        ({"touch": {"bodies": ["*"]}}, 'touch has options, but senses lacks "touch"; add it'),
        (
            {"senses": ["touch"], "touch": {"resolutoin": 1}},
            "touch has no option 'resolutoin'; there are bodies",
        ),
        ({"senses": ["vision"], "vision": {"rng": 3}}, "vision has no option 'rng'"),
        ({"senses": ["vision"], "vision": {"cameras": 3}}, "cameras are chosen by a list of patterns, got 3"),
        ({"senses": [["position"]]}, "senses must be a list of texts"),
        ({"degradation": {"position": 3}}, "degradation of position must be a table, got 3"),
        (
            {"degradation": {"position": {"gain": 10**400}}},
            "degradation: gain must be .*an integer of 401 digits",
        ),
        ({"physics_steps": 10**30}, "physics_steps must be a whole number from 1 to 1000"),
        ({"balanced": "false"}, "balanced must be true or false, got 'false'"),
        ({"balanced": True, "actuation": "muscles"}, "balanced is for motors"),
    ],
)
def test_wrong_parameters_get_one_sentence(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence) as caught:
        world_of(**parameters)
    assert "\n" not in str(caught.value)


def test_limits_are_felt_from_two_degrees_before_them_on() -> None:
    world = world_of(columns=4, senses=["limits"])
    world.reset()
    for data, elbow_deg in zip(world.copies, (-60, -3, -1, 1), strict=True):
        data.qpos[:] = np.radians([0, elbow_deg])
    felt = world._senses[0].read(world.copies)[:, 1]
    assert_allclose(felt, [0, 0, 1 - np.radians(1) / 0.035, 1 + np.radians(1) / 0.035], atol=1e-6)


def test_the_reward_of_a_broken_copy_is_nothing() -> None:
    class Paid(Play):
        rewarded = True

        def reward(self, copies):  # type: ignore[no-untyped-def]
            return np.full(len(copies), 7, np.float32)

    model = arm()
    plan = blueprint(
        "Arm", model, BodyParameters(), joints=BOTH, actuators=BOTH, task=lambda: Paid(model, BOTH)
    )
    world = MujocoWorld(plan, 2, np.random.default_rng(0))
    world.reset()
    world.copies[0].qvel[:] = np.inf
    assert world.step(np.zeros((2, 2), np.float32)).external_reward.tolist() == [0, 7]
    assert world.rewarded


class Rough(Play):
    """Every so many beginnings throw the body about until nothing of it is a number."""

    def __init__(self, model: mujoco.MjModel, good_every: int) -> None:
        super().__init__(model, BOTH)
        self.good_every = good_every
        self.begun = 0

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        super().begin(data, rng, start)
        self.begun += 1
        if self.begun % self.good_every:
            data.qfrc_applied[:] = 1e30
        run(self.model, data, 1000)


def rough(good_every: int) -> tuple[MujocoWorld, Rough]:
    model = arm()
    task = Rough(model, good_every)
    plan = blueprint("Arm", model, BodyParameters(), joints=BOTH, actuators=BOTH, task=lambda: task)
    return MujocoWorld(plan, 2, np.random.default_rng(0)), task


def test_an_episode_that_breaks_down_while_it_is_begun_is_begun_again() -> None:
    world, task = rough(good_every=3)
    assert np.isfinite(world.reset("random")).all()
    assert task.begun == 6
    assert world.step(np.zeros((2, 2), np.float32)).failed is None


def test_a_body_that_never_comes_to_rest_is_given_up_in_one_sentence() -> None:
    world, _ = rough(good_every=10**6)
    with pytest.raises(UnstableError, match="the simulation of Arm broke down 20 times before an episode"):
        world.reset()


def test_a_simulation_that_has_broken_down_is_stepped_no_further() -> None:
    model = arm()
    data = mujoco.MjData(model)
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    data.qfrc_applied[:] = 1e30
    run(model, data, 1000)
    assert data.time < 100 * model.opt.timestep
