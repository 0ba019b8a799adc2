"""From segments to rollouts of PPO: columns in hand, the too old dropped and counted (pure)."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Columns = Mapping[str, NDArray[np.generic]]


@dataclass(frozen=True)
class _Held:
    policy_version: int
    columns: dict[str, NDArray[np.generic]]


class RolloutHand:
    """Columns in hand, oldest first. Arrays are (T, E, ...); a rollout is (T, M, ...)."""

    def __init__(self, rollout_columns: int, max_policy_lag: int) -> None:
        self._rollout_columns = rollout_columns
        self._max_policy_lag = max_policy_lag
        self._held: deque[_Held] = deque()
        self.too_old = 0
        """Columns dropped because their policy was more than `max_policy_lag` versions old."""

    @property
    def columns(self) -> int:
        """Columns in hand."""
        return len(self._held)

    def add(self, arrays: Columns, policy_version: int) -> None:
        """Take the columns of a segment."""
        for column in range(next(iter(arrays.values())).shape[1]):
            mine = {name: np.array(array[:, column]) for name, array in arrays.items()}
            self._held.append(_Held(policy_version, mine))

    def drop_older_than(self, policy_version: int) -> None:
        """Drop what is too old for a learner at this version."""
        kept = [h for h in self._held if policy_version - h.policy_version <= self._max_policy_lag]
        self.too_old += len(self._held) - len(kept)
        self._held = deque(kept)

    def rollout(self) -> tuple[dict[str, NDArray[np.generic]], list[int]] | None:
        """The next rollout and the policy version of each of its columns; None if too few are in hand."""
        if len(self._held) < self._rollout_columns:
            return None
        chosen = [self._held.popleft() for _ in range(self._rollout_columns)]
        names = chosen[0].columns
        stacked = {name: np.stack([c.columns[name] for c in chosen], axis=1) for name in names}
        return stacked, [c.policy_version for c in chosen]

    def clear(self) -> None:
        """Let go of everything."""
        self._held.clear()

    def state(self) -> list[tuple[int, dict[str, NDArray[np.generic]]]]:
        """What is in hand, oldest first."""
        return [(held.policy_version, held.columns) for held in self._held]

    def restore(self, state: list[tuple[int, dict[str, NDArray[np.generic]]]]) -> None:
        """Hold what `state()` described."""
        self._held = deque(_Held(version, dict(columns)) for version, columns in state)
