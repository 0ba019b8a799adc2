"""The Composer in one process: babbling, the first latent, the first policy (phases 1 and 2)."""

import numpy as np

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.memory import ExperienceMemory
from babble.noise import make_noise
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.export import export_policy
from babble.policy.goals import GoalClock
from babble.policy.ppo import GoalPPO
from babble.scores import score, walk_legs
from babble.segments import SegmentBuilder
from babble.worlds import make

COLUMNS = 16
BABBLE_STEPS = 1000
UPDATES = 10


def babbled(world):
    memory, segments = ExperienceMemory(world.senses), SegmentBuilder(125, COLUMNS)
    noise = make_noise("ou", scale=0.6, columns=COLUMNS, size=3, rng=np.random.default_rng(1))
    observation = world.reset()
    for _ in range(BABBLE_STEPS):
        if segment := segments.add(observation=observation, episode=np.zeros(COLUMNS, np.int32)):
            memory.extend("a", {"observation": segment["observation"]}, segment["episode"])
        observation = world.step(noise.sample()).observation
    return memory


def fitted(memory):
    trainer = EncoderTrainer(
        Encoder(memory.layout.senses, 2, (64, 64), *memory.scaling(), seed=0), learning_rate=1e-3, batch=128
    )
    trainer.begin_fit(30, 0.3)
    trainer.update(memory, 400)
    trainer.end_fit()
    return trainer.encoder


def practised(world, encoder, ppo):
    """PPO from rollouts of the exported models; the mean reward of each update."""
    rng, rewards = np.random.default_rng(2), []
    clock, z = GoalClock(COLUMNS, 2, 100, rng), encoder.latent(world.reset())
    for _ in range(UPDATES):
        policy, segments, rollout = PolicyModel(export_policy(ppo)), SegmentBuilder(128, COLUMNS), None
        while rollout is None:
            goal = clock.goal
            action, log_prob = policy.act(z, goal, rng)
            step = world.step(action)
            z, before = encoder.latent(step.observation), z
            rollout = segments.add(
                latent=before,
                next_latent=z,
                goal=goal,
                action=action,
                log_prob=log_prob,
                truncated=clock.tick() | step.truncated,
                terminated=step.terminated,
            )
        rewards.append(ppo.update(rollout)["reward_mean"])
    return rewards


def test_a_composer_learns_to_reach_both_ends_of_a_cuboid():
    world = make("Cuboid", {}, COLUMNS, 0)
    encoder = EncoderModel(export_encoder(fitted(babbled(world))))
    along = np.zeros((9, 3), np.float32)
    along[:, 0] = np.linspace(-0.9, 0.9, 9)
    z = encoder.latent(along)[:, 0]
    assert (np.diff(z) > 0).all() or (np.diff(z) < 0).all(), "the latent is ordered along the long axis"
    assert abs(z[-1] - z[0]) > 0.5

    ppo = GoalPPO(2, 3, seed=0)
    untrained = PolicyModel(export_policy(ppo))
    rewards = practised(world, encoder, ppo)
    assert np.mean(rewards[-2:]) > np.mean(rewards[:2]) + 0.2

    trained = PolicyModel(export_policy(ppo))
    before, after = (
        score(walk_legs(world, encoder, policy, np.random.default_rng(3), 4, 100), world.diameter)
        for policy in (untrained, trained)
    )
    assert before["z_min"] < 0.8
    assert after["z_min"] > 0.85
    assert after["separation"] > 0.75
