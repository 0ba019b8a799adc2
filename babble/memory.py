"""The experience an encoder is fitted on, and the pairs close in time drawn from it (thesis 2.1.2)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from babble.observations import IMAGES, VECTORS, Floats, Layout, Parts, Senses

Array = NDArray[Any]
Indices = NDArray[np.int64]

EPISODES = "episode"
DTYPES = {VECTORS: np.float32, IMAGES: np.uint8, EPISODES: np.int32}
"""How each part is held: images stay bytes until a batch is drawn."""
AT_ONCE = 1 << 23
"""So many numbers are looked at together for the scaling: 64 MiB of float64."""
RESOLUTION = 1e-6
"""What varies by less than this share of its size is taken to be still; float32 rounds at 6e-8."""
LEAST_SPREAD = 1e-9
"""What varies by less than this is taken to be still too: about 0 a share of the size says nothing."""


class ExperienceMemory:
    """Streams of packed observations, one per (source, column), each in the order in which it was lived."""

    def __init__(self, senses: Senses) -> None:
        self.layout = Layout(senses)
        self.steps = 0
        """environment steps held, summed over all streams"""
        self._held: dict[str, dict[str, list[Array]]] = {}
        """By source and part: arrays (T, E, ...), one after the other in time."""
        self._flat: dict[str, Array] | None = None
        """Once settled, by part: all that is held (N, ...), each stream in one piece."""
        self._index: _PairIndex | None = None

    def extend(self, source: str, parts: Parts, episode: Array) -> None:
        """Append a source's next packed observations, (T, E, size) by part, with their episodes (T, E).

        Raises ValueError for parts that are not of these senses, shapes that do not fit what is held, or
        numbers that are not finite.
        """
        given = {**parts, EPISODES: episode}
        self._check(source, parts, episode)
        self._append(source, {part: np.array(array, DTYPES[part]) for part, array in given.items()})

    def sample_pairs(self, rng: np.random.Generator, batch: int, window_steps: int) -> tuple[Floats, Floats]:
        """`batch` anchors and positives, each (B, n), 1..window_steps apart in one episode of one stream.

        The offset is uniform over those that occur; the anchor is uniform over those that have it.
        Raises ValueError when no episode has two steps.
        """
        flat = self._settled()
        anchor, positive = self._pairs().sample(rng, batch, window_steps)
        return self._observations(flat, anchor), self._observations(flat, positive)

    @property
    def has_pairs(self) -> bool:
        """Whether any episode has two steps."""
        return self.steps > 0 and self._pairs().most > 0

    def scaling(self) -> tuple[Floats, Floats]:
        """Of all observations the mean (n,), and the scale (n,): one number for each sense, repeated.

        That is the square root of the mean variance of the sense's numbers, so that angles, velocities
        and images come in alike; 1 for a sense that was still. Raises ValueError when the memory is empty.
        """
        flat = self._settled()
        mean, scale = np.empty(self.layout.size, np.float32), np.empty(self.layout.size, np.float32)
        for name, place in self.layout.slices.items():
            part, within = self.layout.places[name]
            means, variances = _moments(flat[part][:, within])
            spread = np.sqrt(variances.mean())
            moved = spread > max(RESOLUTION * np.abs(means).max(), LEAST_SPREAD)
            mean[place], scale[place] = means, spread if moved else 1.0
        return mean, scale

    def clear(self) -> None:
        """Forget everything."""
        self._held.clear()
        self._flat = self._index = None
        self.steps = 0

    def state(self) -> dict[str, Array]:
        """Everything held, (T, E, ...), as arrays named "<part>/<source>"; views, to be stored at once."""
        if not self.steps:
            return {}
        self._settled()
        return {
            f"{part}/{source}": arrays[0]
            for source, held in self._held.items()
            for part, arrays in held.items()
        }

    def restore(self, state: Mapping[str, Array]) -> None:
        """Hold exactly what `state` gave; what was held is forgotten. Raises ValueError for other senses."""
        self.clear()
        by_source: dict[str, dict[str, Array]] = {}
        for key, array in state.items():
            part, _, source = key.partition("/")
            by_source.setdefault(source, {})[part] = array
        for source, held in by_source.items():
            episode = held.pop(EPISODES)
            self._check(source, held, episode)
            self._append(source, {**held, EPISODES: episode})

    def _append(self, source: str, arrays: Mapping[str, Array]) -> None:
        held = self._held.setdefault(source, {part: [] for part in (*self.layout.parts, EPISODES)})
        for part, array in arrays.items():
            held[part].append(array)
        self._flat = self._index = None
        self.steps += arrays[EPISODES].size

    def _check(self, source: str, parts: Parts, episode: Array) -> None:
        try:
            self.layout.check(parts)
        except ValueError as error:
            raise ValueError(f"experience of {source}: {error}") from None
        for part, array in parts.items():
            if episode.ndim != 2 or array.ndim != 3 or array.shape[:2] != episode.shape:
                got = f"{array.shape} and {episode.shape}"
                raise ValueError(f"{part} of {source} must be (T, E, n) with episodes (T, E), got {got}")
            if part == VECTORS and not np.isfinite(array).all():
                raise ValueError(f"{source} sent observations that are not finite numbers")
        held = self._held.get(source)
        if held and held[EPISODES][0].shape[1:] != episode.shape[1:]:
            before, now = held[EPISODES][0].shape[1], episode.shape[1]
            raise ValueError(f"{source} sent {before} columns before and now {now}")

    def _settled(self) -> dict[str, Array]:
        """All that is held by part (N, ...), each stream in one piece; what came in pieces is let go."""
        if not self.steps:
            raise ValueError("the experience memory is empty")
        if self._flat is None:
            self._flat = {part: self._joined(part, size) for part, size in self._part_shapes().items()}
        return self._flat

    def _joined(self, part: str, shape: tuple[int, ...]) -> Array:
        joined, start = np.empty((self.steps, *shape), DTYPES[part]), 0
        for held in self._held.values():
            pieces = held[part]
            columns, steps = pieces[0].shape[1], sum(map(len, pieces))
            stop = start + columns * steps
            lived = joined[start:stop].reshape(columns, steps, *shape).swapaxes(0, 1)
            at = 0
            while pieces:
                piece = pieces.pop(0)  # so that no more than one of them is held twice
                lived[at : at + len(piece)] = piece
                at += len(piece)
            pieces.append(lived)
            start = stop
        return joined

    def _pairs(self) -> "_PairIndex":
        flat = self._settled()
        if self._index is None:
            self._index = _PairIndex(self._episode_numbers(flat[EPISODES]))
        return self._index

    def _part_shapes(self) -> dict[str, tuple[int, ...]]:
        return {**{part: (size,) for part, size in self.layout.parts.items()}, EPISODES: ()}

    def _episode_numbers(self, episodes: Array) -> Indices:
        """A number (N,) that grows wherever the stream or, within it, the episode changes."""
        change = np.ones(len(episodes), np.int64)
        change[1:] = episodes[1:] != episodes[:-1]
        start = 0
        for held in self._held.values():
            steps, columns = held[EPISODES][0].shape
            change[start : start + steps * columns : steps] = 1
            start += steps * columns
        return change.cumsum()

    def _observations(self, flat: Mapping[str, Array], rows: Indices) -> Floats:
        return self.layout.unpack({part: flat[part][rows] for part in self.layout.parts})


def bytes_per_step(layout: Layout) -> int:
    """The memory that one environment step takes: the packed observation and its episode."""
    return layout.packed_bytes + np.dtype(DTYPES[EPISODES]).itemsize


def _moments(numbers: Array) -> tuple[Array, Array]:
    """The means and variances (n,) of the columns of (N, n), in float64, some columns at a time."""
    means, variances = np.empty(numbers.shape[1]), np.empty(numbers.shape[1])
    width = max(1, AT_ONCE // len(numbers))
    for start in range(0, numbers.shape[1], width):
        some = slice(start, start + width)
        exact = numbers[:, some].astype(np.float64)
        means[some], variances[some] = exact.mean(axis=0), exact.var(axis=0)
    return means, variances


class _PairIndex:
    """Anchors ordered by the steps that follow them in their episode: those with k or more come first."""

    def __init__(self, episodes: Indices) -> None:
        last = np.searchsorted(episodes, episodes, side="right") - 1
        room = last - np.arange(len(episodes))
        self._order = np.argsort(-room, kind="stable")
        self.most = int(room.max())
        """steps that two observations of one episode are apart at most"""
        self._anchors_with = np.searchsorted(-room[self._order], -np.arange(self.most + 1), side="right")

    def sample(self, rng: np.random.Generator, batch: int, window_steps: int) -> tuple[Indices, Indices]:
        """Where the anchors and the positives (B,) are."""
        if window_steps < 1 or batch < 1:
            raise ValueError(f"pairs need window_steps >= 1 and batch >= 1, got {window_steps} and {batch}")
        if not self.most:
            raise ValueError("no episode in the experience memory has two steps")
        offset = rng.integers(1, min(window_steps, self.most) + 1, batch)
        anchor = self._order[rng.integers(0, self._anchors_with[offset])]
        return anchor, anchor + offset
