"""Standing up at a bar, as a user meets it."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from babble.worlds import WorldError, make
from babble.worlds.physics.world import MujocoWorld

STANDING_UP = {
    "hip_flex": 1.0,
    "knee": 0.25,
    "foot_flexion": 0.5,
    "hip_bend": -0.2,
    "shoulder_abduction": -0.7,
}
HANDS = [(f"{side}_grip_{end}", f"{side}_hold_{end}") for side in ("right", "left") for end in (-1, 1)]


def world_of(columns: int = 1, seed: int = 0, **parameters: Any) -> MujocoWorld:
    world = make("MimoStandUp", parameters, columns, seed)
    assert isinstance(world, MujocoWorld)
    return world


def still(world: MujocoWorld) -> np.ndarray:
    return np.zeros((world.columns, world.action_size), np.float32)


def head_m(data: mujoco.MjData) -> float:
    return float(data.geom("head").xpos[2])


def off_the_bar_m(data: mujoco.MjData) -> float:
    return max(float(np.linalg.norm(data.site(grip).xpos - data.site(at).xpos)) for grip, at in HANDS)


def at(world: MujocoWorld) -> list[str]:
    """The landmarks at which the first copy is."""
    return [landmark.name for landmark in world.landmarks if landmark.at(world.posture())[0]]


def motors_of(world: MujocoWorld) -> list[str]:
    """The motors of a child with a held head, in the order of an action."""
    names = [world.blueprint.model.actuator(motor).name for motor in range(world.blueprint.model.nu)]
    return [name for name in names if "head" not in name and "eye" not in name]


def standing_up(world: MujocoWorld) -> np.ndarray:
    """(E, 37) stretch hips and knees, lean onto the hands: commands that need no eye on the outcome."""
    command, names = still(world), motors_of(world)
    for part, value in STANDING_UP.items():
        command[:, [index for index, name in enumerate(names) if name.endswith(part)]] = value
    return command


@pytest.mark.parametrize("feet_held", [True, False])
def test_episodes_begin_at_rest_sitting_with_the_hands_on_the_bar(feet_held: bool) -> None:
    world = world_of(columns=3, feet_held=feet_held)
    world.reset()
    assert at(world) == [], "it does not stand"
    for data in world.copies:
        assert off_the_bar_m(data) < 0.002
        assert 0.38 < head_m(data) < 0.42
        assert data.body("hip").xpos[2] < 0.06, "it sits on the floor"
        assert np.abs(data.qvel).max() < 1
        assert min(contact.dist for contact in data.contact) > -0.002
    assert len(np.unique(world.posture().round(5), axis=0)) == 3, "each a little different"
    for _ in range(100):
        step = world.step(still(world))
        assert_allclose(step.external_reward, 0.40, atol=0.02, err_msg="nothing sags or jumps")
    if feet_held:
        assert at(world) == [], "free feet creep forward"


def test_random_starts_differ_and_are_possible() -> None:
    world = world_of(columns=12)
    world.reset("random")
    heads = [head_m(data) for data in world.copies]
    assert max(heads) - min(heads) > 0.05
    for data in world.copies:
        assert off_the_bar_m(data) < 0.01
        assert min((contact.dist for contact in data.contact), default=0.0) > -0.005
        assert np.abs(data.qvel).max() < 30


def test_hands_stay_on_the_bar_and_nothing_breaks_under_random_actions() -> None:
    world, rng, farthest = world_of(columns=4), np.random.default_rng(1), 0.0
    world.reset()
    for _ in range(600):
        step = world.step(rng.uniform(-1, 1, (4, world.action_size)).astype(np.float32))
        assert step.failed is None
        farthest = max(farthest, *map(off_the_bar_m, world.copies))
        if step.truncated.any():
            world.restart(step.truncated)
    assert farthest < 0.02


def test_the_reward_is_head_height_less_the_squared_torques() -> None:
    free, dear = (world_of(alpha=alpha, senses=["position", "actuation"]) for alpha in (0.0, 0.002))
    free.reset()
    dear.reset()
    action = np.random.default_rng(0).uniform(-1, 1, (1, free.action_size)).astype(np.float32)
    for _ in range(10):
        gained, charged = free.step(action), dear.step(action)
        torques = gained.observation[0, -free.action_size :]
        assert_array_equal(gained.observation, charged.observation)
        assert_allclose(gained.external_reward, head_m(free.copies[0]), rtol=1e-6)
        cost = gained.external_reward - charged.external_reward
        assert_allclose(cost, 0.002 * (torques**2).sum(), rtol=1e-4)
    assert cost > 0.1


def test_a_child_that_is_lifted_is_rewarded_more() -> None:
    world = world_of()
    world.reset()
    sitting = world.step(still(world)).external_reward[0]
    lift = world.copies[0].body("upper_body").xfrc_applied
    lift[2] = 1.2 * 9.81 * world.blueprint.model.body_subtreemass[0]
    for _ in range(150):
        lifted = world.step(still(world)).external_reward[0]
    assert lifted > sitting + 0.1


@pytest.mark.parametrize("feet_held", [True, False])
def test_its_own_motors_can_stand_it_up_and_that_pays(feet_held: bool) -> None:
    world = world_of(feet_held=feet_held)
    world.reset()
    command = standing_up(world)
    rewards = [world.step(command).external_reward[0] for _ in range(200)]
    assert head_m(world.copies[0]) > 0.65
    assert at(world) == ["standing"]
    assert rewards[-1] > rewards[0] + 0.15
    assert off_the_bar_m(world.copies[0]) < 0.005


def test_held_feet_stay_and_free_ones_may_go() -> None:
    moved = {}
    for feet_held in (True, False):
        world = world_of(feet_held=feet_held)
        world.reset()
        before = world.copies[0].body("right_foot").xpos.copy()
        for _ in range(100):
            action = still(world)
            action[0, ::2] = 1
            world.step(action)
        moved[feet_held] = np.linalg.norm(world.copies[0].body("right_foot").xpos - before)
    assert moved[True] < 0.005
    assert moved[False] > 0.02


@pytest.mark.parametrize(("head_held", "joints", "motors"), [(True, 40, 37), (False, 49, 46)])
def test_a_held_head_is_no_part_of_the_world(head_held: bool, joints: int, motors: int) -> None:
    world = world_of(head_held=head_held)
    assert (world.posture_size, world.action_size) == (joints, motors)
    assert dict(world.senses) == {"position": (joints,), "velocity": (joints,), "vestibular": (6,)}
    assert any("head" in name for name in world.posture_names) is not head_held


def test_the_bar_is_felt_by_the_hands_and_has_no_skin_itself() -> None:
    with_bar = world_of(senses=["touch"], touch={"resolution": 0.2})
    without = make("MimoRollover", {"senses": ["touch"], "touch": {"resolution": 0.2}}, 1, 0)
    assert dict(with_bar.senses) == dict(without.senses)
    hands = world_of(senses=["touch"], touch={"resolution": 0.2, "bodies": ["*_hand", "*_fingers"]})
    hands.reset()
    close = still(hands)
    close[0, [index for index, name in enumerate(motors_of(hands)) if name.endswith("fingers")]] = -1
    assert max(np.abs(hands.step(close).observation).max() for _ in range(30)) > 0.1


def test_an_episode_is_cut_off_after_500_steps() -> None:
    world = world_of(physics_steps=1)
    world.reset()
    ends = [world.step(still(world)) for _ in range(500)]
    assert [bool(step.truncated[0]) for step in ends] == [False] * 499 + [True]
    assert not any(step.terminated[0] for step in ends)


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"alpha": -1}, "alpha must be a number from 0 to 1, got -1"),
        ({"alpha": float("nan")}, "alpha must be a number from 0 to 1, got nan"),
        ({"feet_held": "no"}, "feet_held must be true or false, got 'no'"),
        ({"start_push": 2}, "start_push must be a number from 0 to 1, got 2"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(WorldError, match=sentence):
        world_of(**parameters)
