"""The coordinator's plan, from the settings of the run."""

from services.coordinator.state import Plan
from services.runtime.settings import RunSettings, SettingsError


def plan_of(settings: RunSettings) -> Plan:
    """What the run does, level by level: leaves are level 0, a parent is one above its highest child.

    Raises `SettingsError` if a block names a child that is unknown or its own ancestor.
    """
    names = [block.name for block in settings.block]
    heights = {name: _height(settings, name, ()) for name in names}
    levels = range(max(heights.values()) + 1)
    return Plan(
        levels=tuple(tuple(name for name in names if heights[name] == level) for level in levels),
        iterations=settings.phases.iterations,
        stall_secs=settings.wire.stall_secs,
    )


def _height(settings: RunSettings, name: str, ancestors: tuple[str, ...]) -> int:
    if name in ancestors:
        parent = ancestors[-1]
        raise SettingsError(f"block {name!r} is its own ancestor; remove it from the children of {parent!r}")
    try:
        children = settings.one_block(name).children
    except KeyError:
        parent = ancestors[-1]
        raise SettingsError(
            f"block {parent!r} has an unknown child {name!r}; name a block of the scenario"
        ) from None
    return 1 + max((_height(settings, child, (*ancestors, name)) for child in children), default=-1)
