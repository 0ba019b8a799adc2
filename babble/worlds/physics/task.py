"""What a body is there for: where it begins, what it is rewarded for from outside, when it ends."""

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds.batch import Flags, Floats, Start

Indices = NDArray[np.intp]
Copies = Sequence[mujoco.MjData]


class Task(Protocol):
    """One task; built for one model, shared by all copies."""

    @property
    def rewarded(self) -> bool:
        """Whether there is an external reward at all."""
        ...

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """Put one copy, freshly reset, where an episode begins: its usual place or a random one."""
        ...

    def reward(self, copies: Copies) -> Floats:
        """(E,) the external reward of the step that was just done."""
        ...

    def terminated(self, copies: Copies) -> Flags:
        """(E,) whose episode is over for good."""
        ...


class Play:
    """No task: the body begins at rest or with random joint angles, nothing is rewarded, nothing ends."""

    rewarded = False

    def __init__(self, model: mujoco.MjModel, joints: Indices) -> None:
        self.model = model
        self._qpos = model.jnt_qposadr[joints]
        limited = model.jnt_limited[joints].astype(bool)
        low, high = model.jnt_range[joints].T
        rest = model.qpos0[self._qpos]
        self._least, self._most = np.where(limited, low, -np.inf), np.where(limited, high, np.inf)
        self._low, self._high = np.where(limited, low, rest), np.where(limited, high, rest)

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """At the model's own pose, as far as the joints' ranges allow it, or anywhere in these."""
        if start == "random":
            data.qpos[self._qpos] = rng.uniform(self._low, self._high)
        else:
            data.qpos[self._qpos] = np.clip(data.qpos[self._qpos], self._least, self._most)

    def reward(self, copies: Copies) -> Floats:
        """Zeros."""
        return np.zeros(len(copies), np.float32)

    def terminated(self, copies: Copies) -> Flags:
        """Never."""
        return np.zeros(len(copies), np.bool_)
