"""The mobile paradigm, as a user meets it."""

from typing import Any

import numpy as np
import pytest

from babble.worlds import WorldError, make
from babble.worlds.mimo.kick import BALLS, HOOK_M
from babble.worlds.physics.world import MujocoWorld

PERIOD_STEPS = 80


def world_of(columns: int = 1, seed: int = 0, **parameters: Any) -> MujocoWorld:
    world = make("MimoKick", parameters, columns, seed)
    assert isinstance(world, MujocoWorld)
    return world


def still(world: MujocoWorld) -> np.ndarray:
    return np.zeros((world.columns, world.action_size), np.float32)


def driven(world: MujocoWorld, motor: str) -> int:
    """The component of an action that drives a motor of a child with a held head."""
    model = world.blueprint.model
    names = [model.actuator(index).name for index in range(model.nu)]
    return [name for name in names if "head" not in name and "eye" not in name].index(motor)


def mobiles_speed(world: MujocoWorld, action: np.ndarray, steps: int = 100) -> float:
    """The mean external reward of the first copy while it acts like this from an episode's begin, m/s."""
    world.reset()
    return float(np.mean([world.step(action).external_reward[0] for _ in range(steps)]))


@pytest.mark.parametrize("side", ["right", "left"])
def test_a_kick_of_the_tied_leg_moves_the_mobile_and_one_of_the_other_does_not(side: str) -> None:
    speeds = {}
    for leg in ("right", "left"):
        world = world_of(side=side)
        action = still(world)
        action[0, driven(world, f"act:{leg}_hip_flex")] = -1
        speeds[leg] = mobiles_speed(world, action)
    other = "left" if side == "right" else "right"
    assert speeds[side] > 0.1
    assert speeds[other] < 0.1 * speeds[side]
    assert mobiles_speed(world_of(side=side), still(world)) < 0.1 * speeds[side]


def test_without_the_ribbon_no_kick_moves_the_mobile() -> None:
    world = world_of(tied=False)
    rng = np.random.default_rng(0)
    for _ in range(5):
        action = np.sign(rng.uniform(-1, 1, (1, world.action_size))).astype(np.float32)
        assert mobiles_speed(world, action, 60) < 1e-6


def test_the_ribbon_pulls_when_the_leg_lies_and_hangs_slack_when_it_is_drawn_up() -> None:
    world = world_of()
    world.reset()
    data = world.copies[0]

    def drawn_towards_the_feet_m() -> float:
        return float(data.site("mobile:knot").xpos[0] - HOOK_M[0])

    lying = drawn_towards_the_feet_m()
    action = still(world)
    action[0, driven(world, "act:right_hip_flex")] = -1
    for _ in range(400):
        step = world.step(action)
    assert lying > 0.02
    assert abs(drawn_towards_the_feet_m()) < 0.005
    assert step.external_reward[0] < 0.02, "a leg that is only held up does not entertain"


def test_vigorous_kicking_pays_more_than_gentle_kicking() -> None:
    """Conjugate reinforcement: the mobile answers in proportion."""
    world, pay = world_of(), []
    for strength in (0.25, 0.5, 1.0):
        world.reset()
        rewards = []
        for step in range(400):
            action = still(world)
            action[0, driven(world, "act:right_hip_flex")] = strength * np.sign(
                np.sin(2 * np.pi * step / PERIOD_STEPS)
            )
            rewards.append(world.step(action).external_reward[0])
        pay.append(np.mean(rewards))
    assert pay[0] < pay[1] < pay[2]
    assert pay[2] > 0.3


def test_the_reward_is_the_mean_speed_of_the_balls() -> None:
    """Found again from where the balls are, a physics step apart."""
    world = world_of(physics_steps=1, start_push=0.0)
    world.reset()
    data = world.copies[0]
    action = still(world)
    action[0, driven(world, "act:right_hip_flex")] = -1
    for _ in range(100):
        world.step(action)
    places, rewards = [], []
    for _ in range(3):
        rewards.append(world.step(action).external_reward[0])
        places.append([data.geom(f"mobile:{ball}").xpos.copy() for ball in range(len(BALLS))])
    moved = np.linalg.norm(np.subtract(places[2], places[0]), axis=1) / (2 * world.step_secs)
    assert rewards[1] == pytest.approx(moved.mean(), rel=0.03)
    assert rewards[1] > 0.05


def test_episodes_begin_lying_under_a_mobile_out_of_reach() -> None:
    world = world_of(columns=3)
    world.reset()
    for data in world.copies:
        assert data.body("upper_body").xmat.reshape(3, 3)[2, 0] > 0.9, "it lies on its back"
        assert min(contact.dist for contact in data.contact) > -0.002
    assert len(np.unique(world.posture().round(5), axis=0)) == 3, "each a little different"


def test_nothing_breaks_and_nothing_is_hit_under_random_actions() -> None:
    world, rng = world_of(columns=4), np.random.default_rng(2)
    world.reset("random")
    assert len(np.unique(world.posture().round(2), axis=0)) == 4
    model = world.blueprint.model
    lowest, highest = np.inf, -np.inf
    mobile = model.body_rootid[model.geom("mobile:0").bodyid[0]]
    limbs = [
        geom for geom in range(model.ngeom) if model.body_rootid[model.geom_bodyid[geom]] not in (0, mobile)
    ]
    for _ in range(600):
        step = world.step(rng.uniform(-1, 1, (4, world.action_size)).astype(np.float32))
        assert step.failed is None
        for data in world.copies:
            lowest = min(lowest, *(data.geom(f"mobile:{ball}").xpos[2] for ball in range(len(BALLS))))
            highest = max(highest, data.geom_xpos[limbs, 2].max())
        if step.truncated.any():
            world.restart(step.truncated)
    assert highest < lowest


def test_the_mobile_is_no_part_of_the_child() -> None:
    world = world_of(senses=["position", "velocity", "touch"], touch={"resolution": 0.2})
    without = make("MimoRollover", {"senses": ["touch"], "touch": {"resolution": 0.2}}, 1, 0)
    assert world.senses["position"] == world.senses["velocity"] == (40,)
    assert world.senses["touch"] == without.senses["touch"]
    assert not any("mobile" in name for name in world.posture_names)
    assert world.action_size == 37


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"side": "both"}, "side must be one of right, left; got 'both'"),
        ({"tied": 1}, "tied must be true or false, got 1"),
        ({"ribbon_m": 5}, "ribbon_m must be a number from 0.3 to 1, got 5"),
        ({"ribbon_stiffness": 0}, "ribbon_stiffness must be a number from 1 to 200, got 0"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(WorldError, match=sentence):
        world_of(**parameters)
