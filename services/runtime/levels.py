"""What the levels of a tree make of a run's tables: run < level < block, the nearest word counts (pure).

The functions raise pydantic's ValidationError with the place in the scenario, for example
`level.1.policy.epochs`, so that they serve as validators of the whole.
"""

from collections.abc import Mapping, Sequence
from typing import Any, TypeVar

from pydantic import ValidationError
from pydantic_core import InitErrorDetails, PydanticCustomError

from services.runtime.errors import UserError
from services.runtime.sections import BlockSettings, LevelSettings, Section

LEVEL_TABLES = ("phases", "babbling", "encoder", "policy", "goals", "evaluation")
"""The tables that a level may have otherwise."""
BLOCK_TABLES = ("encoder", "policy")
"""The tables that a block may have otherwise."""
FIRST_DECISION_STEPS = 10
"""Environment steps of one action of level 1, unless it says otherwise (facts: 3, 10 and 25 work)."""
DECISION_GROWTH = 5
"""So many decisions of the level below make one, unless a level says otherwise."""

Place = tuple[str | int, ...]
AnySection = TypeVar("AnySection", bound=Section)


class SettingsError(UserError, ValueError):
    """A scenario or run configuration that cannot be used; the text is one sentence for a person."""


def misplaced(place: Place, sentence: str, got: object) -> ValidationError:
    """The error that says what is wrong at a place of the scenario."""
    error = PydanticCustomError("settings", "{sentence}", {"sentence": sentence})
    return ValidationError.from_exception_data(
        "settings", [InitErrorDetails(type=error, loc=place, input=got)]
    )


def merged(section: AnySection, changes: Mapping[str, Any], place: Place) -> AnySection:
    """The section with what `changes` say, however deep, checked like any other.

    Raises ValidationError that names `place` and the key below it.
    """
    if not changes:
        return section
    try:
        return type(section).model_validate(_deep(section.model_dump(), changes))
    except ValidationError as error:
        raise ValidationError.from_exception_data(
            "settings",
            [
                InitErrorDetails(
                    type=fault["type"],
                    loc=(*place, *fault["loc"]),
                    input=fault["input"],
                    ctx=fault.get("ctx", {}),
                )
                for fault in error.errors(include_url=False)
            ],
        ) from None


def levels_of(blocks: Sequence[BlockSettings]) -> tuple[tuple[str, ...], ...]:
    """The names of each level: leaves are level 0, a parent is one above its highest child.

    Raises `SettingsError` if a block names a child that is unknown or its own ancestor.
    """
    children = {block.name: block.children for block in blocks}
    heights = {name: _height(children, name, ()) for name in children}
    return tuple(
        tuple(name for name in children if heights[name] == level)
        for level in range(1 + max(heights.values()))
    )


def decision_steps_of(given: Sequence[LevelSettings], levels: int) -> tuple[int, ...]:
    """Environment steps of one decision, by level: 1 for the leaves, above them multiples of the one below.

    Raises ValidationError for a level that has another number.
    """
    if len(given) > levels:
        there = f"levels 0 to {levels - 1}" if levels > 1 else "level 0 alone"
        raise misplaced(("level", levels), f"the blocks make {there}; leave out what is above", len(given))
    steps: list[int] = []
    for level in range(levels):
        below = steps[-1] if steps else 1
        default = (1, FIRST_DECISION_STEPS)[level] if level < 2 else DECISION_GROWTH * below
        wanted = given[level].decision_steps if level < len(given) else None
        place = ("level", level, "decision_steps")
        if level == 0 and wanted not in (None, 1):
            raise misplaced(
                place, "the leaves decide at each environment step, so this may only be 1", wanted
            )
        if wanted is not None and wanted % below:
            raise misplaced(place, f"must be a multiple of the {below} of the level below", wanted)
        steps.append(default if wanted is None else wanted)
    return tuple(steps)


def _height(children: Mapping[str, Sequence[str]], name: str, ancestors: tuple[str, ...]) -> int:
    if name in ancestors:
        raise SettingsError(
            f"block {name!r} is its own ancestor; remove it from the children of {ancestors[-1]!r}"
        )
    if name not in children:
        raise SettingsError(
            f"block {ancestors[-1]!r} has an unknown child {name!r}; name a block of the scenario"
        )
    below = (_height(children, child, (*ancestors, name)) for child in children[name])
    return 1 + max(below, default=-1)


def _deep(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    made = dict(base)
    for key, value in changes.items():
        there = base.get(key)
        if isinstance(there, Mapping) and isinstance(value, Mapping):
            value = _deep(there, value)
        made[key] = value
    return made
