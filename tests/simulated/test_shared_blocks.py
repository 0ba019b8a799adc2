"""Two learners of each kind share the blocks of a level; one that is lost holds up nobody but its own."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from protocol.messages import Phase
from services.runtime.settings import RunSettings, parse
from tests.simulated.conftest import TINY
from tests.simulated.harness import Simulation

Simulate = Callable[..., Simulation]

BLOCKS = [
    {"name": "x", "observes": [0], "drives": [0]},
    {"name": "yz", "observes": [1, 2], "drives": [1, 2]},
]
LEARNERS = ("encoder_learner", "policy_learner")


@pytest.fixture
def shared() -> RunSettings:
    """The tiny run with two blocks, and a learner of each kind for each of them."""
    return parse(TINY | {"block": BLOCKS, "learners": {"encoder": 2, "policy": 2}}, origin="test")


def start_all(simulation: Simulation) -> None:
    simulation.start("coordinator", "coordinator-0")
    for service in LEARNERS:
        for index in (0, 1):
            simulation.start(service, f"{service}-{index}", index)
    for index in (0, 1):
        simulation.start("actor", f"actor-{index}", index)


def phase_of(run_dir: Path) -> str:
    """The phase that was announced last; empty before the first."""
    if not (run_dir / "events.jsonl").exists():
        return ""
    events = [json.loads(line) for line in (run_dir / "events.jsonl").read_text().splitlines()]
    return [str(event["text"]).split()[0] for event in events if event["what"] == "phase"][-1]


def scored(run_dir: Path) -> set[tuple[Any, ...]]:
    rows = [json.loads(line) for line in (run_dir / "scores.jsonl").read_text().splitlines()]
    return {(row["block"], row["iteration"], row["policy"]) for row in rows}


EVERYTHING = {
    (block, iteration, policy)
    for block in ("x", "yz")
    for iteration in (0, 1)
    for policy in ("mean", "sampled")
}


def assert_each_took_its_own_and_once(simulation: Simulation) -> None:
    """No learner used more than was sent to it, or took a segment twice, or was sent another's."""
    for key, used in simulation.used_steps.items():
        assert used <= sum(simulation.sent_steps[key].values()), f"{key} counted experience twice"
    for service in LEARNERS:
        for name, block in ((service, "x"), (f"{service}-1", "yz")):
            book = simulation.book(name)
            assert {stream[1] for stream in book["ledger"]["streams"]} == {block}
            taken = sum(upto for _, _, upto, _ in book["ledger"]["streams"])
            assert book["received"] == taken == book["ledger"]["counts"]["new"]


def test_learners_share_the_blocks_of_a_level(shared: RunSettings, simulate: Simulate) -> None:
    simulation = simulate(shared)
    start_all(simulation)
    simulation.until_all_ended()
    assert scored(simulation.run_dir) == EVERYTHING
    assert_each_took_its_own_and_once(simulation)
    for service in LEARNERS:
        for index, block in ((0, "x"), (1, "yz")):
            said = [status for _, status in simulation.statuses(f"{service}-{index}")]
            assert {progress.block for status in said for progress in status.progress} == {block}
            assert not any(status.refused for status in said)


@pytest.mark.parametrize(
    ("service", "phase"),
    [("encoder_learner", "babble"), ("encoder_learner", "refine"), ("policy_learner", "ground"),
     ("policy_learner", "evaluate")],
)  # fmt: skip
def test_the_blocks_of_a_lost_learner_wait_for_it_and_those_of_the_others_do_not(
    shared: RunSettings, simulate: Simulate, service: str, phase: str
) -> None:
    simulation = simulate(shared)
    start_all(simulation)
    simulation.until(lambda: phase_of(simulation.run_dir) == phase)
    simulation.crash(f"{service}-1")

    def others_are_done() -> bool:
        _, said = simulation.statuses(f"{service}-0")[-1]
        return said.phase is Phase(phase) and all(progress.finished for progress in said.progress)

    simulation.until(others_are_done)
    for _ in range(500):
        simulation.round()
    assert phase_of(simulation.run_dir) == phase, "the run waits"
    _, said = simulation.statuses("coordinator-0")[-1]
    assert "yz" in said.waiting_for
    simulation.start(service, f"{service}-reborn", 1)
    simulation.until_all_ended()
    assert scored(simulation.run_dir) == EVERYTHING
    assert_each_took_its_own_and_once(simulation)


def test_actors_wait_for_the_first_policy_of_a_learner_that_comes_late(
    shared: RunSettings, simulate: Simulate
) -> None:
    simulation = simulate(shared)
    simulation.start("coordinator", "coordinator-0")
    simulation.start("encoder_learner", "encoder_learner-0")
    simulation.start("encoder_learner", "encoder_learner-1", 1)
    simulation.start("policy_learner", "policy_learner-0")
    simulation.start("actor", "actor-0")
    simulation.until(lambda: phase_of(simulation.run_dir) == "ground")
    for _ in range(500):
        simulation.round()
    _, said = simulation.statuses("actor-0")[-1]
    assert "policy 1 of yz" in said.waiting_for
    simulation.start("policy_learner", "policy_learner-1", 1)
    simulation.until_all_ended()
    assert scored(simulation.run_dir) == EVERYTHING
