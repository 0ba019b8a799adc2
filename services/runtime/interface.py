"""The interface of a run, whose fingerprint stands on every segment and model."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from protocol.specs import BlockInterface, InterfaceSpec
from services.runtime.settings import RunSettings


class ResolvedBlock(Protocol):
    """A block of the tree, with what it observes and drives as indices; `babble.blocks.BlockSpec` is one."""

    @property
    def name(self) -> str: ...
    @property
    def latent_dim(self) -> int: ...
    @property
    def observes(self) -> Sequence[int] | None: ...
    @property
    def drives(self) -> Sequence[int] | None: ...
    @property
    def children(self) -> Sequence[str]: ...


def interface_of(
    settings: RunSettings,
    *,
    senses: Mapping[str, tuple[int, ...]],
    action_size: int,
    blocks: Iterable[ResolvedBlock],
) -> InterfaceSpec:
    """What actors and learners must agree on: the world, its senses and actions, the tree of blocks.

    `senses` are the world's: their shapes, in the order in which they make up its observation. `blocks` are
    the tree's, because only with the world do patterns of names become indices.
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
            for block in blocks
        ),
    )
