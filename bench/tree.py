"""What a tree of blocks costs an actor: the hand as one block, as five fingers, and as five below a sixth."""

import os
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

from bench.actor import UNSEEN, interleaved, one_core
from bench.contenders import InProcess, Took
from bench.scene import in_world
from bench.tables import Table, count, ratio
from services.runtime.settings import RunSettings

HAND = {"coupling": 0.05, "balanced": True, "physics_steps": 5}
"""As in scenarios/hand.toml."""
FINGERS = {
    "index": ("ff", "ff"),
    "middle": ("mf", "mf"),
    "ring": ("rf", "rf"),
    "little": ("lf", "lf"),
    "thumb": ("th", "thumb"),
}
"""What MIMo calls a finger in the names of its joints, and in those of its motors."""
FLAT = "flat: one block for the hand"
CUTS = (3, 7, 14)
"""The hand's 14 joints cut into so many blocks of one level."""


def measure(*, steps: int = 40_960, repetitions: int = 7) -> list[Table]:
    """Speeds of an actor by the blocks that act, in GROUND, against the flat hand."""
    usable = sorted(os.sched_getaffinity(0))
    with one_core(usable):
        contenders = {name: InProcess(settings, level) for name, (settings, level) in _cases().items()}
        return [_table(interleaved(contenders, steps, repetitions))]


def _cases() -> Mapping[str, tuple[RunSettings, int]]:
    """By name: the settings, and the level that is at work."""
    cut = {f"{blocks} blocks of one level": (_hand(_cut(blocks)), 0) for blocks in CUTS}
    return {
        FLAT: (_hand([{"name": "hand"}]), 0),
        "five fingers, learning": (_hand(_fingers()), 0),
        "five fingers below a hand that learns": (_hand([*_fingers(), _top()]), 1),
        **cut,
    }


def _fingers() -> list[dict[str, Any]]:
    return [
        {"name": name, "observes": [f"*_{joints}_*"], "drives": [f"*_{motors}_*"]}
        for name, (joints, motors) in FINGERS.items()
    ]


def _top() -> dict[str, Any]:
    return {"name": "hand", "children": list(FINGERS)}


def _cut(blocks: int) -> list[dict[str, Any]]:
    parts = [list(range(k, 14, blocks)) for k in range(blocks)]
    return [{"name": f"part{k}", "observes": part, "drives": part} for k, part in enumerate(parts)]


def _hand(blocks: Sequence[dict[str, Any]]) -> RunSettings:
    settings = in_world("MimoHand", HAND, block=list(blocks), goals={"period_steps": 200})
    return settings.model_copy(update={"view": UNSEEN})


def _table(tooks: Mapping[str, Sequence[Took]]) -> Table:
    speeds = {name: [took.steps / took.cpu_secs for took in taken] for name, taken in tooks.items()}
    rows = []
    for name, mine in speeds.items():
        ratios = [a / b for a, b in zip(mine, speeds[FLAT], strict=True)]
        added_us = [1e6 / a - 1e6 / b for a, b in zip(mine, speeds[FLAT], strict=True)]
        spread = f"{min(ratios):.2f}-{max(ratios):.2f}"
        rows.append([name, count(median(mine)), ratio(median(ratios)), spread, f"{median(added_us):+.1f}"])
    return Table(
        "What a tree of blocks costs an actor",
        ["MIMo's hand, 14 joints", "steps/CPU s", "of flat", "spread", "us more per step"],
        rows,
        [
            f"median of {len(speeds[FLAT])} interleaved repetitions, 8 worlds on one core, memory bus, "
            "nothing shown; ratios by CPU time, repetition by repetition",
            "blocks of one level run as one ONNX model: two calls per step of all worlds, whatever their "
            "number; a hand above them adds two calls in ten steps",
        ],
    )
