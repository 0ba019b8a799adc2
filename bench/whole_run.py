"""One whole run of ours as real processes, and the CPU time of each by phase."""

import json
import tempfile
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from babble.recording import Recording
from bench.processes import Child, router, service, wait_for_line
from bench.scene import write_run_folder
from services.runtime.settings import RunSettings

SAMPLE_SECS = 0.02
DEADLINE_SECS = 600.0
START = "start"
TRAINING = ("ground", "practise")
PHASES = ("babble", "encode", "ground", "walk", "refine", "practise", "evaluate", "done")


@dataclass(frozen=True)
class WholeRun:
    """What a run cost."""

    wall_secs: float
    """From the start of the first process to the end of the last but the router."""
    phase_secs: Mapping[str, float]
    """Wall time by phase, summed over the iterations."""
    cpu_secs: Mapping[str, float]
    """By process."""
    phase_cpu_secs: Mapping[str, Mapping[str, float]]
    """By process and phase; `start` until the process is ready (samples every 20 ms, in steps of 10 ms)."""
    peak_mb: Mapping[str, float]
    recorded_steps: int
    """Environment steps in the recording, 0 without one."""

    @property
    def working_cpu_secs(self) -> float:
        """CPU time of all processes in all phases, their starts not counted."""
        return sum(by_phase[phase] for by_phase in self.phase_cpu_secs.values() for phase in PHASES)

    @property
    def training_secs(self) -> float:
        """Wall time of the phases in which the policy is trained."""
        return sum(self.phase_secs[phase] for phase in TRAINING)

    @property
    def training_cpu_secs(self) -> float:
        """CPU time of all processes in these phases, what is left of their starts not counted."""
        return sum(by_phase[phase] for by_phase in self.phase_cpu_secs.values() for phase in TRAINING)


def whole_run(settings: RunSettings) -> WholeRun:
    """Run it over a router of its own. Raises RuntimeError if a process fails or the deadline passes."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_run_folder(folder, settings)
        began = time.time()
        with router(folder) as (endpoint, router_child):
            started = [service(name, folder, endpoint) for name in _services(settings)]
            started += [service("actor", folder, endpoint, index=i) for i in range(settings.actors.count)]
            children = [router_child, *started]
            try:
                samples, peaks = _watch(started, children)
            finally:
                for child in started:
                    child.end()
        wall_secs = samples[-1][0] - began
        phases = _phases(folder / "events.jsonl", samples[-1][0])
        ready = {child.name: _ready_secs(child) for child in started}
        return WholeRun(
            wall_secs=wall_secs,
            phase_secs=_phase_secs(phases),
            cpu_secs={child.name: child.cpu_secs for child in children},
            phase_cpu_secs={
                child.name: _by_phase(child, samples, phases, ready.get(child.name, phases[0][0]))
                for child in children
            },
            peak_mb=peaks,
            recorded_steps=_recorded_steps(folder, settings),
        )


def _services(settings: RunSettings) -> list[str]:
    """Those of which there is one."""
    learners = [] if settings.phases.open_loop else ["encoder_learner", "policy_learner"]
    return ["coordinator", *learners, *(["recorder"] if settings.recording.every_steps else [])]


def _recorded_steps(folder: Path, settings: RunSettings) -> int:
    every_steps = settings.recording.every_steps
    return Recording.open(folder).rows * every_steps if every_steps else 0


Samples = list[tuple[float, dict[str, float]]]
Phases = list[tuple[float, float, str]]


def _watch(started: Sequence[Child], children: Sequence[Child]) -> tuple[Samples, dict[str, float]]:
    """CPU time of all until those that were started have ended."""
    deadline = time.time() + DEADLINE_SECS
    samples: Samples = []
    peaks: dict[str, float] = {}
    while True:
        going = [child for child in started if child.running()]
        for child in children:
            peaks[child.name] = max(child.peak_mb(), peaks.get(child.name, 0.0))
        samples.append((time.time(), {child.name: child.cpu_so_far_secs() for child in children}))
        failed = [child for child in started if child.popen.returncode]
        if failed or time.time() > deadline:
            child = (failed or going)[0]
            raise RuntimeError(
                f"{child.name} did not end well; its log ends with {child.log.read_text()[-2000:]}"
            )
        if not going:
            return samples, peaks
        time.sleep(SAMPLE_SECS)


def _phases(events: Path, ended_secs: float) -> Phases:
    """(begin, end, phase) of each term, by `time.time()`."""
    notes = [json.loads(line) for line in events.read_text().splitlines()]
    begun = [(note["secs"], note["text"].split()[0]) for note in notes if note["what"] == "phase"]
    ends = [*(secs for secs, _ in begun[1:]), ended_secs]
    return [(begin, end, phase) for (begin, phase), end in zip(begun, ends, strict=True)]


def _phase_secs(phases: Phases) -> dict[str, float]:
    return {name: sum(end - begin for begin, end, phase in phases if phase == name) for name in PHASES}


def _by_phase(child: Child, samples: Samples, phases: Phases, ready_secs: float) -> dict[str, float]:
    times = [at for at, _ in samples]
    used = [cpu[child.name] for _, cpu in samples]

    def until(at: float) -> float:
        return float(np.interp(max(at, ready_secs), times, used))

    found = {
        name: sum(until(end) - until(begin) for begin, end, phase in phases if phase == name)
        for name in PHASES
    }
    return {START: until(ready_secs), **found}


def _ready_secs(child: Child) -> float:
    """When its log says that it is ready, by `time.time()`."""
    stamp = wait_for_line(child, "ready in run").split()[0]
    return datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp()
