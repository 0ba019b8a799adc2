"""The Stable-Baselines3 seam: SB3's PPO, fed with rollouts that others collected.

SB3 builds the networks and does the whole update (`train()`); what replaces its own collecting is
`GoalPPO.update`. Each column of a rollout is a segment of one world with its own bootstrap value;
columns need not follow one another in time.
"""

import copy
from collections.abc import Mapping
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import nn

from babble import rng_state
from babble.onnx_model import Layer, PolicyWeights
from babble.policy.goals import reward, weighted
from babble.policy.sb3 import ADAM_EPSILON, PPOSettings, build_ppo

Floats = NDArray[np.float32]
Rollout = Mapping[str, NDArray[Any]]

METRICS = {
    "loss": "train/loss",
    "policy_loss": "train/policy_gradient_loss",
    "value_loss": "train/value_loss",
    "approx_kl": "train/approx_kl",
    "clip_fraction": "train/clip_fraction",
    "explained_variance": "train/explained_variance",
    "std": "train/std",
}
"""Our names of SB3's log values."""


class GoalPPO:
    """A policy over actions in [-1, 1]^a that sees [z, g] (eq. 11), trained on whole rollouts.

    Two separate tanh networks and a log deviation that no state changes. Keywords are the fields of
    `PPOSettings`. Sets torch to one thread; uses no global random numbers.
    """

    def __init__(self, latent_dim: int, action_size: int, **settings: Any) -> None:
        torch.set_num_threads(1)
        self.latent_dim = latent_dim
        self.action_size = action_size
        self.settings = PPOSettings(**settings)
        self.steps = self.settings.steps
        self.columns = self.settings.columns
        self.updates = 0
        """rollouts trained on so far"""
        self._rng = np.random.default_rng(self.settings.seed)
        self._ppo = build_ppo(latent_dim, action_size, self.settings, self._rng)

    def update(self, rollout: Rollout) -> dict[str, float]:
        """Train on one rollout of (T, M, ...) arrays; returns the metrics, 0 for one that is undefined.

        Keys: latent, next_latent, goal (T, M, d), action (T, M, a), log_prob (T, M) of the policy
        that acted, truncated and terminated (T, M), and external_reward (T, M) if it has a weight. A
        truncated step is bootstrapped with the value of [next_latent, goal], the goal being the old one.
        Raises ValueError for arrays that do not fit.
        """
        self._check(rollout)
        rewards = self._rewards(rollout)
        self._fill(rollout, rewards)
        self._ppo.train()
        self.updates += 1
        log = dict(self._ppo.logger.name_to_value)
        self._ppo.logger.name_to_value.clear()
        metrics = {name: float(log[key]) for name, key in METRICS.items()}
        metrics["entropy"] = -float(log["train/entropy_loss"])
        metrics["reward_mean"] = float(rewards.mean())
        if self.settings.external_weight:
            metrics["external_reward_mean"] = float(rollout["external_reward"].mean())
        return {name: value if np.isfinite(value) else 0.0 for name, value in metrics.items()}

    def value(self, z: NDArray[Any], g: NDArray[Any]) -> Floats:
        """The critic's value (...) of [z, g], both (..., d)."""
        pairs = torch.from_numpy(_beside(z, g))
        with torch.no_grad():
            values = self._ppo.policy.predict_values(pairs.reshape(-1, 2 * self.latent_dim))
        return np.asarray(values.numpy().reshape(pairs.shape[:-1]))

    def distribution(self, z: NDArray[Any], g: NDArray[Any]) -> tuple[Floats, Floats]:
        """The mean (B, a) and log deviation (a,) of the action; the exported model must give the same."""
        with torch.no_grad():
            features = self._ppo.policy.mlp_extractor.forward_actor(torch.from_numpy(_beside(z, g)))
            mean = self._ppo.policy.action_net(features)
        return mean.numpy(), self._log_std()

    def reset_optimiser(self) -> None:
        """Forget the optimiser's moments, keep the weights (start of each PRACTISE)."""
        policy = self._ppo.policy
        policy.optimizer = torch.optim.Adam(
            policy.parameters(), lr=self.settings.learning_rate, eps=ADAM_EPSILON
        )

    def export_weights(self) -> PolicyWeights:
        """The acting part as plain arrays (copies)."""
        policy = self._ppo.policy
        linears = [part for part in policy.mlp_extractor.policy_net if isinstance(part, nn.Linear)]
        layers = [
            Layer(linear.weight.detach().numpy().copy(), linear.bias.detach().numpy().copy())
            for linear in (*linears, policy.action_net)
        ]
        return PolicyWeights(self.latent_dim, layers, self._log_std())

    def state(self) -> dict[str, Any]:
        """Everything: policy, optimiser, random numbers, count; for torch.load(weights_only=True)."""
        return copy.deepcopy(
            {
                "policy": dict(self._ppo.policy.state_dict()),
                "optimiser": self._ppo.policy.optimizer.state_dict(),
                "rng": rng_state.dump(self._rng),
                "updates": self.updates,
            }
        )

    def restore(self, state: dict[str, Any]) -> None:
        """Go on exactly where `state` was taken. Raises RuntimeError for another network's weights."""
        self._ppo.policy.load_state_dict(state["policy"])
        self.reset_optimiser()
        self._ppo.policy.optimizer.load_state_dict(state["optimiser"])
        rng_state.load(self._rng, state["rng"])
        self.updates = state["updates"]

    def _rewards(self, rollout: Rollout) -> Floats:
        settings = self.settings
        goal = reward(rollout["next_latent"], rollout["goal"], settings.reward_form, settings.sparse_radius)
        external = rollout["external_reward"] if settings.external_weight else None
        return weighted(goal, external, settings.goal_weight, settings.external_weight)

    def _fill(self, rollout: Rollout, rewards: Floats) -> None:
        """SB3's rollout buffer from the arrays, with advantages."""
        terminated = rollout["terminated"].astype(bool)
        truncated = rollout["truncated"].astype(bool) & ~terminated
        done = terminated | truncated
        after = self.value(rollout["next_latent"], rollout["goal"])
        rewards = rewards + np.where(truncated, np.float32(self.settings.discount) * after, np.float32(0))
        values = torch.from_numpy(self.value(rollout["latent"], rollout["goal"]))
        log_probs = torch.from_numpy(np.array(rollout["log_prob"], dtype=np.float32))
        seen = _beside(rollout["latent"], rollout["goal"])
        starts = np.ones(done.shape, dtype=np.float32)
        starts[1:] = done[:-1]
        buffer = self._ppo.rollout_buffer
        buffer.reset()
        for t in range(len(done)):
            buffer.add(seen[t], rollout["action"][t], rewards[t], starts[t], values[t], log_probs[t])
        buffer.compute_returns_and_advantage(torch.from_numpy(after[-1]), done[-1])

    def _check(self, rollout: Rollout) -> None:
        frame = (self.settings.steps, self.settings.columns)
        shapes = dict.fromkeys(("latent", "next_latent", "goal"), (*frame, self.latent_dim))
        shapes["action"] = (*frame, self.action_size)
        external = ("external_reward",) if self.settings.external_weight else ()
        for name in (*shapes, "log_prob", "truncated", "terminated", *external):
            shape = shapes.get(name, frame)
            if name not in rollout:
                raise ValueError(f"the rollout has no {name}")
            if rollout[name].shape != shape or not np.isfinite(rollout[name]).all():
                raise ValueError(
                    f"{name} must be finite numbers of shape {shape}, got shape {rollout[name].shape}"
                )

    def _log_std(self) -> Floats:
        return np.array(self._ppo.policy.log_std.detach().numpy())


def _beside(z: NDArray[Any], g: NDArray[Any]) -> Floats:
    return np.concatenate([z, g], axis=-1, dtype=np.float32)
