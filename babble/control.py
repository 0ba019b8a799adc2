"""The control experiment: GROUND (thesis 3.3) on an encoder that has learned nothing.

A policy can be trained on any latent, so an untrained encoder sends the body to far ends too; what it
cannot do is come near the vertices. A score that this control passes proves nothing. It is also the
whole of GROUND in one process: a random walk, an encoder, and PPO on rollouts.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.memory import ExperienceMemory
from babble.noise import Noise
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.export import export_policy
from babble.policy.goals import GoalClock
from babble.policy.ppo import GoalPPO
from babble.worlds.batch import World

Arrays = dict[str, NDArray[Any]]


def train_on_untrained_encoder(
    world: World,
    latent_dim: int,
    *,
    noise: Noise,
    walk_steps: int,
    train_steps: int,
    goal_period_steps: int = 100,
    encoder_hidden: tuple[int, ...] = (64, 64),
    seed: int = 0,
    **ppo: Any,
) -> tuple[EncoderModel, PolicyModel]:
    """An encoder with random weights, and a policy trained on it for `train_steps` environment steps.

    The walk of `walk_steps` only sets the encoder's scaling. `ppo` are fields of `PPOSettings`.
    Raises ValueError or TypeError for what one of the parts cannot take.
    """
    encoder_seed, policy_seed, acting_seed = (
        int(word) for word in np.random.SeedSequence([seed, 5]).generate_state(3)
    )
    mean, scale = walk(world, noise, walk_steps).scaling()
    network = Encoder(world.observation_size, latent_dim, encoder_hidden, mean, scale, seed=encoder_seed)
    encoder = EncoderModel(export_encoder(network))
    learner = GoalPPO(latent_dim, world.action_size, columns=world.columns, seed=policy_seed, **ppo)
    rng = np.random.default_rng(acting_seed)
    clock = GoalClock(world.columns, latent_dim, goal_period_steps, rng)
    return encoder, ground(world, encoder, learner, clock, rng, train_steps)


def walk(world: World, noise: Noise, steps: int) -> ExperienceMemory:
    """A random walk from the centre: BABBLE. `steps` are summed over the world's columns, rounded up."""
    observed, episodes = [], []
    episode = np.zeros(world.columns, dtype=np.int32)
    observation = world.reset()
    for _ in range(-(-steps // world.columns)):
        observed.append(observation)
        episodes.append(episode)
        step = world.step(noise.sample())
        ended = step.terminated | step.truncated
        episode = episode + ended.astype(np.int32)
        observation = world.restart(ended) if ended.any() else step.observation
    memory = ExperienceMemory()
    memory.extend("walk", np.stack(observed), np.stack(episodes))
    return memory


def ground(
    world: World,
    encoder: EncoderModel,
    ppo: GoalPPO,
    clock: GoalClock,
    rng: np.random.Generator,
    steps: int,
) -> PolicyModel:
    """Train `ppo` towards the goals of `clock`, the encoder frozen; `steps` in whole rollouts, rounded up."""
    policy = PolicyModel(export_policy(ppo))
    observation = world.reset()
    for _ in range(-(-steps // (ppo.settings.steps * ppo.settings.columns))):
        rows = []
        for _ in range(ppo.settings.steps):
            row, observation = transition(world, observation, encoder, policy, clock, rng)
            rows.append(row)
        ppo.update({name: np.stack([row[name] for row in rows]) for name in rows[0]})
        policy = PolicyModel(export_policy(ppo))
    return policy


def transition(
    world: World,
    observation: NDArray[np.float32],
    encoder: EncoderModel,
    policy: PolicyModel,
    clock: GoalClock,
    rng: np.random.Generator,
) -> tuple[Arrays, NDArray[np.float32]]:
    """One step of all columns as PPO wants it, and the observation to go on from.

    A new goal cuts the episode off under the old one; the body stays where it is.
    """
    latent, goal = encoder.latent(observation), clock.goal
    action, log_prob = policy.act(latent, goal, rng)
    step = world.step(action)
    row: Arrays = {
        "latent": latent,
        "next_latent": encoder.latent(step.observation),
        "goal": goal,
        "action": action,
        "log_prob": log_prob,
        "truncated": clock.tick() | step.truncated,
        "terminated": step.terminated,
    }
    ended = step.terminated | step.truncated
    return row, world.restart(ended) if ended.any() else step.observation
