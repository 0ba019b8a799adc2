"""Killed with -9 at bad moments, a run of real processes completes, and no experience counts twice."""

import json
import random
from pathlib import Path

import pytest

from tests.processes.distributed import RUN_SECS, DistributedRun
from tests.processes.owned import Owner, wait_for

pytestmark = pytest.mark.processes

PHASES = ["babble", "encode", "ground", "evaluate", "walk", "refine", "practise"]


def test_an_actor_killed_in_each_phase_is_replaced_and_both_ends_are_reached(
    owner: Owner, tmp_path: Path
) -> None:
    run = DistributedRun(owner, tmp_path)
    run.start_all(actors=3)
    for number, phase in enumerate(PHASES):
        run.wait_for_phase(phase)
        victim = f"actor-{number % 3}"
        run.kill(victim)
        run.start(victim)
    run.end()
    assert len([text for text in run.events("lost") if "actor" in text]) >= len(PHASES)
    run.assert_reached_both_ends()
    run.assert_nothing_lost_or_counted_twice()


def test_coordinator_learners_and_router_each_killed_once_and_both_ends_are_reached(
    owner: Owner, tmp_path: Path
) -> None:
    run = DistributedRun(owner, tmp_path)
    run.start_all(actors=2)
    run.wait_for_phase("babble")
    run.kill("coordinator")
    run.start("coordinator")
    run.wait_for_phase("encode")
    run.kill("encoder_learner")
    run.start("encoder_learner")
    run.wait_for_phase("ground")
    run.kill("policy_learner")
    run.start("policy_learner")
    run.wait_for_phase("walk")
    run.router.kill()
    run.router.start_again()
    run.end()
    run.assert_reached_both_ends()
    run.assert_nothing_lost_or_counted_twice()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(3))
def test_everything_killed_at_a_random_moment_is_resumed_to_both_ends(
    owner: Owner, tmp_path: Path, seed: int
) -> None:
    moment = random.Random(seed)
    folder = tmp_path / "run"
    arguments = ("-m", "services.launcher", "up", "--no-dashboard")
    first = owner.start("babble", *arguments, "cuboid", "--seed", str(seed), "--run-dir", str(folder))
    phase, further_events = moment.choice(PHASES), moment.randrange(4)

    def lines(name: str) -> list[str]:
        path = folder / name
        return path.read_text().splitlines() if path.exists() else []

    wait_for(phase, lambda: any(phase in line for line in lines("events.jsonl")), RUN_SECS)
    heard = len(lines("journal.jsonl"))
    wait_for("more events", lambda: len(lines("journal.jsonl")) >= heard + further_events, RUN_SECS)
    first.kill()  # its processes die with it
    second = owner.start("babble", *arguments, "--resume", str(folder))
    assert second.ended(RUN_SECS) == 0, second.report()
    best = json.loads((folder / "best.json").read_text())["body"]["iteration"]
    scores = [json.loads(line) for line in (folder / "scores.jsonl").read_text().splitlines()]
    row = next(s for s in scores if s["iteration"] == best and s["policy"] == "mean")
    assert row["separation"] >= 0.9
    assert row["z_min"] >= 0.9
