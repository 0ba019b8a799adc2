"""The control experiment: GROUND (thesis 3.3) on an encoder that has learned nothing.

A policy can be trained on any latent, so an untrained encoder sends the body to far ends too; what it
cannot do is come near the vertices. A score that this control passes proves nothing. It is also the
whole of GROUND in one process: a random walk, an encoder, and PPO on rollouts.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from babble.breakdowns import Breakdowns
from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder, Output
from babble.encoder.vision import FEATURES
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
    vision_features: int = FEATURES,
    encoder_output: Output = "softmax",
    seed: int = 0,
    **ppo: Any,
) -> tuple[EncoderModel, PolicyModel]:
    """An encoder with random weights, and a policy trained on it for `train_steps` environment steps.

    The walk of `walk_steps` only sets the encoder's scaling. `ppo` are fields of `PPOSettings`.
    Raises ValueError or TypeError for what one of the parts cannot take, and `UnstableError`.
    """
    encoder_seed, policy_seed, acting_seed = (
        int(word) for word in np.random.SeedSequence([seed, 5]).generate_state(3)
    )
    mean, scale = walk(world, noise, walk_steps).scaling()
    network = Encoder(
        world.senses,
        latent_dim,
        encoder_hidden,
        mean,
        scale,
        vision_features=vision_features,
        output=encoder_output,
        seed=encoder_seed,
    )
    encoder = EncoderModel(export_encoder(network))
    learner = GoalPPO(latent_dim, world.action_size, columns=world.columns, seed=policy_seed, **ppo)
    rng = np.random.default_rng(acting_seed)
    clock = GoalClock(world.columns, latent_dim, goal_period_steps, rng)
    return encoder, ground(world, encoder, learner, clock, rng, train_steps)


def walk(world: World, noise: Noise, steps: int) -> ExperienceMemory:
    """A random walk from the centre: BABBLE. `steps` are summed over the world's columns, rounded up.

    A column whose simulation breaks down begins a new episode. Raises `UnstableError` if all steps do.
    """
    memory, breakdowns = ExperienceMemory(world.senses), Breakdowns(world.id)
    observed, episodes = [], []
    episode = np.zeros(world.columns, dtype=np.int32)
    observation = world.reset()
    for _ in range(-(-steps // world.columns)):
        observed.append(memory.layout.pack(observation))
        episodes.append(episode)
        step = world.step(noise.sample())
        ended = step.terminated | step.truncated
        if step.failed is not None and step.failed.any():
            breakdowns.note(step.failed, segments=0)
            ended = ended | step.failed
        else:
            breakdowns.finish()
        episode = episode + ended.astype(np.int32)
        observation = world.restart(ended) if ended.any() else step.observation
    parts = {part: np.stack([packed[part] for packed in observed]) for part in memory.layout.parts}
    memory.extend("walk", parts, np.stack(episodes))
    return memory


def ground(
    world: World,
    encoder: EncoderModel,
    ppo: GoalPPO,
    clock: GoalClock,
    rng: np.random.Generator,
    steps: int,
) -> PolicyModel:
    """Train `ppo` towards the goals of `clock`, the encoder frozen; `steps` in whole rollouts, rounded up.

    A rollout in which the simulation breaks down is dropped. Raises `UnstableError` if too many are.
    """
    policy, breakdowns = PolicyModel(export_policy(ppo)), Breakdowns(world.id)
    observation = world.reset()
    for _ in range(-(-steps // (ppo.settings.steps * ppo.settings.columns))):
        rows: list[Arrays] = []
        while len(rows) < ppo.settings.steps:
            row, observation = transition(world, observation, encoder, policy, clock, rng, breakdowns)
            if row is None:
                rows.clear()
            else:
                rows.append(row)
        breakdowns.finish()
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
    breakdowns: Breakdowns,
) -> tuple[Arrays | None, NDArray[np.float32]]:
    """One step of all columns as PPO wants it, None if the simulation broke down, and what to go on from.

    A new goal cuts the episode off under the old one; the body stays where it is.
    """
    latent, goal = encoder.latent(observation), clock.goal
    action, log_prob = policy.act(latent, goal, rng)
    step = world.step(action)
    ended = step.terminated | step.truncated
    if step.failed is not None and step.failed.any():
        breakdowns.note(step.failed, segments=1)
        return None, world.restart(ended | step.failed)
    row: Arrays = {
        "latent": latent,
        "next_latent": encoder.latent(step.observation),
        "goal": goal,
        "action": action,
        "log_prob": log_prob,
        "truncated": clock.tick() | step.truncated,
        "terminated": step.terminated,
        "external_reward": step.external_reward,
    }
    return row, world.restart(ended) if ended.any() else step.observation
