"""`python -m bench [WHAT...] [--markdown] [--quick] [--mimo CHECKOUT]`."""

import argparse
import os
import platform
from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"

from bench import actor, coverage, dashboard, end_to_end, footprint, physics, recorded, touch, tree, vision
from bench.bytecode import compiled
from bench.tables import Table

Measure = Callable[[Path | None], list[Table]]
BENCHMARKS: Mapping[str, tuple[Measure, Measure]] = {
    "actor": (
        lambda _: actor.measure(),
        lambda _: actor.measure(steps=4096, repetitions=2, process_secs=2.0),
    ),
    "coverage": (
        lambda _: coverage.measure(),
        lambda _: coverage.measure(rows=20_000),
    ),
    "dashboard": (
        lambda _: dashboard.measure(),
        lambda _: dashboard.measure(periods=1, period_secs=2.0, actors=2),
    ),
    "end_to_end": (
        lambda _: end_to_end.measure(),
        lambda _: end_to_end.measure(repetitions=1, iterations=0, rivals=list(end_to_end.RIVALS)[:1]),
    ),
    "footprint": (
        lambda _: footprint.measure(),
        lambda _: footprint.measure(repetitions=1, segments=10),
    ),
    "physics": (
        lambda _: physics.measure(),
        lambda _: physics.measure(steps=20, repetitions=1),
    ),
    "recorded": (
        lambda _: recorded.measure(),
        lambda _: recorded.measure(steps=4096, raw_steps=64, repetitions=1, conditions=("C5", "C1")),
    ),
    "touch": (
        touch.measure,
        lambda mimo: touch.measure(mimo, steps=80, repetitions=1, collapsed=False),
    ),
    "tree": (
        lambda _: tree.measure(),
        lambda _: tree.measure(steps=2048, repetitions=2),
    ),
    "vision": (
        lambda _: vision.measure(),
        lambda _: vision.measure(steps=2, repetitions=1, resolutions=(32,)),
    ),
}
"""Each as it is, and quickly, to see that it works; given a checkout of MIMo, or None."""
PACKAGES = ("torch", "stable_baselines3", "onnxruntime", "numpy", "gymnasium", "mujoco", "eclipse-zenoh")


def main() -> None:
    """Run what was asked for and print its tables."""
    parser = argparse.ArgumentParser(prog="python -m bench", description=__doc__)
    parser.add_argument(
        "what", nargs="*", metavar="WHAT", help=f"any of {', '.join(BENCHMARKS)} (default: all)"
    )
    parser.add_argument("--markdown", action="store_true", help="print tables for docs/benchmarks.md")
    parser.add_argument("--quick", action="store_true", help="see that it works; the numbers mean nothing")
    parser.add_argument(
        "--mimo", type=Path, metavar="CHECKOUT", help="of MIMo's own package with its .venv, for touch"
    )
    given = parser.parse_args()
    if unknown := [name for name in given.what if name not in BENCHMARKS]:
        parser.error(f"there is no benchmark {unknown[0]!r}; choose from {', '.join(BENCHMARKS)}")
    print(_here(), end="\n\n", flush=True)
    with compiled():
        for name in given.what or BENCHMARKS:
            for table in BENCHMARKS[name][given.quick](given.mimo):
                print(table.markdown() if given.markdown else table.plain(), flush=True)


def _here() -> str:
    """When, where and with what, in one line."""
    cores = len(os.sched_getaffinity(0))
    load = os.getloadavg()[0]
    packages = ", ".join(f"{name} {version(name)}" for name in PACKAGES)
    when = datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC")
    python = platform.python_version()
    return f"{when}; {_processor()}, {cores} cores, load {load:.2f}; Python {python}, {packages}"


def _processor() -> str:
    try:
        with open("/proc/cpuinfo", encoding="utf-8") as lines:
            return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.machine()


if __name__ == "__main__":
    main()
