"""The world as Stable-Baselines3's PPO needs it: observed as [z, g], rewarded for z near g (eq. 11, 12).

A goal switch is a truncation, and the point stays where it is.
"""

from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper

from babble.encoder.network import Encoder
from babble.policy.goals import GoalClock, reward
from babble.worlds.batch import World

Floats = NDArray[np.float32]
Stepped = tuple[Floats, Floats, NDArray[np.bool_], list[dict[str, Any]]]


class OneLatent(gymnasium.Wrapper):  # type: ignore[misc]
    """One copy of the world that encodes by itself."""

    def __init__(self, env: Any, encoder: Encoder, period_steps: int, seed: int) -> None:
        super().__init__(env)
        size = 2 * encoder.latent_dim
        self.observation_space = spaces.Box(0.0, 1.0, (size,), dtype=np.float32)
        self._encoder = encoder
        self._clock = GoalClock(1, encoder.latent_dim, period_steps, np.random.default_rng(seed))
        self._latent: Floats | None = None

    def reset(self, **given: Any) -> tuple[Floats, dict[str, Any]]:
        """Only the first one moves the point; later ones begin a new goal where it is."""
        if self._latent is None:
            self._latent = _encode(self._encoder, self.env.reset(**given)[0][None])[0]
        return np.concatenate([self._latent, self._clock.goal[0]]), {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Move, encode, reward; truncated where the goal changes."""
        self._latent = _encode(self._encoder, self.env.step(action)[0][None])[0]
        goal = self._clock.goal[0]
        switched = bool(self._clock.tick()[0])
        return np.concatenate([self._latent, goal]), float(reward(self._latent, goal)), False, switched, {}


class Latents(VecEnvWrapper):  # type: ignore[misc]
    """Copies of the world that are encoded together."""

    def __init__(self, venv: VecEnv, encoder: Encoder, period_steps: int) -> None:
        space = spaces.Box(0.0, 1.0, (2 * encoder.latent_dim,), dtype=np.float32)
        super().__init__(venv, observation_space=space)
        self._encoder = encoder
        rng = np.random.default_rng(0)
        self._clock = GoalClock(venv.num_envs, encoder.latent_dim, period_steps, rng)

    def reset(self) -> Floats:
        """[z, g] at the start."""
        return np.concatenate([_encode(self._encoder, self.venv.reset()), self._clock.goal], axis=1)

    def step_wait(self) -> Stepped:
        """[z, g], rewards, and where the goal changed a truncation."""
        observation, _, _, infos = self.venv.step_wait()
        latent, goal = _encode(self._encoder, observation), self._clock.goal
        switched = self._clock.tick()
        for i in np.flatnonzero(switched):
            ended = np.concatenate([latent[i], goal[i]])
            infos[i].update({"terminal_observation": ended, "TimeLimit.truncated": True})
        return np.concatenate([latent, self._clock.goal], axis=1), reward(latent, goal), switched, list(infos)


class BatchedWorld(VecEnv):  # type: ignore[misc]
    """Our batched world behind SB3's interface for many copies."""

    def __init__(self, world: World) -> None:
        self.render_mode = None
        self._world = world
        self._action = np.zeros((world.columns, world.action_size), np.float32)
        edge = np.full(world.observation_size, np.inf, np.float32)
        actions = spaces.Box(-1.0, 1.0, (world.action_size,), dtype=np.float32)
        super().__init__(world.columns, spaces.Box(-edge, edge), actions)

    def reset(self) -> Floats:
        """All copies at the centre."""
        return self._world.reset()

    def step_async(self, actions: Floats) -> None:
        """Remember the actions."""
        self._action = actions

    def step_wait(self) -> Stepped:
        """One step of all copies."""
        step = self._world.step(self._action)
        return step.observation, step.external_reward, step.terminated, [{} for _ in range(self.num_envs)]

    def close(self) -> None:
        """Nothing is held."""

    def get_attr(self, attr_name: str, indices: object = None) -> list[Any]:
        """One value for all copies."""
        return [getattr(self, attr_name)] * self.num_envs

    def set_attr(self, attr_name: str, value: object, indices: object = None) -> None:
        """Set it for all copies."""
        setattr(self, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: object = None, **given: Any) -> list[Any]:
        """No copy has methods of its own."""
        raise NotImplementedError(method_name)

    def env_is_wrapped(self, wrapper_class: object, indices: object = None) -> list[bool]:
        """Never."""
        return [False] * self.num_envs


def _encode(encoder: Encoder, observation: Floats) -> Floats:
    with torch.no_grad():
        return np.asarray(encoder(torch.from_numpy(observation)).numpy())
