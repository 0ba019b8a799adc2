"""Goals (thesis 3.1, 3.2): vertices or random points, when they change, and the reward for nearing them."""

from collections.abc import Sequence
from typing import Any, Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
RewardForm = Literal["squared", "dense", "sparse"]


def one_hot(index: ArrayLike, d: int) -> Floats:
    """Vertices (..., d) of the simplex by their indices (...)."""
    return np.asarray(np.eye(d, dtype=np.float32)[np.asarray(index)])


def reward(
    z: NDArray[Any], g: NDArray[Any], form: RewardForm = "squared", sparse_radius: float = 0.1
) -> Floats:
    """The reward (...) of being at z (..., d) with goal g (..., d).

    squared: -||g - z||^2 (eq. 12); dense: -||g - z|| (eq. 9); sparse: 0 within `sparse_radius`,
    else -1 (eq. 8). Raises ValueError for another form.
    """
    squared = np.square(g - z, dtype=np.float32).sum(axis=-1)
    match form:
        case "squared":
            return np.asarray(-squared)
        case "dense":
            return np.asarray(-np.sqrt(squared))
        case "sparse":
            return np.where(np.sqrt(squared) <= sparse_radius, 0.0, -1.0).astype(np.float32)
        case _:
            raise ValueError(f"there is no reward form {form!r}; choose squared, dense or sparse")


def weighted(
    goal_reward: Floats, external_reward: Floats | None, goal_weight: float, external_weight: float
) -> Floats:
    """What the policy is trained on (...): the goal's reward, and the task's own where it has a weight.

    The task's reward is eq. 1 for standing up; the thesis combines the two in no equation, so it is
    their weighted sum.
    """
    rewards = np.float32(goal_weight) * goal_reward
    if external_reward is not None:
        rewards = rewards + np.float32(external_weight) * external_reward
    return np.asarray(rewards, np.float32)


class Clock(Protocol):
    """Each column's goal, step by step."""

    goal: Floats
    """(E, d) the goals of the moment; another array once one of them changes"""

    def tick(self, ended: Flags | None = None) -> Flags:
        """Count one step; returns (E,) which columns drew a new goal just now.

        `ended` (E,) are the columns whose episode ended with this step; None for none.
        """
        ...


class _Clock:
    """Each column's vertex and the steps it still holds, whatever becomes of its episode."""

    def __init__(self, columns: int, latent_dim: int, period_steps: int, rng: np.random.Generator) -> None:
        if columns < 1 or latent_dim < 2 or period_steps < 1:
            raise ValueError(
                "goals need columns >= 1, latent_dim >= 2 and a period >= 1 step, "
                f"got {columns}, {latent_dim} and {period_steps}"
            )
        self.latent_dim = latent_dim
        self._period_steps = period_steps
        self._rng = rng
        self._left = np.full(columns, period_steps)
        self.index = rng.integers(0, latent_dim, columns)
        """(E,) the vertex each column aims at"""
        self.goal = one_hot(self.index, latent_dim)
        """(E, d) the vertices as one-hot rows; another array once one of them changes"""

    def tick(self, ended: Flags | None = None) -> Flags:
        """See `Clock.tick`; an episode's end changes nothing."""
        self._left -= 1
        due = np.asarray(self._left == 0)
        if due.any():
            self._left[due] = self._period_steps
            self.index = np.where(due, self._next(), self.index)
            self.goal = one_hot(self.index, self.latent_dim)
        return due

    def _next(self) -> NDArray[np.int64]:
        raise NotImplementedError


class GoalClock(_Clock):
    """Goals of GROUND and PRACTISE: uniform, redrawn every `period_steps`, the columns out of phase."""

    def __init__(self, columns: int, latent_dim: int, period_steps: int, rng: np.random.Generator) -> None:
        super().__init__(columns, latent_dim, period_steps, rng)
        self._left = rng.integers(1, period_steps + 1, columns)

    def _next(self) -> NDArray[np.int64]:
        return self._rng.integers(0, self.latent_dim, len(self.index))


class PointClock:
    """Goals that are points drawn uniformly from the simplex, Dirichlet(1, ..., 1), in each column apart.

    For the condition without one-hot goals (thesis 4.5, C4). A goal holds for an episode of its column. Where
    the world has no episodes it holds for `period_steps`, the columns out of phase.
    """

    def __init__(
        self, columns: int, latent_dim: int, period_steps: int | None, rng: np.random.Generator
    ) -> None:
        """`period_steps` is None for goals that only the end of an episode changes."""
        if columns < 1 or latent_dim < 2 or (period_steps is not None and period_steps < 1):
            raise ValueError(
                "goals need columns >= 1, latent_dim >= 2 and a period >= 1 step or none, "
                f"got {columns}, {latent_dim} and {period_steps}"
            )
        self.latent_dim = latent_dim
        self._period_steps = period_steps
        self._rng = rng
        self._left = rng.integers(1, (period_steps or 1) + 1, columns)
        self.goal = self._points(columns)
        """(E, d) the points; another array once one of them changes"""

    def tick(self, ended: Flags | None = None) -> Flags:
        """See `Clock.tick`."""
        due = np.zeros(len(self.goal), bool) if ended is None else np.array(ended, bool)
        if self._period_steps is not None:
            self._left -= 1
            due |= self._left == 0
            self._left[due] = self._period_steps
        if due.any():
            self.goal = self.goal.copy()
            self.goal[due] = self._points(int(due.sum()))
        return due

    def _points(self, count: int) -> Floats:
        return self._rng.dirichlet(np.ones(self.latent_dim), count).astype(np.float32)


class RandomGoals:
    """Goals of children that babble for the block above them (thesis 3.5.1): random, held, unsynchronised.

    Each child draws a vertex of its own and a time to hold it, uniform from `least_steps` to `most_steps`
    environment steps, in each column apart.
    """

    def __init__(
        self,
        latent_dims: Sequence[int],
        columns: int,
        rng: np.random.Generator,
        *,
        least_steps: int,
        most_steps: int,
        env_steps: int = 1,
    ) -> None:
        """`latent_dims` of the children; `env_steps` pass from one sample to the next."""
        if not latent_dims or not 1 <= least_steps <= most_steps or env_steps < 1:
            raise ValueError(
                "random goals need children and 1 <= least_steps <= most_steps, "
                f"got {list(latent_dims)}, {least_steps} and {most_steps}"
            )
        self._dims = np.asarray(latent_dims)
        self._starts = np.cumsum(self._dims) - self._dims
        self._rng = rng
        self._bounds = least_steps, most_steps
        self._env_steps = env_steps
        self._index = rng.integers(0, self._dims, (columns, len(self._dims)))
        # They begin in the middle of their times, or all would first change together.
        self._left = rng.integers(1, most_steps + 1, self._index.shape)

    def sample(self) -> Floats:
        """(E, sum of latent_dims): the goals of all children as one-hot vectors, one after the other."""
        goals = np.zeros((len(self._index), int(self._dims.sum())), np.float32)
        np.put_along_axis(goals, self._starts + self._index, 1.0, axis=1)
        self._left -= self._env_steps
        due = self._left <= 0
        least, most = self._bounds
        self._left = np.where(due, self._rng.integers(least, most + 1, due.shape), self._left)
        self._index = np.where(due, self._rng.integers(0, self._dims, due.shape), self._index)
        return goals


class WalkClock(_Clock):
    """Goals of WALK and EVALUATE: a fixed number of steps each, and the next is always another vertex."""

    def _next(self) -> NDArray[np.int64]:
        jump = self._rng.integers(1, self.latent_dim, len(self.index))
        return (self.index + jump) % self.latent_dim
