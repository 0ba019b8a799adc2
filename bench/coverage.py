"""What the metrics of coverage cost: `coverage()` of three clouds, each in a process of its own."""

import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bench.tables import Table, secs

ROOT = Path(__file__).resolve().parents[1]
"""Not from `bench.scene`, whose imports would count as memory of the metrics."""
DIMS = 98
PATIENCE_SECS = 600.0
CLOUDS = {
    "like a body's": "principal axes whose deviation falls e-fold in 12 axes, with heavy tails",
    "ball": "98 equal normal axes: the furthest pair cannot be proven",
    "disc": "2 axes: most rows stay candidates of greedy k-centre, its worst case",
}


def measure(*, rows: int = 1_000_000) -> list[Table]:
    """The table of all clouds of so many rows."""
    found = [_in_own_process(name, rows) for name in CLOUDS]
    parts = list(found[0]["parts"])
    body = [
        [name, *(secs(one["parts"][part]) for part in parts), secs(one["all"]), f"{one['peak_mb']:.0f}"]
        for name, one in zip(CLOUDS, found, strict=True)
    ]
    return [
        Table(
            f"Coverage of {rows:,} x {DIMS} float32, CPU seconds",
            ["cloud", *parts, "all", "peak MB"],
            body,
            [
                *(f"{name}: {what}" for name, what in CLOUDS.items()),
                "dimensions: with importing scikit-dimension, some 7 s, once per process",
                f"peak: VmHWM after all, in 10^6 bytes; the cloud itself is {rows * DIMS * 4 / 1e6:.0f}",
            ],
        )
    ]


def _in_own_process(name: str, rows: int) -> dict[str, Any]:
    done = subprocess.run(
        [sys.executable, "-m", "bench.coverage", name, str(rows)],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=PATIENCE_SECS,
        check=False,
    )
    if done.returncode:
        raise RuntimeError(f"the coverage of {name!r} failed: {done.stderr[-2000:]}")
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def _cloud(name: str, rows: int) -> NDArray[np.float32]:
    rng = np.random.default_rng(0)
    axes, _ = np.linalg.qr(rng.standard_normal((DIMS, DIMS)))
    deviations = {
        "like a body's": 5 * np.exp(-np.arange(DIMS) / 12),
        "ball": np.ones(DIMS),
        "disc": 10.0 * (np.arange(DIMS) < 2),
    }[name]
    mixing = (axes * deviations).astype(np.float32)
    states = np.empty((rows, DIMS), np.float32)
    for first in range(0, rows, 10_000):
        drawn = rng.standard_normal((min(10_000, rows - first), DIMS)).astype(np.float32)
        if name == "like a body's":
            drawn *= np.exp(0.3 * rng.standard_normal((len(drawn), 1))).astype(np.float32)
        states[first : first + len(drawn)] = (np.sin(drawn) if name == "disc" else drawn) @ mixing.T
    return states


def _measured(name: str, rows: int) -> dict[str, Any]:
    from babble.coverage import insertion_distances, spread_rows, visited_cells_entropy
    from babble.coverage_diameter import diameter
    from babble.coverage_neighbours import dimensions
    from babble.coverage_passes import moments

    states = _cloud(name, rows)
    known = moments(states)
    steps: dict[str, Callable[[], object]] = {
        "moments": lambda: moments(states),
        "diameter": lambda: diameter(states, known),
        "centres": lambda: insertion_distances(states, known.mean.astype(np.float32), 100),
        "dimensions": lambda: dimensions(states[spread_rows(rows, 6000)]),
        "cells": lambda: visited_cells_entropy(states),
    }
    parts: dict[str, float] = {}
    for part, step in steps.items():
        began = time.process_time()
        step()
        parts[part] = time.process_time() - began
    return {"parts": parts, "all": sum(parts.values()), "peak_mb": _peak_mb()}


def _peak_mb() -> float:
    """Most resident memory of this process; its ru_maxrss would count the parent's, which imports torch."""
    with open("/proc/self/status", encoding="utf-8") as lines:
        return next(int(line.split()[1]) for line in lines if line.startswith("VmHWM")) * 1024 / 1e6


if __name__ == "__main__":
    print(json.dumps(_measured(sys.argv[1], int(sys.argv[2]))))
