"""A body and the blocks that see and move it, from their descriptions."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from babble.blocks import BlockTree, Described
from babble.worlds import World, make


def make_body(
    id: str,
    parameters: Mapping[str, Any],
    blocks: Iterable[Described],
    *,
    columns: int,
    seed: int | Sequence[int],
) -> tuple[World, BlockTree]:
    """`columns` copies of the named world, and the tree of blocks on it.

    Raises `WorldError` or `BlockError`, both ValueErrors of one sentence, where there is no such thing.
    """
    world = make(id, parameters, columns, seed)
    return world, BlockTree.of(blocks, world.observation_size, world.action_size)
