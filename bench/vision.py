"""What it costs to see: two eyes of the infant on a floor, against `mujoco.Renderer` used plainly."""

import importlib
import os
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from statistics import median
from typing import Any

import mujoco
import mujoco.rendering.classic.gl_context as mujoco_gl
import numpy as np

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import load
from babble.worlds.mimo.scenes import add_floor, place, set_angles
from babble.worlds.senses.vision import Vision
from bench.tables import Table, count, ratio

EYES = ("eye_left", "eye_right")
RESOLUTIONS = (32, 64, 256)
PHYSICS_STEPS = 2
"""of 5 ms in one step of the environment"""
SETTLE_STEPS = 100
OURS = "Vision"

Contender = Callable[[mujoco.MjData], Any]
"""Makes the images of both eyes."""


def measure(
    *, steps: int = 20, repetitions: int = 7, resolutions: Sequence[int] = RESOLUTIONS
) -> list[Table]:
    """One table for each resolution, and what seeing adds to a process."""
    usable = os.sched_getaffinity(0)
    os.sched_setaffinity(0, sorted(usable)[:1])
    try:
        tables = [_at(pixels, steps, repetitions) for pixels in resolutions]
    finally:
        os.sched_setaffinity(0, usable)
    return [*tables, _footprint(repetitions)]


def sitting() -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The infant with mittens, sat down on a floor."""
    spec = infant(load("mitten"))
    add_floor(spec)
    angles = place(spec, "sitting")
    model = spec.compile()
    data = mujoco.MjData(model)
    set_angles(model, data, angles)
    mujoco.mj_step(model, data, SETTLE_STEPS)
    return model, data


def _at(pixels: int, steps: int, repetitions: int) -> Table:
    model, data = sitting()
    contenders: dict[str, Contender] = {
        OURS: _ours(model, pixels),
        "Vision, both eyes blurred": _ours(model, pixels, blur_sigma_px=2.5),
        "Vision, one eye closed": _ours(model, pixels, closed_eyes=["eye_left"]),
        "Vision, with shadows": _ours(model, pixels, shadows=True),
        "mujoco.Renderer, its shadows and mirrors off": _theirs(model, pixels, is_bare=True),
        "mujoco.Renderer": _theirs(model, pixels, is_bare=False),
    }
    physics_ms: list[float] = []
    millis: dict[str, list[float]] = {name: [] for name in contenders}
    for contender in contenders.values():
        contender(data)
    for _ in range(repetitions):
        for name, contender in contenders.items():
            drawn = 0.0
            for _ in range(steps):
                begin = time.process_time()
                mujoco.mj_step(model, data, PHYSICS_STEPS)
                stepped = time.process_time()
                contender(data)
                drawn += time.process_time() - stepped
                physics_ms.append(1e3 * (stepped - begin))
            millis[name].append(1e3 * drawn / steps)
    return _table(pixels, millis, median(physics_ms))


def _table(pixels: int, millis: dict[str, list[float]], physics_ms: float) -> Table:
    rows = []
    for name, taken in millis.items():
        ratios = [theirs / ours for theirs, ours in zip(taken, millis[OURS], strict=True)]
        spread = f"{min(ratios):.2f}-{max(ratios):.2f}"
        rows.append([name, f"{median(taken):.2f}", ratio(median(ratios)), spread])
    return Table(
        f"Two eyes of {pixels} x {pixels} pixels",
        ["", "CPU ms per step", "against Vision", "spread"],
        rows,
        [
            f"median of {len(millis[OURS])} interleaved repetitions on one core; "
            f"{PHYSICS_STEPS} steps of the physics took {physics_ms:.2f} ms",
            f"drawn by {_backend()}",
        ],
    )


def _ours(model: mujoco.MjModel, pixels: int, **options: Any) -> Contender:
    vision = Vision(model, resolution=pixels, **options)
    return lambda data: vision.read([data])


def _theirs(model: mujoco.MjModel, pixels: int, *, is_bare: bool) -> Contender:
    """`mujoco.Renderer` with the backend that ours has found: it chooses only when mujoco is imported."""
    mujoco_gl.GLContext = _backend_module().GLContext
    renderer = mujoco.Renderer(model, height=pixels, width=pixels)
    if is_bare:
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = False
        renderer.scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = False

    def images(data: mujoco.MjData) -> list[Any]:
        seen = []
        for eye in EYES:
            renderer.update_scene(data, eye)
            seen.append(renderer.render())
        return seen

    return images


def _backend_module() -> Any:
    model, data = sitting()
    Vision(model, resolution=1).read([data])
    return importlib.import_module(f"mujoco.{_backend()}")


def _backend() -> str:
    return next(name for name in ("egl", "osmesa") if f"mujoco.{name}" in sys.modules)


CHILD = """
import time, psutil
from bench.vision import sitting
from babble.worlds.senses.vision import Vision
model, data = sitting()
vision = Vision(model, resolution=64)
bytes_before, secs_before = psutil.Process().memory_info().rss, time.process_time()
vision.read([data])
print(psutil.Process().memory_info().rss - bytes_before, time.process_time() - secs_before)
"""


def _footprint(repetitions: int) -> Table:
    """Fresh processes: what the first image takes."""
    taken = []
    for _ in range(repetitions):
        done = subprocess.run([sys.executable, "-c", CHILD], capture_output=True, text=True, check=True)
        taken.append([float(value) for value in done.stdout.split()])
    megabytes, secs = np.median(taken, axis=0) / (1e6, 1)
    return Table(
        "What the first image takes (two eyes of 64 x 64)",
        ["", "MB", "CPU s"],
        [["OpenGL, its driver and the model's shapes", count(megabytes), f"{secs:.2f}"]],
    )
