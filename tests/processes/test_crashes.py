"""Killed with -9 at bad moments, a run of real processes completes, and no experience counts twice."""

from pathlib import Path

import pytest

from tests.processes.distributed import DistributedRun
from tests.processes.owned import Owner

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
