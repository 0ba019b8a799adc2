"""How fast one actor collects on one core, against the bare world and SB3's own collecting, shown or not."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from statistics import median

import torch

from bench.actor_process import over_zenoh
from bench.contenders import ACTOR, Contender, InProcess, Took, contenders_of
from bench.scene import ROOT, cuboid
from bench.shares import shares_of
from bench.tables import Table, count, ratio
from services.runtime.settings import RunSettings, ViewSettings, load

COLUMNS = (8, 32)
"""Copies of the world: as shipped, and more."""
SHOWN = ("cuboid", "finger")
"""Scenarios in which an actor is measured with and without its views."""
UNSEEN = ViewSettings(latents_per_sec=0, poses_per_sec=0, images_per_sec=0)


def measure(*, steps: int = 40_960, repetitions: int = 7, process_secs: float = 5.0) -> list[Table]:
    """Speeds for each number of copies, the shares of the actor's step as shipped, and what views cost."""
    torch.set_num_threads(1)
    usable = sorted(os.sched_getaffinity(0))
    tables = []
    for columns in COLUMNS:
        settings = cuboid(actors={"envs_per_actor": columns})
        with one_core(usable):
            contenders = contenders_of(settings)
            tooks = interleaved(contenders, steps, repetitions)
        wire = over_zenoh(settings, usable, process_secs)
        tables.append(_speeds(settings, tooks, wire))
    with one_core(usable):
        tables.append(shares_of(contenders_of(cuboid())[ACTOR], steps))
        tables.append(_showing(steps, repetitions))
    return tables


@contextmanager
def one_core(usable: Sequence[int]) -> Iterator[None]:
    """On the first of the usable cores."""
    os.sched_setaffinity(0, usable[:1])
    try:
        yield
    finally:
        os.sched_setaffinity(0, usable)


def interleaved(contenders: dict[str, Contender], steps: int, repetitions: int) -> dict[str, list[Took]]:
    """Each contender in turn, again and again, so that a slow moment of the machine hits all of them."""
    for contender in contenders.values():
        contender(steps // 8)
    tooks: dict[str, list[Took]] = {name: [] for name in contenders}
    for _ in range(repetitions):
        for name, contender in contenders.items():
            tooks[name].append(contender(steps))
    return tooks


def _speeds(settings: RunSettings, tooks: dict[str, list[Took]], wire: tuple[float, float]) -> Table:
    actor = [took.steps / took.cpu_secs for took in tooks[ACTOR]]
    rows = []
    for name, taken in tooks.items():
        by_cpu = [took.steps / took.cpu_secs for took in taken]
        by_wall = [took.steps / took.wall_secs for took in taken]
        ratios = [a / b for a, b in zip(actor, by_cpu, strict=True)]
        speeds = [count(median(by_wall)), count(median(by_cpu))]
        rows.append([name, *speeds, ratio(median(ratios)), f"{min(ratios):.2f}-{max(ratios):.2f}"])
    rows.append(["actor process over Zenoh", *map(count, wire), ratio(median(actor) / wire[1]), ""])
    return Table(
        f"Collecting with {settings.actors.envs_per_actor} worlds on one core",
        ["", "steps/s", "steps/CPU s", "the actor is", "spread"],
        rows,
        [
            f"median of {len(actor)} interleaved repetitions; ratios by CPU time, repetition by repetition",
            "the actor leaves the critic's values to the learner, which computes a whole rollout's at once; "
            "SB3 computes them while it collects, step by step",
        ],
    )


def _showing(steps: int, repetitions: int) -> Table:
    """Speeds of the actor whose pose is shown, and of one that shows nothing."""
    rows = []
    for scenario in SHOWN:
        settings = load(ROOT / "scenarios" / f"{scenario}.toml")
        contenders: dict[str, Contender] = {
            "shown": InProcess(settings),
            "unseen": InProcess(settings.model_copy(update={"view": UNSEEN})),
        }
        tooks = interleaved(contenders, steps, repetitions)
        speeds = {name: [took.steps / took.cpu_secs for took in taken] for name, taken in tooks.items()}
        ratios = [a / b for a, b in zip(speeds["shown"], speeds["unseen"], strict=True)]
        found = [count(median(speeds[name])) for name in contenders]
        rows.append([scenario, *found, ratio(median(ratios)), f"{min(ratios):.2f}-{max(ratios):.2f}"])
    return Table(
        "What an actor's views cost, at the usual rates",
        ["", "shown, steps/CPU s", "unseen, steps/CPU s", "shown is", "spread"],
        rows,
        [
            f"median of {repetitions} interleaved repetitions, by CPU time, on the memory bus; "
            "the actor is one that shows its pose too",
        ],
    )
