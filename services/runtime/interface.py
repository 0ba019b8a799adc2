"""The interface of a run, whose fingerprint stands on every segment and model."""

from collections.abc import Mapping

from protocol.specs import BlockInterface, InterfaceSpec
from services.runtime.settings import RunSettings


def interface_of(
    settings: RunSettings, *, senses: Mapping[str, tuple[int, ...]], action_size: int
) -> InterfaceSpec:
    """What actors and learners must agree on: the world, its senses and actions, the tree of blocks.

    `senses` are the world's: their shapes, in the order in which they make up its observation.
    """
    return InterfaceSpec(
        world=settings.world.id,
        parameters=settings.world.parameters,
        senses=dict(senses),
        action_size=action_size,
        blocks=tuple(
            BlockInterface(
                name=block.name,
                latent_dim=block.latent_dim,
                observes=None if block.observes is None else tuple(block.observes),
                drives=None if block.drives is None else tuple(block.drives),
                children=tuple(block.children),
            )
            for block in settings.block
        ),
    )
