"""A Composer block and the tree of blocks (Hi-Composer, thesis 3.5): who observes and drives what."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]
MOST_NAMED = 3
"""So many names stand in a sentence about many."""


class BlockError(ValueError):
    """Blocks that do not make a tree; the text is one sentence for a person."""


@dataclass(frozen=True)
class BlockSpec:
    """One block. A leaf observes and drives parts of the body; a block with children has them instead."""

    name: str
    latent_dim: int
    observes: tuple[int, ...] | None = None
    """indices of the body's observation; None for all of it"""
    drives: tuple[int, ...] | None = None
    """indices of the body's actuators; None for all of them"""
    children: tuple[str, ...] = ()
    """the blocks whose latents it observes and whose goals are its action (eq. 14-16)"""


class Described(Protocol):
    """A description of a block with the fields of `BlockSpec`, as lists where it likes.

    What a leaf observes and drives may also be described by patterns of names; see babble.bodies.tree_of.
    """

    @property
    def name(self) -> str: ...
    @property
    def latent_dim(self) -> int: ...
    @property
    def observes(self) -> Sequence[int] | Sequence[str] | None: ...
    @property
    def drives(self) -> Sequence[int] | Sequence[str] | None: ...
    @property
    def children(self) -> Sequence[str]: ...


class BlockTree:
    """The blocks of a run, checked: each actuator has one leaf that drives it, each block at most one parent.

    Raises `BlockError` otherwise.
    """

    def __init__(
        self,
        specs: Sequence[BlockSpec],
        observation_size: int,
        action_size: int,
        *,
        action_names: Sequence[str] = (),
    ) -> None:
        """`action_names` are those of the body's actuators, for what is said of them."""
        self.specs = {spec.name: spec for spec in specs}
        self._observation_size = observation_size
        self._action_size = action_size
        self._action_names = action_names or [str(actuator) for actuator in range(action_size)]
        _check_names(specs)
        _check_children(specs)
        self._levels = _levels(self.specs)
        for spec in specs:
            self._check_slices(spec)
        leaves = [spec for spec in specs if not spec.children]
        # Made once: actors ask for them at every step.
        self._observed = {spec.name: _indices(spec.observes, observation_size) for spec in leaves}
        self._driven = {spec.name: _indices(spec.drives, action_size) for spec in leaves}
        self._check_actuators()

    @property
    def levels(self) -> int:
        """How many levels there are; leaves are level 0."""
        return 1 + max(self._levels.values())

    def level(self, k: int) -> list[BlockSpec]:
        """The blocks of level k, in the given order; a block stands one above the highest of its children."""
        return [spec for spec in self.specs.values() if self._levels[spec.name] == k]

    def level_of(self, name: str) -> int:
        """The level of a block."""
        return self._levels[self._spec(name).name]

    def observed(self, name: str) -> Indices:
        """What of the body's observation a leaf observes; empty for a block with children."""
        return self._observed.get(self._spec(name).name, NOTHING)

    def driven(self, name: str) -> Indices:
        """Which of the body's actuators a leaf drives; empty for a block with children."""
        return self._driven.get(self._spec(name).name, NOTHING)

    def leaves_of(self, name: str) -> list[BlockSpec]:
        """The leaves through which a block acts, left to right; a leaf acts through itself."""
        spec = self._spec(name)
        return (
            [leaf for child in spec.children for leaf in self.leaves_of(child)] if spec.children else [spec]
        )

    def driven_through(self, name: str) -> Indices:
        """Which of the body's actuators a block drives itself or through its descendants, in their order."""
        return np.sort(np.concatenate([self.driven(leaf.name) for leaf in self.leaves_of(name)]))

    def child_slices(self, name: str) -> dict[str, slice]:
        """Where each child's part lies in a block's observation (its latent) and action (its goal)."""
        slices, start = {}, 0
        for child in self._spec(name).children:
            stop = start + self.specs[child].latent_dim
            slices[child] = slice(start, stop)
            start = stop
        return slices

    def observation_size_of(self, name: str) -> int:
        """The length of what a block observes."""
        children = self._spec(name).children
        return (
            sum(self.specs[child].latent_dim for child in children) if children else len(self.observed(name))
        )

    def action_size_of(self, name: str) -> int:
        """The length of a block's action: its actuators, or the goals of its children."""
        children = self._spec(name).children
        return sum(self.specs[child].latent_dim for child in children) if children else len(self.driven(name))

    def observation_of(
        self, block: str, obs: NDArray[Any], latents: Mapping[str, NDArray[Any]] | None = None
    ) -> NDArray[Any]:
        """What a block observes, of the body's observation (E, n) or of its children's `latents` (E, d)."""
        children = self._spec(block).children
        if not children:
            return np.asarray(obs[:, self.observed(block)])
        held = latents or {}
        if missing := [child for child in children if child not in held]:
            raise BlockError(f"block {block!r} observes the latent of {missing[0]!r}, which was not given")
        return np.concatenate([held[child] for child in children], axis=1)

    def _spec(self, name: str) -> BlockSpec:
        if name not in self.specs:
            raise BlockError(f"there is no block {name!r}; the blocks are {', '.join(self.specs)}")
        return self.specs[name]

    def _check_slices(self, spec: BlockSpec) -> None:
        if spec.latent_dim < 2:
            raise BlockError(f"block {spec.name!r} needs a latent_dim of at least 2, got {spec.latent_dim}")
        if spec.children and (spec.observes is not None or spec.drives is not None):
            raise BlockError(
                f"block {spec.name!r} has children, so it cannot observe or drive the body itself"
            )
        parts = (
            ("observes", spec.observes, self._observation_size),
            ("drives", spec.drives, self._action_size),
        )
        for word, indices, size in parts:
            given = indices or ()
            if indices is not None and not indices:
                raise BlockError(f"block {spec.name!r} {word} nothing")
            if outside := [i for i in given if not 0 <= i < size]:
                raise BlockError(
                    f"block {spec.name!r} {word} {outside[0]}, but the world has 0 to {size - 1}"
                )
            if twice := [index for index, times in Counter(given).items() if times > 1]:
                raise BlockError(f"block {spec.name!r} {word} {twice[0]} twice")

    def _check_actuators(self) -> None:
        driver: dict[int, str] = {}
        for spec in self.level(0):
            for actuator in self.driven(spec.name).tolist():
                if actuator in driver:
                    raise BlockError(
                        f"actuator {self._action_names[actuator]} is driven by both {driver[actuator]!r} "
                        f"and {spec.name!r}; take it out of one of them"
                    )
                driver[actuator] = spec.name
        if idle := sorted(set(range(self._action_size)) - set(driver)):
            names = shortened([self._action_names[actuator] for actuator in idle])
            raise BlockError(
                f"no block drives {len(idle)} of the world's {self._action_size} actuators ({names}); "
                "each must be driven by one block"
            )


def shortened(names: Sequence[str]) -> str:
    """The first few of a list of names, each once, with a sign that there are more."""
    once = list(dict.fromkeys(names))
    return ", ".join([*once[:MOST_NAMED], *(["..."] if len(once) > MOST_NAMED else [])])


def _indices(given: tuple[int, ...] | None, size: int) -> Indices:
    """Read-only, since all who ask share them."""
    indices = np.arange(size, dtype=np.intp) if given is None else np.array(given, dtype=np.intp)
    indices.flags.writeable = False
    return indices


NOTHING = _indices((), 0)
"""What a block with children observes or drives of the body itself."""


def _check_names(specs: Sequence[BlockSpec]) -> None:
    names = [spec.name for spec in specs]
    if not names:
        raise BlockError("a tree needs at least one block")
    if twice := [name for name in names if names.count(name) > 1]:
        raise BlockError(f"there are two blocks named {twice[0]!r}")


def _check_children(specs: Sequence[BlockSpec]) -> None:
    names = {spec.name for spec in specs}
    parent: dict[str, str] = {}
    for spec in specs:
        for child in spec.children:
            if child not in names:
                raise BlockError(f"block {spec.name!r} has the child {child!r}, which does not exist")
            if child in parent:
                raise BlockError(f"block {child!r} is a child of both {parent[child]!r} and {spec.name!r}")
            parent[child] = spec.name


def _levels(specs: Mapping[str, BlockSpec]) -> dict[str, int]:
    levels: dict[str, int] = {}
    while len(levels) < len(specs):
        ready = [
            spec for name, spec in specs.items() if name not in levels and set(spec.children) <= set(levels)
        ]
        if not ready:
            circle = next(name for name in specs if name not in levels)
            raise BlockError(f"block {circle!r} is, through its children, above itself")
        for spec in ready:
            levels[spec.name] = 1 + max((levels[child] for child in spec.children), default=-1)
    return levels
