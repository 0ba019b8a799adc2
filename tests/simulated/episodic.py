"""A world whose episodes end and whose simulation may break down, for tests; see `Episodic`."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from babble.landmarks import Landmark
from babble.worlds.batch import Flags, Floats, Start, Step

SPEED = 0.1


class EpisodicWorld:
    """Points on a line from -1 to 1; an observation is [place, age / 100]. Implements `World`."""

    id = "Episodic"
    observation_size = 2
    observation_names = ("place/x", "age/steps")
    action_size = 1
    action_names = ("x",)
    posture_size = 1
    moves = ((0,),)
    diameter = 2.0
    crossing_axis = None
    posture_names: tuple[str, ...] = ()
    state_names = ("position/x", "age/steps")
    rewarded = True
    senses: Mapping[str, tuple[int, ...]] = {"place": (1,), "age": (1,)}
    landmarks = (Landmark("left", ((0,),), -1.0, -0.8), Landmark("right", ((0,),), 0.8, 1.0))

    def __init__(self, columns: int, rng: np.random.Generator, **parameters: Any) -> None:
        self.columns = columns
        self.parameters = Episodic.defaults() | parameters
        self.steps = 0
        self.restarted: list[np.ndarray] = []
        """the flags of each restart"""
        self._rng = rng
        self._place = np.zeros(columns)
        self._age = np.zeros(columns, np.int64)

    def reset(self, start: Start = "centre") -> Floats:
        self._place = self._rng.uniform(-1, 1, self.columns) * (start == "random")
        self._age[:] = 0
        return self._observation()

    def step(self, action: Floats) -> Step:
        assert np.isfinite(action).all()
        self.steps += 1
        self._age += 1
        self._place = np.clip(self._place + SPEED * np.clip(action[:, 0], -1, 1), -1, 1)
        known = self.parameters
        terminated = np.abs(self._place) >= known["ends_at"]
        truncated = (
            self._age % known["limit_steps"] == 0 if known["limit_steps"] else np.zeros_like(terminated)
        )
        observation, reward = self._observation(), self._place.astype(np.float32)
        failed = np.zeros_like(terminated)
        if known["fails_every"] and self.steps % known["fails_every"] == 0:
            failed[0] = True
            observation[0], reward[0], self._place[0] = np.nan, np.nan, np.nan
        return Step(observation, terminated, truncated & ~terminated, reward, failed)

    def restart(self, columns: Flags) -> Floats:
        self.restarted.append(columns.copy())
        self._place[columns], self._age[columns] = 0.0, 0
        return self._observation()

    def span(self, components: Sequence[int]) -> float:
        return 2.0 * len(components)

    def posture(self) -> Floats:
        return self._place[:, None].astype(np.float32)

    def side(self) -> Floats | None:
        return None

    def state(self) -> Floats:
        """The place, and the age in steps."""
        return np.stack([self._place, self._age], axis=1).astype(np.float32)

    def _observation(self) -> Floats:
        return np.stack([self._place, self._age / 100], axis=1).astype(np.float32)


class Episodic:
    """Its entry in the registry of worlds."""

    def __init__(self, **parameters: Any) -> None:
        self.parameters = parameters

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """An episode is cut off after `limit_steps` and ends for good beyond `ends_at`.

        Column 0 breaks down at each `fails_every`-th step of the world. 0 stands for never.
        """
        return {"limit_steps": 0, "ends_at": 2.0, "fails_every": 0}

    def world(self, columns: int, rng: np.random.Generator) -> EpisodicWorld:
        return EpisodicWorld(columns, rng, **self.parameters)
