"""The tree of a run's blocks on a world of which only the sizes matter."""

from babble.blocks import BlockSpec, BlockTree
from services.runtime.settings import RunSettings


def tree_on(settings: RunSettings, observation_size: int, action_size: int) -> BlockTree:
    """The tree of blocks that are described by numbers."""
    specs = [
        BlockSpec(
            block.name,
            block.latent_dim,
            observes=None if block.observes is None else tuple(map(int, block.observes)),
            drives=None if block.drives is None else tuple(map(int, block.drives)),
            children=tuple(block.children),
        )
        for block in settings.block
    ]
    return BlockTree(specs, observation_size, action_size)
