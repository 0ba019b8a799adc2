"""Steps in, segments out: collects the arrays of single steps until a segment is full."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[Any]


class SegmentBuilder:
    """Builds segments of `steps` steps x `columns` worlds from named per-step arrays."""

    def __init__(self, steps: int, columns: int) -> None:
        if steps < 1 or columns < 1:
            raise ValueError(f"a segment needs steps >= 1 and columns >= 1, got {steps} and {columns}")
        self.steps = steps
        self.columns = columns
        self._arrays: dict[str, Array] = {}
        self._layout: dict[str, tuple[tuple[int, ...], np.dtype[Any]]] = {}
        self._filled = 0

    def __len__(self) -> int:
        """The steps in the unfinished segment."""
        return self._filled

    def add(self, **arrays: Array) -> dict[str, Array] | None:
        """Add one step, each array (E, ...); every `steps` calls returns the segment, each array (T, E, ...).

        The first step of a segment decides names, shapes and types. Raises ValueError, and keeps
        what it has, for a step that differs from it.
        """
        if not self._filled:
            self._begin(arrays)
        elif {name: (array.shape, array.dtype) for name, array in arrays.items()} != self._layout:
            raise ValueError(
                f"a step of {self._names(arrays)} does not fit a segment of {self._names(self._arrays)}"
            )
        for name, array in arrays.items():
            self._arrays[name][self._filled] = array
        self._filled += 1
        if self._filled < self.steps:
            return None
        finished = self._arrays
        self.discard()
        return finished

    def discard(self) -> None:
        """Forget the unfinished segment."""
        self._arrays = {}
        self._filled = 0

    def _begin(self, given: dict[str, Array]) -> None:
        for name, array in given.items():
            if array.shape[:1] != (self.columns,):
                raise ValueError(f"{name} must have {self.columns} columns, got shape {array.shape}")
        self._layout = {name: (array.shape, array.dtype) for name, array in given.items()}
        self._arrays = {
            name: np.empty((self.steps, *array.shape), array.dtype) for name, array in given.items()
        }

    @staticmethod
    def _names(arrays: dict[str, Array]) -> str:
        return (
            ", ".join(f"{name} {array.dtype}{list(array.shape)}" for name, array in arrays.items())
            or "nothing"
        )
