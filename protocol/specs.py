"""What actors and learners of a run must agree on before a segment or a model means anything."""

import hashlib
import json
from math import prod
from typing import Annotated, Any

from pydantic import Field, JsonValue, model_validator

from protocol.messages import ALL_BLOCKS, Label, Name, Strict
from protocol.refusal import MAX_SENTENCE_CHARS, MAX_VALUE_CHARS, clip

Size = Annotated[int, Field(ge=1, le=2**31)]
Index = Annotated[int, Field(ge=0, le=2**31)]
MAX_NAMED_DIFFERENCES = 3


class BlockInterface(Strict):
    """What one block of the tree observes, drives and calls its children."""

    name: Name
    latent_dim: Annotated[int, Field(ge=2, le=2**16)]
    observes: tuple[Index, ...] | None = None
    """Indices of the world's flat observation; None for all of it."""
    drives: tuple[Index, ...] | None = None
    """Indices of the world's action; None for all of it."""
    children: tuple[Name, ...] = ()
    """Blocks whose latents it observes, in this order, and whose goals it sets."""


class InterfaceSpec(Strict):
    """The world, its senses and actions, and the tree of blocks.

    Raises pydantic's ValidationError (a ValueError) for a tree that is none, or indices that the
    world has not.
    """

    world: Annotated[str, Field(min_length=1, max_length=200)]
    parameters: dict[Label, JsonValue] = Field(default_factory=dict)
    """The world's parameters; numbers must be finite."""
    senses: Annotated[dict[Label, tuple[Size, ...]], Field(min_length=1)]
    """The shape of each sense, in the order in which they make up the flat observation."""
    action_size: Size
    blocks: Annotated[tuple[BlockInterface, ...], Field(min_length=1, max_length=256)]

    @model_validator(mode="after")
    def _makes_sense(self) -> "InterfaceSpec":
        _check_tree(self.blocks)
        observation_size = sum(prod(shape) for shape in self.senses.values())
        for block in self.blocks:
            if not block.children:
                _check_indices(block, "observes", block.observes, observation_size)
            _check_indices(block, "drives", block.drives, self.action_size)
        self.canonical_json()
        return self

    def canonical_json(self) -> str:
        """The same text for the same interface, on every machine: sorted, no spaces, 1.0 written as 1."""
        return _json(
            {
                "world": self.world,
                "parameters": self.parameters,
                "senses": [[name, shape] for name, shape in self.senses.items()],
                "action_size": self.action_size,
                "blocks": [block.model_dump() for block in sorted(self.blocks, key=lambda b: b.name)],
            }
        )

    def fingerprint(self) -> str:
        """The first 16 hexadecimal digits of the SHA-256 of the canonical JSON."""
        return hashlib.sha256(self.canonical_json().encode("ascii")).hexdigest()[:16]


def describe_difference(ours: InterfaceSpec, theirs: InterfaceSpec) -> str:
    """One sentence that names both fingerprints, and both values of the first differences."""
    here, there = ours.fingerprint(), theirs.fingerprint()
    if here == there:
        return f"the interfaces are the same ({here})"
    a, b = _leaves(ours), _leaves(theirs)
    differences = [
        f"{place} is {_brief(a.get(place))} here and {_brief(b.get(place))} there"
        for place in a | b
        if a.get(place) != b.get(place)
    ]
    named = "; ".join(differences[:MAX_NAMED_DIFFERENCES])
    more = len(differences) - MAX_NAMED_DIFFERENCES
    tail = f"; and {more} more" if more > 0 else ""
    return clip(f"the interfaces differ ({here} here, {there} there): {named}{tail}", 2 * MAX_SENTENCE_CHARS)


def _leaves(spec: InterfaceSpec) -> dict[str, str]:
    leaves: dict[str, Any] = {"world": spec.world, "action_size": spec.action_size}
    leaves |= {f"parameters.{name}": value for name, value in spec.parameters.items()}
    leaves |= {f"senses.{name}": shape for name, shape in spec.senses.items()}
    leaves["the order of the senses"] = list(spec.senses)
    for block in spec.blocks:
        fields = block.model_dump(exclude={"name"})
        leaves |= {f"blocks.{block.name}.{field}": value for field, value in fields.items()}
    return {place: _json(value) for place, value in leaves.items()}


def _brief(leaf: str | None) -> str:
    return "absent" if leaf is None else clip(leaf, MAX_VALUE_CHARS)


def _json(value: object) -> str:
    return json.dumps(_normal(value), sort_keys=True, separators=(",", ":"), allow_nan=False)


def _normal(value: Any) -> Any:
    match value:
        case float() if value.is_integer():
            return int(value)
        case dict():
            return {key: _normal(inner) for key, inner in value.items()}
        case list() | tuple():
            return [_normal(inner) for inner in value]
        case _:
            return value


def _check_indices(block: BlockInterface, what: str, indices: tuple[int, ...] | None, size: int) -> None:
    for index in indices or ():
        if index >= size:
            raise ValueError(f"block {block.name} {what} index {index}, but the world has only {size}")


def _check_tree(blocks: tuple[BlockInterface, ...]) -> None:
    by_name = {block.name: block for block in blocks}
    if len(by_name) != len(blocks) or ALL_BLOCKS in by_name:
        raise ValueError(f"block names must be distinct and none may be {ALL_BLOCKS!r}")
    parents: dict[str, str] = {}
    for block in blocks:
        for child in block.children:
            if child not in by_name:
                raise ValueError(f"block {block.name} has the child {child}, which is no block")
            if child in parents:
                raise ValueError(f"block {child} is a child of both {parents[child]} and {block.name}")
            parents[child] = block.name
    for name in by_name:
        above = name
        for _ in by_name:
            above = parents.get(above, "")
        if above:
            raise ValueError(f"block {name} is below itself")
