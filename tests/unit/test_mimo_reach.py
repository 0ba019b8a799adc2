"""Reaching for a ball, as a user meets it."""

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from babble.worlds import WorldError, make
from babble.worlds.mimo.reach import MimoReach
from babble.worlds.physics.world import MujocoWorld


def world_of(columns: int = 1, seed: int = 0, **parameters: Any) -> MujocoWorld:
    world = make("MimoReach", parameters, columns, seed)
    assert isinstance(world, MujocoWorld)
    return world


def towards_the_ball(world: MujocoWorld, observation: np.ndarray) -> np.ndarray:
    """(1, 8) pull the hand along the sense "target", by the motors whose joints can do so."""
    model, data = world.blueprint.model, world.copies[0]
    along = np.zeros((3, model.nv))
    mujoco.mj_jacSite(model, data, along, None, model.site("reaching").id)
    target, velocity = observation[0, 16:19], observation[0, 8:16]
    joints = model.actuator_trnid[:, 0]
    torque = (along.T @ (60 * target) + data.qfrc_bias)[joints] - 0.2 * velocity[joints]
    return np.clip(torque / model.actuator_gear[:, 0], -1, 1)[None].astype(np.float32)


def test_reaching_out_touches_the_ball_which_ends_the_episode_with_the_bonus() -> None:
    world, touched = world_of(touch_bonus=7.0), 0
    for _ in range(20):
        observation = world.reset()
        for _ in range(200):
            step = world.step(towards_the_ball(world, observation))
            observation = step.observation
            distance = np.linalg.norm(observation[0, 16:19])
            assert_allclose(step.external_reward[0], 7.0 * step.terminated[0] - distance, atol=1e-5)
            if step.terminated[0]:
                assert distance < 0.1
                touched += 1
                break
    assert touched >= 10, "pulling straight at it is not always the way"


def test_the_ball_is_where_the_sense_says_and_elsewhere_in_each_episode() -> None:
    world = world_of(columns=24)
    observation = world.reset()
    balls = np.array([data.geom("ball").xpos for data in world.copies])
    hands = np.array([data.site("reaching").xpos for data in world.copies])
    assert_allclose(world.senses["target"], 3)
    assert_allclose(observation[:, -3:], balls - hands, atol=1e-6)
    shoulder = world.copies[0].body("right_upper_arm").xpos
    assert (np.linalg.norm(balls - shoulder, axis=1) < 0.3).all(), "an arm's length away"
    assert (balls[:, 0] > shoulder[0]).all(), "in front of the child"
    assert (balls.std(axis=0) > 0.03).all()
    for data in world.copies:
        assert not (data.contact.geom == data.geom("ball").id).any(), "nothing touches it yet"


def test_only_the_right_arm_moves() -> None:
    world = world_of()
    world.reset()
    model = world.blueprint.model
    assert all("right" in name for name in world.posture_names)
    before = {index: world.copies[0].xpos[index].copy() for index in range(model.nbody)}
    for _ in range(60):
        world.step(np.full((1, world.action_size), -1, np.float32))
    after = world.copies[0].xpos
    moved = {model.body(i).name for i, place in before.items() if np.linalg.norm(after[i] - place) > 1e-6}
    assert moved == {f"right_{part}" for part in ("upper_arm", "lower_arm", "hand", "fingers")}


def test_nothing_breaks_under_random_actions_and_random_starts_differ() -> None:
    world, rng, touched = world_of(columns=4), np.random.default_rng(0), 0
    world.reset("random")
    assert len(np.unique(world.posture().round(2), axis=0)) == 4
    for _ in range(600):
        step = world.step(rng.uniform(-1, 1, (4, world.action_size)).astype(np.float32))
        assert step.failed is None
        assert min((c.dist for data in world.copies for c in data.contact), default=0.0) > -0.02
        touched += int(step.terminated.sum())
        if (over := step.terminated | step.truncated).any():
            world.restart(over)
    assert 0 < touched < 30


def test_the_target_can_be_left_to_the_eyes() -> None:
    assert dict(world_of(target_felt=False).senses) == {"position": (8,), "velocity": (8,)}


def test_seeded_resets_put_the_ball_at_the_same_place() -> None:
    environment = MimoReach()
    first, second, other = (environment.reset(seed=seed)[0] for seed in (3, 3, 4))
    assert_allclose(first, second)
    assert np.abs(first - other)[-3:].max() > 0.01


@pytest.mark.parametrize(
    ("parameters", "sentence"),
    [
        ({"touch_bonus": -1}, "touch_bonus must be a number from 0 to 1e.06, got -1"),
        ({"target_felt": "no"}, "target_felt must be true or false, got 'no'"),
    ],
)
def test_wrong_parameters_are_named(parameters: dict[str, Any], sentence: str) -> None:
    with pytest.raises(WorldError, match=sentence):
        world_of(**parameters)
