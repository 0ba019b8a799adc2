"""An environment step with the senses of MIMo but vision: ours against MIMo's own package.

The package is given as a checkout with an interpreter of its pinned versions in `.venv`; see `SETUP`.
"""

import json
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

import mujoco
import numpy as np

from babble.worlds import make
from bench.tables import Table, count, ratio

ROOT = Path(__file__).resolve().parents[1]
SENSES = ("position", "velocity", "limits", "torque", "actuation", "vestibular")
"""What its proprioception and vestibular sense hold."""
SCENE = Path("mimoEnv/assets/benchmark_scene.xml")
BODY = {"joints": ["robot:*"], "actuators": ["act:*"], "touch": {"bodies": ["*", "!test_object*"]}}
"""Of that scene, what is the infant."""
COLUMNS = (1, 8)
WARM_UP_STEPS = 200
ANSWER_SECS = 900.0
PYTHON = Path(".venv/bin/python")
SETUP = (
    "MIMo's own package is measured when its checkout is given with --mimo PATH, in which "
    "`uv venv --python 3.11 .venv` and `uv pip install --python .venv mujoco==2.3.7 gymnasium==0.28.1 "
    "'numpy<2' scipy matplotlib trimesh cachetools CacheToolsUtils networkx rtree imageio "
    "opencv-python-headless` were run"
)

Steps = Callable[[int], float]
"""CPU seconds of at least so many environment steps, per step of one copy."""


@dataclass(frozen=True)
class Contender:
    """Who steps, with touch and without."""

    points: int
    touching: Steps
    numb: Steps


def measure(
    mimo: Path | None = None, *, steps: int = 800, repetitions: int = 7, collapsed: bool = True
) -> list[Table]:
    """The table; `collapsed` adds the package unrepaired, which takes minutes and 3 GB to start.

    Raises FileNotFoundError where the checkout has no interpreter.
    """
    if mimo is not None and not (mimo / PYTHON).exists():
        raise FileNotFoundError(f"there is no {mimo / PYTHON}; {SETUP}")
    usable = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, usable[:1])
    try:
        with ExitStack() as stack:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
            theirs = {} if mimo is None else _theirs(mimo.absolute(), folder, stack, collapsed)
            contenders = {**theirs, **_ours(mimo, folder)}
            return [_table(contenders, *_interleaved(contenders, steps, repetitions), theirs)]
    finally:
        os.sched_setaffinity(0, usable)


def _ours(mimo: Path | None, folder: Path) -> dict[str, Contender]:
    scenes: dict[str, tuple[str, dict[str, Any], Sequence[str]]] = {
        "MimoRollover": ("MimoRollover", {}, SENSES)
    }
    if mimo is not None:
        dense, sparse = (_bare_scene(mimo.absolute() / SCENE, folder, how) for how in ("DENSE", "SPARSE"))
        scenes |= {
            "its scene, its solver": ("Mjcf", {"file": dense, **BODY}, SENSES),
            "its scene": ("Mjcf", {"file": sparse, **BODY}, SENSES),
            "its scene, no proprioception": ("Mjcf", {"file": sparse, **BODY}, ["vestibular"]),
        }
    return {
        f"Babble: {name}, {columns} {'copy' if columns == 1 else 'copies'}": _of_world(*scene, columns)
        for name, scene in scenes.items()
        for columns in COLUMNS
    }


def _bare_scene(scene: Path, folder: Path, jacobian: str) -> str:
    """The scene without textures, which take a gigabyte, and with MuJoCo's own choice of memory."""
    spec = mujoco.MjSpec.from_file(str(scene))
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    spec.nconmax = spec.njmax = spec.nstack = -1
    spec.option.jacobian = getattr(mujoco.mjtJacobian, f"mjJAC_{jacobian}")
    file = str(folder / f"{jacobian}.mjb")
    mujoco.mj_saveModel(spec.compile(), file, None)
    return file


def _of_world(id: str, parameters: Mapping[str, Any], senses: Sequence[str], columns: int) -> Contender:
    touching = make(id, {**parameters, "senses": [*senses, "touch"]}, columns, 0)
    without = {name: value for name, value in parameters.items() if name != "touch"}
    numb = make(id, {**without, "senses": senses}, columns, 0)
    return Contender(touching.senses["touch"][0] // 3, _stepping(touching), _stepping(numb))


def _stepping(world: Any) -> Steps:
    model, rng = world.blueprint.model, np.random.default_rng(0)
    # MIMo's package draws actions within what its motors can do.
    low, high = model.actuator_forcerange.T

    def run(steps: int) -> float:
        rounds = -(-steps // world.columns)
        actions = rng.uniform(low, high, (rounds, world.columns, model.nu)).astype(np.float32)
        began = time.process_time()
        for action in actions:
            step = world.step(action)
            if step.failed is not None:
                world.restart(step.failed)
        return (time.process_time() - began) / (rounds * world.columns)

    world.reset()
    run(WARM_UP_STEPS * world.columns)
    return run


def _theirs(mimo: Path, folder: Path, stack: ExitStack, collapsed: bool) -> dict[str, Contender]:
    _, numb = stack.enter_context(_package(mimo, folder, "off"))
    hows = {"posed": "MIMo's package, points where they belong"}
    if collapsed:
        hows["collapsed"] = "MIMo's package as it is, points of a body on one spot"
    started = {name: stack.enter_context(_package(mimo, folder, how)) for how, name in hows.items()}
    return {name: Contender(points, touching, numb) for name, (points, touching) in started.items()}


@contextmanager
def _package(mimo: Path, folder: Path, how: str) -> Iterator[tuple[int, Steps]]:
    """The package in a process of its own on our core: its number of points, and its steps."""
    log = folder / f"{how}.log"
    with log.open("wb") as errors:
        process = subprocess.Popen(
            [mimo / PYTHON, ROOT / "bench" / "mimo_package.py", how],
            cwd=folder,
            env={**os.environ, "PYTHONPATH": str(mimo), "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            text=True,
        )

    def run(steps: int) -> float:
        assert process.stdin is not None
        process.stdin.write(f"{steps}\n")
        process.stdin.flush()
        return _answer(process, log)["cpu_secs"] / steps

    try:
        yield int(_answer(process, log)["points"]), run
    finally:
        process.kill()
        process.communicate()


def _answer(process: "subprocess.Popen[str]", log: Path) -> dict[str, float]:
    """Its next line of JSON; what the package itself prints is passed over."""
    assert process.stdout is not None
    alarm = threading.Timer(ANSWER_SECS, process.kill)
    alarm.start()
    try:
        for line in process.stdout:
            if line.startswith("{"):
                answer: dict[str, float] = json.loads(line)
                return answer
    finally:
        alarm.cancel()
    raise RuntimeError(f"MIMo's package ended without an answer; it said {log.read_text()[-2000:]}")


def _interleaved(
    contenders: Mapping[str, Contender], steps: int, repetitions: int
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Each in turn, again and again: seconds per step with touch and without."""
    touching: dict[str, list[float]] = {name: [] for name in contenders}
    numb: dict[str, list[float]] = {name: [] for name in contenders}
    for _ in range(repetitions):
        for name, contender in contenders.items():
            touching[name].append(contender.touching(steps))
            numb[name].append(contender.numb(steps))
    return touching, numb


def _table(
    contenders: Mapping[str, Contender],
    touching: Mapping[str, Sequence[float]],
    numb: Mapping[str, Sequence[float]],
    theirs: Mapping[str, Contender],
) -> Table:
    rows = []
    repaired = next(iter(theirs), None)
    for name, contender in contenders.items():
        cells = [count(contender.points), *(f"{1e3 * median(part[name]):.3f}" for part in (touching, numb))]
        if repaired is not None:
            ratios = [a / b for a, b in zip(touching[repaired], touching[name], strict=True)]
            cells += [ratio(median(ratios)), f"{min(ratios):.2f}-{max(ratios):.2f}"]
        rows.append([name, *cells])
    columns = ["", "points", "ms/step", "without touch", "the package takes", "spread"]
    notes = [
        "CPU time of one environment step (2 physics steps) of one copy; median of "
        f"{len(next(iter(touching.values())))} interleaved repetitions",
        "its solver: with a dense Jacobian, as its file says; all others of ours with a sparse one",
    ]
    if theirs:
        notes.append(
            "the package takes: its CPU time, with points where they belong, over that of the row, "
            "repetition by repetition; it runs in its pinned versions (MuJoCo 2.3.7), ours on MuJoCo "
            f"{mujoco.__version__}"
        )
    return Table(
        "A step of the infant with proprioception, vestibular sense and full touch, on one core",
        columns if theirs else columns[:4],
        rows,
        notes if theirs else [*notes, SETUP],
    )
