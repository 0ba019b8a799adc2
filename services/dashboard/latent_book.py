"""What was heard of the latents of one block: the newest of each actor, and a cloud of recent ones (pure)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from protocol.messages import View

Floats = NDArray[np.float32]

CLOUD_POINTS = 1500
CLOUD_SECS = 30.0
"""The cloud is filled anew in about so long, whatever actors send."""
FIRST_POINTS = 400
"""So many are taken at once at the beginning, so that there is something to see."""
STALE_SECS = 5.0
"""Who has sent no latents for so long is not acting; nothing of it is drawn."""


@dataclass(frozen=True)
class Newest:
    """The last that an actor sent of the block; all numbers are finite."""

    label: str
    heard_secs: float
    latent: Floats
    """(E, d)"""
    goal: Floats | None
    """(E, d)"""
    trail: Floats
    """(K, d) the way of the first column, the newest last; K = 0 if unknown"""

    @property
    def distances(self) -> Floats:
        """(E,) the squared distances |g - z|^2 (eq. 12); (0,) without goals."""
        if self.goal is None:
            return np.zeros(0, np.float32)
        return np.asarray(((self.goal - self.latent) ** 2).sum(axis=1), np.float32)


class LatentBook:
    """One block's latents."""

    def __init__(self, block: str, latent_dim: int, seed: int = 0) -> None:
        self.block = block
        self.latent_dim = latent_dim
        self.changes = 0
        """Grows with what is heard."""
        self._newest: dict[str, Newest] = {}
        self._rng = np.random.default_rng(seed)
        self._cloud = np.zeros((CLOUD_POINTS, latent_dim), np.float32)
        self._taken = 0
        self._room = float(FIRST_POINTS)
        self._filled_secs: float | None = None

    @property
    def cloud(self) -> Floats:
        """(n, d) recent latents of all actors, n <= CLOUD_POINTS; each in its place until replaced."""
        return self._cloud[: min(self._taken, CLOUD_POINTS)]

    def hear(self, label: str, view: View, now_secs: float) -> None:
        """Take a latent view of an actor. Raises ValueError if its d is not the block's."""
        arrays = {name: np.asarray(array, np.float32) for name, array in view.arrays.items()}
        latent, goal = arrays["latent"], arrays.get("goal")
        if latent.shape[1] != self.latent_dim:
            raise ValueError(
                f"{view.life} sent latents of {latent.shape[1]} numbers of block {self.block!r}, which has "
                f"{self.latent_dim} vertices; start all processes with the same scenario"
            )
        usable = np.isfinite(latent).all(axis=1)
        if goal is not None:
            usable &= np.isfinite(goal).all(axis=1)
            goal = goal[usable]
        trail = arrays.get("trail", latent[:0])
        trail = trail[np.isfinite(trail).all(axis=1)]
        if not usable.any():
            return
        self._newest[label] = Newest(label, now_secs, latent[usable], goal, trail)
        self._sample(latent[usable], now_secs)
        self.changes += 1

    def forget(self, label: str) -> None:
        """The actor is gone."""
        if self._newest.pop(label, None) is not None:
            self.changes += 1

    def acting(self, now_secs: float) -> list[Newest]:
        """The actors that act now, by label."""
        old = [label for label, newest in self._newest.items() if now_secs - newest.heard_secs > STALE_SECS]
        for label in old:
            self.forget(label)
        return [self._newest[label] for label in sorted(self._newest, key=label_order)]

    def _sample(self, latents: Floats, now_secs: float) -> None:
        if self._filled_secs is not None:
            grown = (now_secs - self._filled_secs) * CLOUD_POINTS / CLOUD_SECS
            self._room = min(self._room + grown, float(FIRST_POINTS))
        self._filled_secs = now_secs
        count = min(len(latents), int(self._room))
        if count == 0:
            return
        self._room -= count
        chosen = latents[self._rng.permutation(len(latents))[:count]]
        self._cloud[np.arange(self._taken, self._taken + count) % CLOUD_POINTS] = chosen
        self._taken += count


def label_order(label: str) -> tuple[int, str]:
    """Sorts a2 before a10."""
    return len(label), label
