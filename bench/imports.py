"""What a process imports, and what that costs (`python -X importtime`)."""

import os
import re
import statistics
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

from bench.bytecode import OPTIMISER, first_start
from bench.scene import ROOT
from bench.tables import Table, secs

LINE = re.compile(r"import time:\s+(\d+) \|\s+\d+ \|\s+(\S+)")
SERVICES = ("router", "coordinator", "actor", "encoder_learner", "policy_learner")
NAMED = ("torch", "stable_baselines3", "onnx", "onnxruntime", "gymnasium", "numpy", "pydantic", "zenoh")
STARTS = {
    "Python": "pass",
    "import numpy": "import numpy",
    "import onnxruntime": "import onnxruntime",
    "import torch": "import torch",
    "import torch, a first optimiser": OPTIMISER,
    "import stable_baselines3 (and torch)": "import stable_baselines3",
}
OURS = ("protocol", "babble", "services")


@dataclass(frozen=True)
class Imports:
    """The imports of one process."""

    cpu_secs: float
    """From exec to exit, without the tracing."""
    micros: Counter[str]
    """Microseconds of wall time by top-level package, each without what it imports in turn."""

    def has(self, package: str) -> bool:
        """True if anything of the package was imported."""
        return package in self.micros


def imports_of(service: str) -> Imports:
    """What `python -m services.<service>` imports until it runs. Raises RuntimeError if that fails."""
    shell = "services.runtime.process, services.runtime.zenoh_bus"
    statement = f"import services.{service}.service, {shell}"
    traced = _python("-X", "importtime", "-c", statement)
    found: Counter[str] = Counter()
    for micros, module in LINE.findall(traced):
        found[module.partition(".")[0]] += int(micros)
    return Imports(cpu_secs=cpu_secs_of(statement), micros=found)


def cpu_secs_of(statement: str) -> float:
    """User and system time of a Python that does just this, from exec to exit."""
    before = os.times()
    _python("-c", statement)
    after = os.times()
    return after.children_user + after.children_system - before.children_user - before.children_system


def imports_table(services: Sequence[str] = SERVICES) -> Table:
    """Per service, CPU seconds in all and traced seconds by package."""
    rows = []
    for service in services:
        found = imports_of(service)
        named = [found.micros[package] for package in NAMED]
        ours = sum(found.micros[package] for package in OURS)
        rest = found.micros.total() - sum(named) - ours
        cells = [secs(value / 1e6) if value else "-" for value in (*named, ours, rest)]
        rows.append([service, secs(found.cpu_secs), *cells, "yes" if found.has("torch") else "no"])
    return Table(
        "Imports",
        ["", "CPU s", *NAMED, "ours", "other", "torch?"],
        rows,
        ["CPU s: exec to exit, untraced; the others: seconds under -X importtime, which slows imports down"],
    )


def starts_table(repetitions: int = 3) -> Table:
    """What the first use of a library costs a process."""
    rows = []
    for name, statement in STARTS.items():
        costs = [cpu_secs_of(statement) for _ in range(repetitions)]
        with first_start():
            first = cpu_secs_of(statement)
        rows.append([name, secs(statistics.median(costs)), f"{min(costs):.2f}-{max(costs):.2f}", secs(first)])
    notes = [
        f"median of {repetitions}, exec to exit; the first start also compiles what it imports",
        "the first optimiser of torch.optim imports torch's compiler",
    ]
    return Table("What a start costs", ["", "CPU s", "spread", "first start CPU s"], rows, notes)


def _python(*arguments: str) -> str:
    done = subprocess.run(
        [sys.executable, *arguments],
        cwd=ROOT,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
    )
    if done.returncode:
        raise RuntimeError(f"importing failed: {done.stderr[-2000:]}")
    return done.stderr
