"""What an actor takes from the run's settings."""

import zlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from babble.blocks import BlockTree
from babble.bodies import make_body
from babble.observations import Layout, part_of
from babble.worlds.batch import World
from services.runtime.settings import RunSettings, SettingsError


@dataclass(frozen=True)
class Body:
    """An actor's worlds and the tree of blocks that moves them."""

    world: World
    tree: BlockTree
    layouts: Mapping[str, Layout]
    """of what each block observes"""

    @classmethod
    def of(cls, world: World, tree: BlockTree) -> "Body":
        """A world and its blocks. Raises ValueError for a block that observes part of an image."""
        layouts = {name: _layout(world, tree, name) for name in tree.specs}
        return cls(world, tree, layouts)


def body_of(settings: RunSettings, seeds: np.random.SeedSequence) -> Body:
    """`envs_per_actor` copies of the run's world. Raises `SettingsError` if there is no such thing."""
    try:
        world, tree = make_body(
            settings.world.id,
            settings.world.parameters,
            settings.block,
            columns=settings.actors.envs_per_actor,
            seed=seeds.generate_state(4).tolist(),
        )
        return Body.of(world, tree)
    except ValueError as error:
        raise SettingsError(str(error)) from None


def first_observation(body: Body) -> NDArray[np.float32]:
    """The observations (E, n) at the beginning. Raises `SettingsError` where a sense has no renderer."""
    try:
        return body.world.reset()
    except ValueError as error:
        raise SettingsError(str(error)) from None


def _layout(world: World, tree: BlockTree, block: str) -> Layout:
    if tree.specs[block].children:
        return Layout({"latent": (tree.observation_size_of(block),)})
    try:
        return Layout(part_of(world.senses, tree.observed(block)))
    except ValueError as error:
        raise ValueError(f"block {block!r}: {error}") from None


def seeds_of(settings: RunSettings, index: int, life: str) -> np.random.SeedSequence:
    """The actor's branch of the seed tree: run -> actor index -> life.

    The life is part of it, so that an actor that replaces a dead one does not repeat its experience.
    """
    return np.random.SeedSequence([settings.seed, 3, index, zlib.crc32(life.encode())])
