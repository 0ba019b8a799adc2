"""What an actor takes from the run's settings."""

import zlib
from dataclasses import dataclass

import numpy as np

from babble.blocks import BlockTree
from babble.worlds import make
from babble.worlds.batch import World
from services.runtime.settings import RunSettings


@dataclass(frozen=True)
class Body:
    """An actor's worlds and the tree of blocks that moves them."""

    world: World
    tree: BlockTree


def body_of(settings: RunSettings, seeds: np.random.SeedSequence) -> Body:
    """`envs_per_actor` copies of the run's world. Raises WorldError or BlockError, each one sentence."""
    world = make(
        settings.world.id,
        settings.world.parameters,
        columns=settings.actors.envs_per_actor,
        seed=seeds.generate_state(4).tolist(),
    )
    return Body(world, BlockTree.of(settings.block, world.observation_size, world.action_size))


def seeds_of(settings: RunSettings, index: int, life: str) -> np.random.SeedSequence:
    """The actor's branch of the seed tree: run -> actor index -> life.

    The life is part of it, so that an actor that replaces a dead one does not repeat its experience.
    """
    return np.random.SeedSequence([settings.seed, 3, index, zlib.crc32(life.encode())])
