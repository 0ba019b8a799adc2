"""A whole run of ours on two cores against Stable-Baselines3 training the same policy."""

import json
import os
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import astuple, dataclass
from pathlib import Path
from statistics import median

from bench.bytecode import first_start
from bench.imports import imports_table, starts_table
from bench.processes import start
from bench.scene import cuboid
from bench.tables import Table, count, ratio, secs
from bench.whole_run import PHASES, START, WholeRun, whole_run
from services.runtime.settings import RunSettings

CORES = 2
RIVALS: Mapping[str, tuple[int, str]] = {
    "SB3 SubprocVecEnv, 16 workers, fork": (16, "fork"),
    "SB3 SubprocVecEnv, 16 workers, forkserver (its default)": (16, "forkserver"),
    "SB3 SubprocVecEnv, 2 workers, fork": (2, "fork"),
    "SB3 DummyVecEnv of 16, one process": (16, "one-process"),
}
"""Copies of the world, and how their processes start; a rollout has the same number of steps in all."""
OURS = "Babble, all phases, 2 actors"
FIRST = "the same, first start after an installation"


@dataclass(frozen=True)
class Cost:
    """Seconds of the whole, and of the training of the policy alone."""

    wall_secs: float
    cpu_secs: float
    training_secs: float
    training_cpu_secs: float


def measure(
    *, repetitions: int = 3, iterations: int | None = None, rivals: Sequence[str] = tuple(RIVALS)
) -> list[Table]:
    """The tables; `iterations` replaces the scenario's number of rounds."""
    given = cuboid()
    phases = (
        given.phases if iterations is None else given.phases.model_copy(update={"iterations": iterations})
    )
    settings = cuboid(phases=phases.model_dump(), actors={"count": 2})
    usable = sorted(os.sched_getaffinity(0))
    runs: list[WholeRun] = []
    firsts: list[WholeRun] = []
    costs: dict[str, list[Cost]] = {name: [] for name in rivals}
    try:
        os.sched_setaffinity(0, usable[:CORES])
        for _ in range(repetitions):
            runs.append(whole_run(settings))
            with first_start():
                firsts.append(whole_run(settings))
            for name in rivals:
                costs[name].append(_sb3(settings, *RIVALS[name]))
    finally:
        os.sched_setaffinity(0, usable)
    chosen = sorted(runs, key=lambda run: run.wall_secs)[len(runs) // 2]
    costs = {FIRST: list(map(_cost, firsts)), **costs}
    return [_ratios(settings, list(map(_cost, runs)), costs), _where(chosen), imports_table(), starts_table()]


def _rollouts(settings: RunSettings) -> int:
    rollout = settings.actors.segment_steps * settings.policy.rollout_columns
    ground, practise = (
        -(-n // rollout) for n in (settings.phases.ground_steps, settings.phases.practise_steps)
    )
    return ground + settings.phases.iterations * practise


def _sb3(settings: RunSettings, number: int, how: str) -> Cost:
    with tempfile.TemporaryDirectory() as name:
        given = ["--copies", str(number), "--how", how, "--rollouts", str(_rollouts(settings))]
        child = start("sb3", Path(name), "-m", "bench.sb3_run", *given)
        code = child.popen.wait()
        wall_secs = time.monotonic() - child.started_secs
        said = child.log.read_text()
    if code:
        raise RuntimeError(f"Stable-Baselines3 failed: {said[-2000:]}")
    found = json.loads(said.splitlines()[-1])
    return Cost(wall_secs, found["cpu_secs"], found["learn_secs"], found["learn_cpu_secs"])


def _cost(run: WholeRun) -> Cost:
    return Cost(run.wall_secs, sum(run.cpu_secs.values()), run.training_secs, run.training_cpu_secs)


def _ratios(settings: RunSettings, ours: Sequence[Cost], costs: Mapping[str, Sequence[Cost]]) -> Table:
    rows = []
    for name, theirs in {OURS: ours, **costs}.items():
        cells = [secs(median(column)) for column in zip(*map(astuple, theirs), strict=True)]
        over = [
            [b / a for a, b in zip(astuple(x), astuple(y), strict=True)]
            for x, y in zip(ours, theirs, strict=True)
        ]
        ratios = [ratio(median(column)) for column in zip(*over, strict=True)]
        rows.append([name, *(cell for pair in zip(cells, ratios, strict=True) for cell in pair)])
    policy, rollouts = settings.policy, _rollouts(settings)
    rollout = settings.actors.segment_steps * policy.rollout_columns
    gradient_steps = rollouts * policy.epochs * -(-rollout // policy.minibatch)
    names = ["wall s", "CPU s", "training wall s", "training CPU s"]
    return Table(
        f"End to end on {CORES} cores",
        ["", *(cell for name in names for cell in (name, "ratio"))],
        rows,
        [
            f"median of {len(ours)}; a ratio is theirs over ours, so above 1 ours is faster or cheaper",
            f"all train for the same {count(rollouts * rollout)} environment steps "
            f"and {gradient_steps} gradient steps of PPO",
            "ours also babbles, fits the encoder, walks, scores and checkpoints; SB3 is given an encoder",
            "training: GROUND and PRACTISE of all our processes, learn() of SB3; without the starts",
        ],
    )


def _where(run: WholeRun) -> Table:
    names = [START, *PHASES]
    rows = [
        [
            name,
            *(secs(by_phase[phase]) for phase in names),
            secs(run.cpu_secs[name]),
            f"{run.peak_mb[name]:.0f}",
        ]
        for name, by_phase in run.phase_cpu_secs.items()
    ]
    sums = [sum(by_phase[phase] for by_phase in run.phase_cpu_secs.values()) for phase in names]
    total = sum(run.cpu_secs.values())
    rows.append(["all processes", *map(secs, sums), secs(total), f"{sum(run.peak_mb.values()):.0f}"])
    rows.append(["share", *(f"{part / total:.0%}" for part in sums), "100%", ""])
    walls = [secs(run.phase_secs[phase]) for phase in PHASES]
    rows.append(["wall s", "", *walls, secs(run.wall_secs), ""])
    return Table(
        "Where our CPU seconds go (the run of median wall time)",
        ["", *names, "all", "peak MB"],
        rows,
        [
            "start: each process until it is ready, whatever the phase; babble waits for the learners",
            "all may exceed the sum: a process that ends is last seen up to 20 ms before",
        ],
    )
