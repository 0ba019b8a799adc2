"""Runs that are recorded, in one process: every environment step once, whoever crashes."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.recording import Recording
from protocol.messages import Phase, Segment
from services.recorder.service import build
from services.runtime.settings import RunSettings, parse
from tests.simulated import harness
from tests.simulated.harness import Simulation

STEPS = 16
COLUMNS = 4
WANTED = 8_000


@pytest.fixture(autouse=True)
def _with_a_recorder(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(harness.BUILDERS, "recorder", build)


def open_loop(**recording: Any) -> RunSettings:
    """An open loop of the cuboid in small pieces."""
    return parse(
        {
            "scenario": "recorded", "seed": 5,
            "actors": {"segment_steps": STEPS, "envs_per_actor": COLUMNS},
            "phases": {"open_loop": True, "babble_steps": WANTED},
            "recording": {"every_steps": 1, "group_rows": 1024} | recording,
        },
        origin="test",
    )  # fmt: skip


def start(run: Simulation, actors: int) -> None:
    """An open loop has no learners."""
    run.start("coordinator", "coordinator-0")
    run.start("recorder", "recorder-0")
    for index in range(actors):
        run.start("actor", f"actor-{index}", index)


def sent(run: Simulation) -> int:
    """Environment steps in different segments that went to the recorder so far."""
    return sum(sum(steps.values()) for (to, _, _), steps in run.sent_steps.items() if to == "recorder")


def check_whole(run_dir: Path) -> Recording:
    """Every row once, and none missing between others."""
    recording = Recording.open(run_dir)
    audit = recording.audit()
    assert (audit.duplicates, audit.gaps) == (0, 0)
    assert audit.rows >= WANTED
    assert np.isfinite(recording.states()).all()
    return recording


def test_an_open_loop_is_recorded_and_ends(tmp_path: Path) -> None:
    run = Simulation(open_loop(), tmp_path)
    start(run, 2)
    run.until_all_ended()
    recording = check_whole(tmp_path)
    assert recording.rows - WANTED < STEPS * COLUMNS
    sent = run.segments(Phase.BABBLE)
    assert {segment.consumer for segment in sent} == {"recorder"}
    assert recording.rows == sum(segment.steps for segment in unique(sent)) * COLUMNS


def test_whoever_crashes_no_step_is_missing_or_counted_twice(tmp_path: Path) -> None:
    run = Simulation(open_loop(), tmp_path)
    start(run, 2)
    run.until(lambda: sent(run) > WANTED // 4)
    run.crash("recorder-0")
    for _ in range(20):
        run.round()
    run.start("recorder", "recorder-1")
    run.until(lambda: sent(run) > WANTED // 2)
    run.crash("actor-1")
    run.start("actor", "actor-2", 1)
    run.until_all_ended()
    audit = check_whole(tmp_path).audit()
    assert set(audit.actors) == {"actor-0", "actor-1", "actor-2"}


def test_every_third_step_is_recorded_and_the_run_is_as_long(tmp_path: Path) -> None:
    run = Simulation(open_loop(every_steps=3), tmp_path)
    start(run, 2)
    run.until_all_ended()
    audit = Recording.open(tmp_path).audit()
    assert (audit.duplicates, audit.gaps) == (0, 0)
    assert 0 <= 3 * audit.rows - WANTED < 3 * STEPS * COLUMNS * 3


def unique(segments: list[Segment]) -> list[Segment]:
    """Without those that were sent again."""
    return list({(segment.life, segment.seq): segment for segment in segments}.values())
