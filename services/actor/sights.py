"""What is kept of acting for people to see: when a picture is due, and the way of a column (pure)."""

import math
from collections import deque
from collections.abc import Mapping

import numpy as np

from babble.legs import Seen
from babble.policy.act import Floats


class Pace:
    """When the next picture is due, at a steady rate; what was missed is not made up for."""

    def __init__(self, per_sec: float) -> None:
        """`per_sec` is 0 for never."""
        self._interval_secs = 1 / per_sec if per_sec else math.inf
        self.due_secs = 0.0 if per_sec else math.inf
        """The moment at which it is wanted."""

    def due(self, now_secs: float) -> bool:
        """True from that moment on."""
        return now_secs >= self.due_secs

    def done(self, now_secs: float) -> None:
        """The picture that was due was shown, or cannot be."""
        next_secs = self.due_secs + self._interval_secs
        self.due_secs = next_secs if next_secs > now_secs else now_secs + self._interval_secs


class Trail:
    """The last steps of the first column: its postures, and the latents of each block."""

    def __init__(self, steps: int) -> None:
        self._steps = steps
        self._path: deque[Floats] = deque(maxlen=steps)
        self._latents: dict[str, deque[Floats]] = {}

    def add(self, posture: Floats, seen: Mapping[str, Seen | None]) -> None:
        """One more step: the postures (E, p), and what each block acts on."""
        self._path.append(posture[0].copy())
        for block, acted_on in seen.items():
            if acted_on is not None:
                latents = self._latents.setdefault(block, deque(maxlen=self._steps))
                latents.append(acted_on[0][0].copy())

    def cut(self) -> None:
        """What comes next does not go on from here."""
        self._path.clear()
        self._latents.clear()

    def path(self) -> Floats:
        """The postures (K, p), the newest last."""
        return np.array(self._path, np.float32)

    def latents(self, block: str) -> Floats:
        """The latents (K, d) of a block, the newest last."""
        return np.array(self._latents[block], np.float32)
