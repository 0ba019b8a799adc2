"""Stable-Baselines3's PPO without an environment, a log or global random numbers."""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3 import PPO
from stable_baselines3.common.buffers import RolloutBuffer
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.type_aliases import RolloutBufferSamples
from torch import nn

from babble.policy.goals import RewardForm

ADAM_EPSILON = 1e-5


@dataclass(frozen=True, kw_only=True)
class PPOSettings:
    """PPO's settings, and the reward it is trained on."""

    hidden: Sequence[int] = (64, 64)
    """sizes of the tanh layers of each of the two networks"""
    learning_rate: float = 1e-3
    steps: int = 128
    columns: int = 16
    """a rollout is steps x columns"""
    epochs: int = 6
    minibatch: int = 512
    discount: float = 0.95
    gae_lambda: float = 0.95
    clip: float = 0.2
    entropy_weight: float = 0.0
    value_weight: float = 0.5
    max_grad_norm: float = 0.5
    log_std: float = 0.0
    """initial log standard deviation of the actions"""
    reward_form: RewardForm = "squared"
    sparse_radius: float = 0.1
    goal_weight: float = 1.0
    external_weight: float = 0.0
    """of the task's own reward beside the goal's; without it rollouts need no external_reward"""
    seed: int = 0


def build_ppo(latent_dim: int, action_size: int, settings: PPOSettings, rng: np.random.Generator) -> PPO:
    """PPO that sees [z, g] and acts in [-1, 1]^a; `rng` draws minibatches, `settings.seed` first weights.

    Its environment is never made: the spaces are set where SB3 sets them when it loads a model.
    """
    ppo = PPO(
        "MlpPolicy",
        None,
        learning_rate=settings.learning_rate,
        n_steps=settings.steps,
        batch_size=settings.minibatch,
        n_epochs=settings.epochs,
        gamma=settings.discount,
        gae_lambda=settings.gae_lambda,
        clip_range=settings.clip,
        ent_coef=settings.entropy_weight,
        vf_coef=settings.value_weight,
        max_grad_norm=settings.max_grad_norm,
        rollout_buffer_class=SeededRolloutBuffer,
        rollout_buffer_kwargs={"rng": rng},
        policy_kwargs=_networks(settings),
        device="cpu",
        _init_setup_model=False,
    )
    ppo.observation_space = spaces.Box(-np.inf, np.inf, (2 * latent_dim,), dtype=np.float32)
    ppo.action_space = spaces.Box(-1.0, 1.0, (action_size,), dtype=np.float32)
    ppo.n_envs = settings.columns
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(settings.seed)
        ppo._setup_model()
    ppo.set_logger(Logger(folder=None, output_formats=[]))
    return ppo


class SeededRolloutBuffer(RolloutBuffer):
    """SB3's rollout buffer, which draws its minibatches from `rng` instead of NumPy's global generator."""

    generator_ready: bool

    def __init__(self, *args: Any, rng: np.random.Generator, **kwargs: Any) -> None:
        self._rng = rng
        super().__init__(*args, **kwargs)

    def get(self, batch_size: int | None = None) -> Generator[RolloutBufferSamples, None, None]:
        """All samples once, in random order, `batch_size` at a time."""
        if not self.generator_ready:
            for name in ("observations", "actions", "values", "log_probs", "advantages", "returns"):
                setattr(self, name, self.swap_and_flatten(getattr(self, name)))
            self.generator_ready = True
        order = self._rng.permutation(self.buffer_size * self.n_envs)
        size = batch_size or len(order)
        for start in range(0, len(order), size):
            yield self._get_samples(order[start : start + size])


def _networks(settings: PPOSettings) -> dict[str, Any]:
    return {
        "net_arch": {"pi": list(settings.hidden), "vf": list(settings.hidden)},
        "activation_fn": nn.Tanh,
        "log_std_init": settings.log_std,
        "optimizer_kwargs": {"eps": ADAM_EPSILON},
    }
