"""The experience an encoder is fitted on, and the pairs close in time drawn from it (thesis 2.1.2)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Indices = NDArray[np.int64]


class ExperienceMemory:
    """Streams of observations, one per (source, column), each in the order in which it was lived."""

    def __init__(self) -> None:
        self._observations: dict[str, list[Floats]] = {}
        self._episodes: dict[str, list[NDArray[np.int32]]] = {}
        self._index: _PairIndex | None = None
        self.steps = 0
        """environment steps held, summed over all streams"""

    def extend(self, source: str, observation: NDArray[Any], episode: NDArray[Any]) -> None:
        """Append the next (T, E, n) observations of a source, with the episode numbers (T, E) they belong to.

        Raises ValueError for shapes that do not fit what is held, or numbers that are not finite.
        """
        if observation.ndim != 3 or episode.shape != observation.shape[:2]:
            got = f"{observation.shape} and {episode.shape}"
            raise ValueError(f"experience must be (T, E, n) with episodes (T, E), got {got}")
        held = self._observations.get(source)
        if held and held[0].shape[1:] != observation.shape[1:]:
            raise ValueError(
                f"{source} sent (columns, size) {held[0].shape[1:]} before and now {observation.shape[1:]}"
            )
        others = next(iter(self._observations.values()), None)
        if others and others[0].shape[2] != observation.shape[2]:
            raise ValueError(
                f"observations of size {others[0].shape[2]} are held, {source} sent {observation.shape[2]}"
            )
        if not np.isfinite(observation).all():
            raise ValueError(f"{source} sent observations that are not finite numbers")
        self._observations.setdefault(source, []).append(np.array(observation, dtype=np.float32))
        self._episodes.setdefault(source, []).append(np.array(episode, dtype=np.int32))
        self._index = None
        self.steps += episode.size

    def sample_pairs(self, rng: np.random.Generator, batch: int, window_steps: int) -> tuple[Floats, Floats]:
        """`batch` anchors and positives, each (B, n), 1..window_steps apart in one episode of one stream.

        The offset is uniform over those that occur; the anchor is uniform over those that have it.
        Raises ValueError when no episode has two steps.
        """
        if self._index is None:
            self._index = _PairIndex(*self._flat())
        return self._index.sample(rng, batch, window_steps)

    def scaling(self) -> tuple[Floats, float]:
        """The mean (n,) of all observations, and one scale: sqrt of the mean variance, 1 if nothing varied.

        Raises ValueError when the memory is empty.
        """
        flat = self._flat()[0].astype(np.float64)
        scale = float(np.sqrt(flat.var(axis=0).mean()))
        return flat.mean(axis=0).astype(np.float32), scale if scale > 0 else 1.0

    def clear(self) -> None:
        """Forget everything."""
        self._observations.clear()
        self._episodes.clear()
        self._index = None
        self.steps = 0

    def state(self) -> dict[str, NDArray[Any]]:
        """Everything held, as arrays named "observation/<source>" and "episode/<source>"."""
        return {
            **{
                f"observation/{source}": np.concatenate(parts) for source, parts in self._observations.items()
            },
            **{f"episode/{source}": np.concatenate(parts) for source, parts in self._episodes.items()},
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Hold exactly what `state` gave; what was held is forgotten."""
        self.clear()
        for key, observation in state.items():
            part, _, source = key.partition("/")
            if part == "observation":
                self.extend(source, observation, state[f"episode/{source}"])

    def _flat(self) -> tuple[Floats, Indices]:
        """All observations (N, n), each stream in one piece, and the episode number (N,) of each.

        A new number begins wherever the stream or, within it, the episode changes.
        """
        if not self._observations:
            raise ValueError("the experience memory is empty")
        observations, changes = [], []
        for source, parts in self._observations.items():
            lived = np.concatenate(parts)
            episode = np.concatenate(self._episodes[source])
            change = np.ones(episode.shape, dtype=np.int64)
            change[1:] = episode[1:] != episode[:-1]
            observations.append(lived.swapaxes(0, 1).reshape(-1, lived.shape[2]))
            changes.append(change.T.reshape(-1))
        return np.concatenate(observations), np.concatenate(changes).cumsum()


class _PairIndex:
    """Anchors ordered by the steps that follow them in their episode: those with k or more come first."""

    def __init__(self, observations: Floats, episodes: Indices) -> None:
        last = np.searchsorted(episodes, episodes, side="right") - 1
        room = last - np.arange(len(episodes))
        self._observations = observations
        self._order = np.argsort(-room, kind="stable")
        self._most = int(room.max())
        self._anchors_with = np.searchsorted(-room[self._order], -np.arange(self._most + 1), side="right")

    def sample(self, rng: np.random.Generator, batch: int, window_steps: int) -> tuple[Floats, Floats]:
        if window_steps < 1 or batch < 1:
            raise ValueError(f"pairs need window_steps >= 1 and batch >= 1, got {window_steps} and {batch}")
        if not self._most:
            raise ValueError("no episode in the experience memory has two steps")
        offset = rng.integers(1, min(window_steps, self._most) + 1, batch)
        anchor = self._order[rng.integers(0, self._anchors_with[offset])]
        return self._observations[anchor], self._observations[anchor + offset]
