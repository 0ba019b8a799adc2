"""The coordinator's plan, from the settings of the run."""

from collections.abc import Mapping

from services.coordinator.state import Plan
from services.coordinator.table import Learner
from services.runtime.settings import LearnerKind, RunSettings

KINDS: Mapping[Learner, LearnerKind] = {"encoder_learner": "encoder", "policy_learner": "policy"}


def plan_of(settings: RunSettings) -> Plan:
    """What the run does, level by level: leaves are level 0, a parent is one above its highest child.

    Raises `SettingsError` if a block names a child that is unknown or its own ancestor.
    """
    levels = settings.levels
    return Plan(
        levels=levels,
        iterations=tuple(settings.of_level(level).phases.iterations for level in range(len(levels))),
        stall_secs=settings.wire.stall_secs,
        open_loop=settings.phases.open_loop,
        records=settings.recording.every_steps > 0,
        processes={learner: getattr(settings.learners, kind) for learner, kind in KINDS.items()},
        shares={
            (learner, block.name): settings.learner_of(block.name, kind)
            for learner, kind in KINDS.items()
            for block in settings.block
        },
    )
