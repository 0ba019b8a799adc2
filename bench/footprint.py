"""Memory of the processes, time from exec to the first environment step, and what they import."""

import statistics
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

from bench.actor_process import fed_actor
from bench.bytecode import first_start
from bench.imports import imports_table
from bench.processes import router, service, wait_for_line
from bench.scene import cuboid, in_world, write_run_folder
from bench.tables import Table, secs
from services.runtime.settings import RunSettings

SETTLE_SECS = 1.0
BODIES: Mapping[str, tuple[str, dict[str, Any], int]] = {
    "MIMo's hand": ("MimoHand", {}, 8),
    "MIMo's whole body": ("MimoRollover", {}, 8),
    "whole body, vestibular, touch at full resolution": (
        "MimoRollover",
        {"senses": ["position", "velocity", "vestibular", "touch"]},
        4,
    ),
}
"""By name: the actor's world, its parameters and copies."""


def measure(*, repetitions: int = 7, segments: int = 200) -> list[Table]:
    """The tables; the actor's memory is its peak over so many segments."""
    rows = [_actor_row("actor", cuboid(), repetitions, segments)]
    rows.append(
        _actor_row("actor, first start after an installation", cuboid(), repetitions, segments, first_start)
    )
    for name, (id, parameters, columns) in BODIES.items():
        settings = in_world(id, parameters, actors={"envs_per_actor": columns})
        rows.append(_actor_row(f"actor, {name}, {columns} copies", settings, repetitions, segments // 20))
    rows += _other_rows()
    return [
        Table(
            "Footprint of the processes without torch",
            ["", "peak MB", "ready s", "first step s", "spread"],
            rows,
            [
                "MB = 10^6 bytes of resident memory (VmHWM); seconds from exec",
                f"first step: median of {repetitions}; in GROUND, with both models, "
                "until the learner has the first segment, here of 2 steps of 8 copies, or as many as are "
                "named",
                f"actor: peak over {segments} segments, a twentieth of that with a simulated body; "
                "router and coordinator: peak when ready and idle",
            ],
        ),
        imports_table(["router", "coordinator", "actor"]),
    ]


def _first_step_secs(settings: RunSettings) -> float:
    """From exec to the first segment at the learner; a segment of two steps, the shortest there is."""
    actors = settings.actors.model_copy(update={"segment_steps": 2, "count": 1})
    with fed_actor(settings.model_copy(update={"actors": actors})) as fed:
        fed.until(lambda: fed.stand_in.first_segment_secs is not None)
        assert fed.stand_in.first_segment_secs is not None
        return fed.stand_in.first_segment_secs - fed.child.started_secs


def _actor_row(
    name: str,
    settings: RunSettings,
    repetitions: int,
    segments: int,
    starting: Callable[[], AbstractContextManager[None]] = nullcontext,
) -> list[str]:
    """Each start is within `starting()`."""
    first = []
    for _ in range(repetitions):
        with starting():
            first.append(_first_step_secs(settings))
    steps = max(1, segments) * settings.actors.segment_steps * settings.actors.envs_per_actor
    with starting(), fed_actor(settings) as fed:
        wait_for_line(fed.child, "ready in run")
        ready_secs = time.monotonic() - fed.child.started_secs
        fed.until(lambda: fed.stand_in.steps >= steps)
        peak = fed.child.peak_mb()
    spread = f"{min(first):.2f}-{max(first):.2f}"
    return [name, f"{peak:.0f}", secs(ready_secs), secs(statistics.median(first)), spread]


def _other_rows() -> list[list[str]]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_run_folder(folder, cuboid())
        began = time.monotonic()
        with router(folder) as (endpoint, child):
            router_secs = time.monotonic() - began
            coordinator = service("coordinator", folder, endpoint)
            try:
                wait_for_line(coordinator, "ready in run")
                coordinator_secs = time.monotonic() - coordinator.started_secs
                time.sleep(SETTLE_SECS)
                peaks = child.peak_mb(), coordinator.peak_mb()
            finally:
                coordinator.end()
    return [
        ["router", f"{peaks[0]:.0f}", secs(router_secs), "", ""],
        ["coordinator", f"{peaks[1]:.0f}", secs(coordinator_secs), "", ""],
    ]
