"""The worlds of MIMo's finger, hand and whole body on the floor, as a user meets them."""

import warnings
from typing import Any

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as gymnasium_check
from numpy.testing import assert_allclose, assert_array_equal
from stable_baselines3.common.env_checker import check_env as sb3_check

from babble.worlds import WORLDS, WorldError, make
from babble.worlds.mimo.finger import FINGERS
from babble.worlds.physics.world import MujocoWorld

MIMO = [id for id in WORLDS if id.startswith("Mimo")]


def world_of(id: str, columns: int = 1, seed: int = 0, **parameters: Any) -> MujocoWorld:
    world = make(id, parameters, columns, seed)
    assert isinstance(world, MujocoWorld)
    return world


def held(world: MujocoWorld, command: float, steps: int) -> None:
    """Drive all actuators of all copies by one command for some steps."""
    for _ in range(steps):
        world.step(np.full((world.columns, world.action_size), command, np.float32))


@pytest.mark.parametrize("id", MIMO)
def test_gymnasium_and_sb3_accept_the_environment(id: str) -> None:
    with warnings.catch_warnings():
        # Velocities and forces have no bounds, and images are part of a flat observation.
        warnings.simplefilter("ignore", UserWarning)
        environment = gymnasium.make(WORLDS[id].gymnasium_id)
        gymnasium_check(environment.unwrapped, skip_render_check=True)
        sb3_check(environment.unwrapped)


@pytest.mark.parametrize("id", MIMO)
def test_random_actions_break_nothing_and_seeds_repeat(id: str) -> None:
    runs = []
    for _ in range(2):
        world, rng = world_of(id, columns=2, seed=3), np.random.default_rng(0)
        world.reset("random")
        for _ in range(100):
            step = world.step(rng.uniform(-1, 1, (2, world.action_size)).astype(np.float32))
            assert step.failed is None
            ended = step.terminated | step.truncated
            if ended.any():
                world.restart(ended)
        runs.append(step.observation)
    assert np.isfinite(runs[0]).all()
    assert_array_equal(*runs)
    assert not np.array_equal(runs[0][0], runs[0][1]), "the copies go their own ways"


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("finger", FINGERS)
def test_full_torque_takes_each_finger_to_either_landmark(finger: str, side: str) -> None:
    world = world_of("MimoFinger", columns=1, finger=finger, side=side)
    assert world.action_size == world.posture_size == len(FINGERS[finger][1])
    landmarks = {landmark.name: landmark for landmark in world.landmarks}
    world.reset()
    held(world, 1.0, 100)
    assert landmarks["flexed"].at(world.posture()).all()
    assert not landmarks["extended"].at(world.posture()).any()
    held(world, -1.0, 100)
    assert landmarks["extended"].at(world.posture()).all()


def test_a_coupled_finger_bends_as_a_whole_and_an_uncoupled_one_does_not() -> None:
    """Only the knuckle is driven; the spring takes the outer joints along."""
    bent = {}
    for coupling in (0.0, 0.05):
        world = world_of("MimoFinger", coupling=coupling)
        world.reset()
        held(world, -1.0, 100)
        low = world.posture()[0, 1]
        for _ in range(100):
            world.step(np.array([[1, 0, 0]], np.float32))
        bent[coupling] = world.posture()[0, 1] - low
    assert bent[0.05] > bent[0.0] + 0.5


def test_the_hand_opens_and_closes_and_neighbours_follow_one_another() -> None:
    landmarks = {landmark.name: landmark for landmark in world_of("MimoHand").landmarks}
    drawn = {}
    for coupling in (0.0, 0.5):
        world = world_of("MimoHand", coupling=coupling)
        assert world.action_size == world.posture_size == 14
        world.reset()
        held(world, 1.0, 150)
        assert landmarks["closed"].at(world.posture()).all()
        held(world, -1.0, 150)
        assert landmarks["open"].at(world.posture()).all()
        only_index = np.zeros((1, 14), np.float32)
        index = [i for i, name in enumerate(world.posture_names) if "_ff_" in name]
        middle = [i for i, name in enumerate(world.posture_names) if "_mf_" in name]
        only_index[0, index] = 1
        for _ in range(150):
            world.step(only_index)
        drawn[coupling] = world.posture()[0, middle].mean()
    assert drawn[0.5] > drawn[0.0] + 0.3


def test_the_rollover_body_has_the_published_sizes() -> None:
    world = world_of("MimoRollover")
    assert (world.action_size, world.observation_size, world.posture_size) == (46, 98, 49)
    assert world.step_secs == pytest.approx(0.01)
    assert len(world.state_names) == 98, "49 positions and 49 velocities (thesis 4.5)"
    assert world.state_names[49:] == tuple(f"velocity/{joint}" for joint in world.posture_names)
    assert world.reset().shape == world.state().shape
    steps = [world.step(np.zeros((1, 46), np.float32)) for _ in range(500)]
    assert [step.truncated[0] for step in steps].count(True) == 1
    assert steps[-1].truncated[0]
    assert not any(step.terminated[0] for step in steps)


def test_the_rollover_body_may_have_five_fingered_hands_which_are_all_driven() -> None:
    world = world_of("MimoRollover", hands="five_finger", head_held=False)
    assert (world.action_size, world.observation_size, world.posture_size) == (88, 182, 91)
    still = {"robot:hip_lean2", "robot:hip_rot2", "robot:hip_bend2"}
    moved = {world.posture_names[joint] for joints in world.moves for joint in joints}
    assert moved == set(world.posture_names) - still, "the spine's second hinges follow the first"
    world.reset()
    rng, seen = np.random.default_rng(0), []
    for _ in range(150):
        step = world.step(rng.uniform(-1, 1, (1, 88)).astype(np.float32))
        assert step.failed is None
        seen.append(world.posture()[0])
    assert (np.std(seen, axis=0) > 0.03).all(), "every joint moves, down to the fingers' tips"
    with pytest.raises(WorldError, match="hands must be one of mitten, five_finger; got 'claws'"):
        world_of("MimoRollover", hands="claws")


@pytest.mark.parametrize(("start", "facing"), [("supine", 1), ("prone", -1)])
def test_the_body_lies_still_on_its_back_or_belly(start: str, facing: int) -> None:
    world = world_of("MimoRollover", columns=3, start=start)
    world.reset()
    for data in world.copies:
        chest = data.body("upper_body")
        assert chest.xmat.reshape(3, 3)[2, 0] * facing > 0.8, "the chest's x axis points out of it"
        assert chest.xpos[2] < 0.15
        assert np.abs(data.qvel[:6]).max() < 0.2
    assert len(np.unique(world.posture().round(6), axis=0)) == 3, "each copy begins a little differently"


@pytest.mark.parametrize(("start", "side"), [("supine", 1.0), ("prone", -1.0)])
def test_a_body_whose_sides_count_says_which_it_lies_on(start: str, side: float) -> None:
    world = world_of("MimoRollover", columns=2, start=start, sides=True)
    world.reset()
    told = world.side()
    assert told is not None
    assert told.dtype == np.float32
    assert_allclose(told, [side] * 2, atol=0.1)
    data = world.copies[1]
    data.qpos[3:7] = turned(data.qpos[3:7], 90)
    mujoco.mj_forward(world.blueprint.model, data)
    assert_allclose(world.side(), [side, 0], atol=0.1, err_msg="one lies as it lay, the other on a flank")


def turned(root: np.ndarray, degrees: float) -> np.ndarray:
    """A root's quaternion, turned about the body's long axis."""
    half, found = np.radians(degrees) / 2, np.zeros(4)
    mujoco.mju_mulQuat(found, root, np.array([np.cos(half), 0, 0, np.sin(half)]))
    return found


def test_sides_count_only_where_that_was_asked_for() -> None:
    assert world_of("MimoRollover").side() is None
    with pytest.raises(WorldError, match="sides"):
        world_of("MimoRollover", sides=1)


def test_random_starts_lie_calmly_on_either_side() -> None:
    world = world_of("MimoRollover", columns=24)
    world.reset("random")
    for data in world.copies:
        assert np.abs(data.qvel).max() < 8
        assert data.qpos[2] < 0.2
        assert data.contact.dist.min(initial=0.0) > -0.01, "nothing is deep in anything"
    sides = [data.body("upper_body").xmat.reshape(3, 3)[2, 0] > 0 for data in world.copies]
    assert 5 <= sum(sides) <= 19


def test_every_sense_of_the_whole_body_can_be_had_at_once() -> None:
    senses = ["position", "velocity", "limits", "torque", "actuation", "vestibular", "touch"]
    world = world_of("MimoRollover", senses=senses, touch={"resolution": 0.3})
    assert list(world.senses) == senses
    assert world.senses["torque"] == (66,)
    assert world.senses["actuation"] == (92,)
    assert world.senses["vestibular"] == (6,)
    observation = world.reset()
    start = world.observation_size - world.senses["touch"][0]
    assert np.abs(observation[0, start:]).max() > 0, "the floor is felt"
    gravity = observation[0, start - 6 : start - 3]
    assert np.linalg.norm(gravity) == pytest.approx(9.81, rel=0.05)


def test_muscles_move_the_whole_body() -> None:
    world = world_of("MimoRollover", actuation="muscles")
    assert world.action_size == 92
    lying = world.reset()
    held(world, 0.5, 50)
    assert np.abs(world.step(np.full((1, 92), -1, np.float32)).observation - lying).max() > 0.1


def test_restricted_joints_keep_the_body_within_them() -> None:
    world = world_of("MimoRollover", columns=1, mobility={"robot:*_knee": 0.2})
    knee = world.posture_names.index("robot:left_knee")
    bent = []
    world.reset()
    for command in (1.0, -1.0):
        held(world, command, 100)
        bent.append(world.copies[0].joint("robot:left_knee").qpos[0])
    assert np.degrees(max(bent) - min(bent)) < 0.2 * 149 + 6
    assert world.posture()[0, knee] == pytest.approx(-1, abs=0.2)


@pytest.mark.parametrize(
    ("id", "parameters", "sentence"),
    [
        (
            "MimoFinger",
            {"finger": "toe"},
            "finger must be one of index, middle, ring, little, thumb; got 'toe'",
        ),
        ("MimoFinger", {"coupling": -1}, "coupling must be a number from 0 to 100, got -1"),
        ("MimoFinger", {"senses": ["vestibular"]}, "the model has no accelerometer and gyroscope"),
        ("MimoHand", {"side": "top"}, "side must be one of right, left; got 'top'"),
        ("MimoRollover", {"start": "sideways"}, "start must be one of supine, prone; got 'sideways'"),
        ("MimoRollover", {"reset_noise_rad": 4}, "reset_noise_rad must be a number from 0 to 1, got 4"),
        ("MimoRollover", {"senses": ["touch"], "touch": {"bodies": ["tail"]}}, "no body matches 'tail'"),
        ("MimoRollover", {"senses": ["touch"], "touch": {"colour": 1}}, "touch has no option 'colour'"),
    ],
)
def test_wrong_parameters_are_named(id: str, parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(WorldError, match=sentence) as caught:
        make(id, parameters, 1, 0)
    assert "\n" not in str(caught.value)


def test_a_held_head_does_not_turn() -> None:
    turned = {}
    for head_held in (True, False):
        world = world_of("MimoRollover", head_held=head_held)
        world.reset()
        held(world, 1.0, 60)
        turned[head_held] = abs(world.copies[0].joint("robot:head_swivel").qpos[0])
    assert turned[True] < 0.05
    assert turned[False] > 0.3


def test_a_step_of_the_world_is_the_bare_simulation() -> None:
    world = world_of("MimoRollover")
    world.reset()
    bare = mujoco.MjData(world.blueprint.model)
    mujoco.mj_copyData(bare, world.blueprint.model, world.copies[0])
    rng = np.random.default_rng(0)
    for _ in range(20):
        action = rng.uniform(-1, 1, (1, 46)).astype(np.float32)
        seen = world.step(action).observation
        bare.ctrl[:] = action[0]
        mujoco.mj_step(world.blueprint.model, bare, 2)
    assert_allclose(seen[0], [*bare.qpos[7:], *bare.qvel[6:]], rtol=1e-6, atol=1e-6)


def test_noisy_senses_repeat_with_the_seed() -> None:
    environment = gymnasium.make("babble/MimoFinger-v0", degradation={"position": {"noise_std": 0.1}})
    first, second, other = (environment.reset(seed=seed)[0] for seed in (3, 3, 4))
    assert_array_equal(first, second)
    assert not np.array_equal(first, other)


def test_an_observation_can_be_taken_apart_by_sense() -> None:
    environment = gymnasium.make("babble/MimoRollover-v0", senses=["position", "vestibular"]).unwrapped
    observation, _ = environment.reset(seed=0)
    parts = environment.split(observation)
    assert {name: part.shape for name, part in parts.items()} == {"position": (49,), "vestibular": (6,)}
    assert_array_equal(np.concatenate(list(parts.values())), observation)


def test_an_environment_that_breaks_down_is_cut_off_and_says_so() -> None:
    environment = gymnasium.make("babble/MimoFinger-v0", disable_env_checker=True)
    environment.reset(seed=0)
    environment.unwrapped._single.copies[0].qvel[:] = np.nan
    observation, reward, terminated, truncated, info = environment.step(np.zeros(3, np.float32))
    assert (reward, terminated, truncated, info) == (0.0, False, True, {"failed": True})
    assert np.isfinite(observation).all()
