"""The tree of blocks on the page: families, and where each block stands (pure)."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from services.runtime.settings import BlockSettings, RunSettings

Floats = NDArray[np.float32]

PICTURE_PX, LETTER_PX = 720.0, 7.2
"""The height of the picture on a usual page, and the width of a letter: texts do not shrink with the tree."""
MARGIN = 2.0
"""above and below all leaves together, where a leaf takes a height of 1"""
BLOCK = 0.45
"""From the middle of a block to its text."""
LEAST_REACH = 2.0
BEND = 1.6
"""The way of a line from what belongs to a block to the next level."""
NUMBERS = 9
"""letters of " g1 0.97" behind a name"""


@dataclass(frozen=True)
class Family:
    """A block and those whose goals it sets."""

    parent: BlockSettings
    children: tuple[BlockSettings, ...]

    @property
    def members(self) -> tuple[BlockSettings, ...]:
        """The parent, then its children."""
        return (self.parent, *self.children)


class Tree:
    """The blocks of a run by level, the top level at the left; blocks without a parent stand alone."""

    def __init__(self, settings: RunSettings) -> None:
        self._blocks = {block.name: block for block in settings.block}
        self._levels = settings.levels
        self.parents = {child: block.name for block in settings.block for child in block.children}
        """by child"""

    @property
    def deep(self) -> bool:
        """True if there is more than one level."""
        return len(self._levels) > 1

    @property
    def levels(self) -> tuple[tuple[str, ...], ...]:
        """Names of the blocks of each level, that of the leaves first."""
        return self._levels

    @property
    def roots(self) -> list[BlockSettings]:
        """The blocks without a parent, those of higher levels first."""
        return [block for block in self._from_the_top() if block.name not in self.parents]

    @property
    def families(self) -> list[Family]:
        """Each block with children, those of higher levels first."""
        return [
            Family(block, tuple(self._blocks[child] for child in block.children))
            for block in self._from_the_top()
            if block.children
        ]

    @property
    def unit_px(self) -> float:
        """The height of a leaf on a usual page."""
        return PICTURE_PX / (MARGIN + len(self._leaves()))

    @property
    def reach(self) -> float:
        """What belongs to a block ends so far right of it, its text among them."""
        return max(LEAST_REACH, BLOCK + self.width(max(map(len, self._blocks)) + NUMBERS))

    def width(self, letters: int) -> float:
        """Of a text of so many letters."""
        return letters * LETTER_PX / self.unit_px

    def order(self) -> list[str]:
        """All blocks, each followed by what is below it."""
        return [name for root in self.roots for name in self._below(root.name)]

    def places(self) -> dict[str, Floats]:
        """Where each block stands, (2,): x by its level, y by the leaves below it, downwards from 0."""
        heights = {name: float(row) for row, name in enumerate(self._leaves())}
        column = self.reach + BEND
        places: dict[str, Floats] = {}
        for level, names in enumerate(self._levels):
            for name in names:
                children = self._blocks[name].children
                if children:
                    heights[name] = sum(heights[child] for child in children) / len(children)
                places[name] = np.array([(len(self._levels) - 1 - level) * column, heights[name]], np.float32)
        return places

    def _leaves(self) -> list[str]:
        return [name for name in self.order() if not self._blocks[name].children]

    def _from_the_top(self) -> Iterator[BlockSettings]:
        return (self._blocks[name] for names in reversed(self._levels) for name in names)

    def _below(self, name: str) -> Iterator[str]:
        yield name
        for child in self._blocks[name].children:
            yield from self._below(child)
