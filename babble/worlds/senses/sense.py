"""What a sense is: something that reads numbers off copies of one simulated body."""

from collections.abc import Sequence
from typing import Protocol

import mujoco
import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]
Copies = Sequence[mujoco.MjData]
"""E copies of one body; a sense is built for their common model."""


class Sense(Protocol):
    """One sense of a body.

    A shape of one dimension is a vector; (eyes, height, width, 3) are images whose values are whole
    numbers from 0 to 255.
    """

    @property
    def name(self) -> str:
        """Its name in the scenario and in the run's interface."""
        ...

    @property
    def shape(self) -> tuple[int, ...]:
        """The shape of what one copy senses."""
        ...

    @property
    def components(self) -> tuple[str, ...]:
        """What each number, flattened, belongs to: a joint, a body, an eye; numbers may share a name."""
        ...

    def read(self, copies: Copies) -> Floats:
        """(E, *shape) what each copy senses now, after a step or mj_forward."""
        ...
