"""What a step of a simulated world costs beside MuJoCo's own steps of the same body."""

import os
import time
from collections.abc import Callable, Mapping, Sequence
from statistics import median
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds import make
from babble.worlds.physics.world import MujocoWorld
from bench.tables import Table, count, ratio

CASES: Sequence[tuple[str, str, Mapping[str, Any], int]] = (
    ("whole body, proprioception", "MimoRollover", {}, 1),
    ("whole body, proprioception, 8 copies", "MimoRollover", {}, 8),
    (
        "whole body, all proprioception",
        "MimoRollover",
        {"senses": ["position", "velocity", "limits", "torque", "actuation"]},
        1,
    ),
    (
        "whole body, and vestibular",
        "MimoRollover",
        {"senses": ["position", "velocity", "vestibular"]},
        1,
    ),
    ("whole body, muscles", "MimoRollover", {"actuation": "muscles"}, 1),
    ("hand, 8 copies", "MimoHand", {}, 8),
    ("finger, 8 copies", "MimoFinger", {}, 8),
)
"""Name, world, its parameters, copies."""


def measure(*, steps: int = 400, repetitions: int = 7) -> list[Table]:
    """The world's step against bare `mj_step` from the same state under the same controls."""
    usable = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, usable[:1])
    try:
        rows = [_row(*case, steps, repetitions) for case in CASES]
    finally:
        os.sched_setaffinity(0, usable)
    return [
        Table(
            "A step of the world against bare mj_step, on one core",
            ["", "world us", "mj_step us", "env steps/s", "share that is physics", "spread"],
            rows,
            [
                "CPU time of one environment step (2 physics steps of 5 ms) of one copy; both go through the "
                "same states under the same random controls, in turn",
                f"median of {repetitions} turns of {steps} steps; the share is mj_step over world",
                "muscles: bare mj_step gets each step's last torques of the muscles, whose model is computed "
                "before each physics step",
            ],
        )
    ]


def _row(
    name: str, id: str, parameters: Mapping[str, Any], columns: int, steps: int, repetitions: int
) -> list[str]:
    world = make(id, parameters, columns, 0)
    assert isinstance(world, MujocoWorld)
    actions = np.random.default_rng(1).uniform(-1, 1, (steps, columns, world.action_size)).astype(np.float32)
    world.reset()
    start = [_copied(world.blueprint.model, data) for data in world.copies]
    controls = _recorded(world, start, actions)
    ours, bare = [], []
    for _ in range(repetitions):
        _put_back(world, start)
        ours.append(_cpu_secs(lambda: _act(world, actions)))
        _put_back(world, start)
        bare.append(_cpu_secs(lambda: _replay(world, controls)))
    shares = [b / o for b, o in zip(bare, ours, strict=True)]
    us = [1e6 * median(taken) / (steps * columns) for taken in (ours, bare)]
    spread = f"{min(shares):.2f}-{max(shares):.2f}"
    return [name, f"{us[0]:.1f}", f"{us[1]:.1f}", count(1e6 / us[0]), ratio(median(shares)), spread]


def _recorded(
    world: MujocoWorld, start: Sequence[mujoco.MjData], actions: NDArray[np.float32]
) -> list[list[NDArray[np.float64]]]:
    """The controls that each step left in each copy; for muscles the last of its physics steps."""
    _put_back(world, start)
    controls = []
    for action in actions:
        world.step(action)
        controls.append([data.ctrl.copy() for data in world.copies])
    return controls


def _act(world: MujocoWorld, actions: NDArray[np.float32]) -> None:
    for action in actions:
        world.step(action)


def _replay(world: MujocoWorld, controls: Sequence[Sequence[NDArray[np.float64]]]) -> None:
    model, steps = world.blueprint.model, world.blueprint.physics_steps
    for row in controls:
        for data, control in zip(world.copies, row, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(model, data, steps)


def _copied(model: mujoco.MjModel, data: mujoco.MjData) -> mujoco.MjData:
    kept = mujoco.MjData(model)
    mujoco.mj_copyData(kept, model, data)
    return kept


def _put_back(world: MujocoWorld, start: Sequence[mujoco.MjData]) -> None:
    for data, kept in zip(world.copies, start, strict=True):
        mujoco.mj_copyData(data, world.blueprint.model, kept)


def _cpu_secs(work: Callable[[], None]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began
