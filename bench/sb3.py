"""Stable-Baselines3's PPO as its users run it, on the same world, goals, reward and network sizes.

`one_by_one` wraps each copy of the world, `together` encodes all copies in one call, `batched` puts
our batched world in place of a list of copies, which isolates what the world's batching gives.
"""

from collections.abc import Callable, Sequence
from typing import Any

from stable_baselines3 import PPO
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv
from torch import nn

from babble.worlds import WORLDS
from bench.sb3_worlds import BatchedWorld, Latents, OneLatent
from bench.scene import encoder_of, world_of
from services.runtime.settings import RunSettings


def copies(settings: RunSettings, columns: int) -> Sequence[Callable[[], Any]]:
    """Makers of single copies of the world, without any of Gymnasium's or SB3's optional wrappers."""
    shape, parameters = WORLDS[settings.world.id].shape, settings.world.parameters
    return [lambda: shape(**parameters)] * columns


def one_by_one(settings: RunSettings, columns: int) -> VecEnv:
    """Each copy encodes by itself."""
    encoder, period = encoder_of(settings), settings.goals.period_steps
    makers = copies(settings, columns)
    return DummyVecEnv(
        [lambda make=make, seed=i: OneLatent(make(), encoder, period, seed) for i, make in enumerate(makers)]
    )


def together(settings: RunSettings, columns: int) -> VecEnv:
    """A list of copies, encoded together."""
    return Latents(DummyVecEnv(copies(settings, columns)), encoder_of(settings), settings.goals.period_steps)


def batched(settings: RunSettings, columns: int) -> VecEnv:
    """Our batched world, encoded together."""
    world = BatchedWorld(world_of(settings, columns))
    return Latents(world, encoder_of(settings), settings.goals.period_steps)


def ppo_of(settings: RunSettings, envs: VecEnv, rollout_steps: int) -> PPO:
    """PPO with the run's settings, SB3's own optimiser, no log."""
    policy = settings.policy
    ppo = PPO(
        "MlpPolicy",
        envs,
        learning_rate=policy.learning_rate,
        n_steps=rollout_steps,
        batch_size=policy.minibatch,
        n_epochs=policy.epochs,
        gamma=policy.discount,
        gae_lambda=policy.gae_lambda,
        clip_range=policy.clip,
        ent_coef=policy.entropy_weight,
        vf_coef=policy.value_weight,
        max_grad_norm=policy.max_grad_norm,
        policy_kwargs={
            "net_arch": {"pi": list(policy.hidden), "vf": list(policy.hidden)},
            "activation_fn": nn.Tanh,
            "log_std_init": policy.log_std,
        },
        device="cpu",
        seed=settings.seed,
    )
    ppo.set_logger(Logger(folder=None, output_formats=[]))
    return ppo
