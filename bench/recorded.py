"""What a recorded run of the infant reaches of MuJoCo's own rate, with all that belongs to it."""

import os
import time
from collections.abc import Mapping, Sequence
from statistics import median
from typing import Any

import mujoco
import numpy as np

from babble.noise import make_noise
from babble.worlds.physics.world import MujocoWorld
from bench.scene import ROOT, world_of
from bench.tables import Table, count, ratio
from bench.whole_run import WholeRun, whole_run
from services.launcher.study_plan import base_settings, load_plan, settings_of
from services.runtime.settings import RunSettings

STUDY = ROOT / "scenarios" / "table1.toml"
CONDITIONS = ("C5", "C6", "C7", "C8", "C1", "C2", "C3", "C4")
WHO: Mapping[str, Sequence[str]] = {
    "actor": ("actor-0",),
    "recorder": ("recorder",),
    "learners": ("encoder_learner", "policy_learner"),
    "others": ("coordinator", "router"),
}


def measure(
    *,
    steps: int = 50_000,
    raw_steps: int = 2_000,
    repetitions: int = 3,
    conditions: Sequence[str] = CONDITIONS,
) -> list[Table]:
    """Each condition of the coverage study, as real processes on one core, against bare `mj_step`."""
    usable = sorted(os.sched_getaffinity(0))
    os.sched_setaffinity(0, usable[:1])
    try:
        rows = [_row(name, steps, raw_steps, repetitions) for name in conditions]
    finally:
        os.sched_setaffinity(0, usable)
    return [
        Table(
            "A recorded run of the infant against bare mj_step, on one core",
            ["", "mj_step us", "run us", *(f"{who} us" for who in WHO), "share that is physics", "spread"],
            rows,
            [
                "CPU time of all processes from the first phase to the end, for one environment step of one "
                f"copy, evaluations included; {count(steps)} steps, all processes on one core",
                "mj_step: the same body in a lean loop (8 copies, 2 physics steps, the same kind of noise, "
                "the same 100 steps of settling in each 500), before and after each run; for the Composer "
                "the noise with which it babbles",
                f"median of {repetitions} runs; their starts (imports) are not counted",
            ],
        )
    ]


def _row(condition: str, steps: int, raw_steps: int, repetitions: int) -> list[str]:
    settings = _settings(condition, steps)
    raw: list[float] = []
    runs: list[WholeRun] = []
    shares: list[float] = []
    for _ in range(repetitions):
        before = raw_us(settings, raw_steps)
        run = whole_run(settings)
        raw.append((before + raw_us(settings, raw_steps)) / 2)
        runs.append(run)
        shares.append(raw[-1] / _us(run, run.working_cpu_secs))
    parts = [
        median(_us(run, sum(_working_secs(run, name) for name in names)) for run in runs)
        for names in WHO.values()
    ]
    whole = median(_us(run, run.working_cpu_secs) for run in runs)
    numbers = [f"{us:.1f}" for us in (median(raw), whole, *parts)]
    return [condition, *numbers, ratio(median(shares)), f"{min(shares):.2f}-{max(shares):.2f}"]


def _settings(condition: str, steps: int) -> RunSettings:
    plan = load_plan(STUDY)
    one = next(each for each in plan.condition if each.id == condition)
    _, settings = settings_of(plan, base_settings(plan, STUDY), one, steps=steps, actors=1)
    return settings


def raw_us(settings: RunSettings, steps: int) -> float:
    """CPU microseconds of one environment step of one copy, in a loop of nothing but MuJoCo and noise."""
    world = world_of(settings, settings.actors.envs_per_actor)
    assert isinstance(world, MujocoWorld)
    world.reset()
    parameters: Mapping[str, Any] = settings.world.parameters
    model, physics_steps = world.blueprint.model, world.blueprint.physics_steps
    noise = make_noise(
        **settings.babbling.drawn,
        columns=world.columns,
        size=world.action_size,
        rng=np.random.default_rng(0),
    )
    noise.sample()
    rest = [data.qpos.copy() for data in world.copies]
    settle_steps = parameters.get("settle_steps", 100)
    began_secs = time.process_time()
    for step in range(steps):
        controls = np.clip(noise.sample(), -1, 1)
        for data, control, qpos in zip(world.copies, controls, rest, strict=True):
            if step % world.blueprint.episode_steps == 0:
                mujoco.mj_resetData(model, data)
                data.qpos[:] = qpos
                mujoco.mj_step(model, data, settle_steps)
            data.ctrl[:] = control
            mujoco.mj_step(model, data, physics_steps)
    return 1e6 * (time.process_time() - began_secs) / (steps * world.columns)


def _working_secs(run: WholeRun, name: str) -> float:
    by_phase = run.phase_cpu_secs.get(name, {})
    return sum(secs for phase, secs in by_phase.items() if phase != "start")


def _us(run: WholeRun, cpu_secs: float) -> float:
    return 1e6 * cpu_secs / run.recorded_steps
