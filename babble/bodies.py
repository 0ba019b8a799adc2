"""A body and the blocks that see and move it, from their descriptions."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from babble.blocks import BlockError, BlockSpec, BlockTree, Described, shortened
from babble.observations import part_of
from babble.patterns import PatternError, matching
from babble.worlds import World, make

COMPONENT = "component of the observation"


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
    return world, tree_of(blocks, world)


def tree_of(described: Iterable[Described], world: World) -> BlockTree:
    """The tree of blocks on a world, with patterns of names made indices, in the order of the body.

    `drives` has patterns over the world's `action_names`. Those of `observes` are over "sense/component",
    the world's `observation_names`, if they have a "/", else over the component in any sense. A pattern
    has `*`, `?` and `[...]` as in shells; one that begins with `!` takes out what it matches. Raises
    `BlockError` for a pattern that matches nothing, with the nearest names, and for blocks that make no
    tree, drive an actuator twice or not at all, or observe part of an image.
    """
    specs = [
        BlockSpec(
            name=block.name,
            latent_dim=block.latent_dim,
            observes=_resolved(block.name, "observes", block.observes, world.observation_names),
            drives=_resolved(block.name, "drives", block.drives, world.action_names),
            children=tuple(block.children),
        )
        for block in described
    ]
    tree = BlockTree(specs, world.observation_size, world.action_size, action_names=world.action_names)
    for leaf in tree.level(0):
        try:
            part_of(world.senses, tree.observed(leaf.name))
        except ValueError as error:
            raise BlockError(f"block {leaf.name!r} observes what it cannot: {error}") from None
    return tree


def remarks(tree: BlockTree, world: World) -> list[str]:
    """What several blocks on a world leave out or share of its observation, one line each.

    Neither is wrong, but either may be a slip. Empty where one block sees and moves the whole body.
    """
    leaves = [spec.name for spec in tree.level(0)]
    times = Counter(index for leaf in leaves for index in tree.observed(leaf).tolist())
    if len(leaves) == 1:
        return []
    found = {
        "nobody observes": [index for index in range(world.observation_size) if not times[index]],
        "more than one block observes": sorted(index for index in times if times[index] > 1),
    }
    return [
        f"{words} {len(indices)} of {world.observation_size} components "
        f"({shortened([world.observation_names[index] for index in indices])})"
        for words, indices in found.items()
        if indices
    ]


def _resolved(
    block: str, word: str, given: Sequence[int] | Sequence[str] | None, names: Sequence[str]
) -> tuple[int, ...] | None:
    """The indices that are described by a list of numbers or of patterns."""
    if given is None:
        return None
    patterns = [each for each in given if isinstance(each, str)]
    if not patterns:
        return tuple(int(index) for index in given)
    if len(patterns) != len(given):
        raise BlockError(f"block {block!r} {word} numbers and patterns of names; give one or the other")
    try:
        if word == "drives":
            return tuple(matching(names, patterns, "actuator").tolist())
        return _observed(names, patterns)
    except PatternError as error:
        raise BlockError(f"block {block!r} {word}: {error}") from None


def _observed(names: Sequence[str], patterns: Sequence[str]) -> tuple[int, ...]:
    """The indices of the "sense/component" names that are chosen."""
    components = [name.partition("/")[2] for name in names]
    chosen: set[int] = set()
    for pattern in patterns:
        wanted = pattern.removeprefix("!")
        found = set(matching(names if "/" in wanted else components, [wanted], COMPONENT).tolist())
        chosen = chosen - found if pattern.startswith("!") else chosen | found
    if not chosen:
        raise PatternError(f"the patterns {list(patterns)} leave no {COMPONENT}")
    return tuple(sorted(chosen))
