"""Runs in which nothing is learned and actors are recorded, and runs that learn and are recorded as well."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from protocol.messages import Phase, Progress
from services.coordinator.config import plan_of
from services.coordinator.journal import Journal, JournalError, replay
from services.coordinator.machine import decide
from services.coordinator.service import FAREWELL_SECS, RECORDER_SECS
from services.coordinator.state import Member, Plan, State
from services.coordinator.table import Phase as MachinePhase
from services.coordinator.waiting import stalled, waiting
from services.coordinator.words import BlockProgress, End, Started, StatusReported
from services.runtime.settings import parse
from tests.unit.coordinator_play import FLAT, OPEN, finishing, play, run_through, walk_to
from tests.unit.coordinator_stage import Stage

RECORDED = {"scenario": "test", "recording": {"every_steps": 1}}
OPEN_LOOP = RECORDED | {"phases": {"open_loop": True, "babble_steps": 100}}
HERE = {"r1": Member(service="recorder"), "a1": Member(service="actor"), "c1": Member(service="coordinator")}
BABBLING = State(term=1, members=HERE)
LEARNING = replace(OPEN, open_loop=False)


def test_an_open_loop_babbles_and_is_done() -> None:
    assert [(a.term, a.phase.value, a.level, a.iteration) for a in run_through(OPEN)] == [
        (1, "babble", 0, 0),
        (2, "done", 0, 0),
    ]
    state = walk_to(OPEN, MachinePhase.BABBLE)
    assert decide(OPEN, state, finishing(OPEN, state))[1][-1] == End(completed=True)


def test_only_the_recorder_ends_it() -> None:
    state = walk_to(OPEN, MachinePhase.BABBLE)
    of_a_learner = replace(finishing(OPEN, state), service="encoder_learner")
    assert decide(OPEN, state, of_a_learner)[0].term == state.term


def test_in_a_run_that_learns_the_recorder_ends_nothing() -> None:
    state = walk_to(FLAT, MachinePhase.BABBLE)
    assert decide(FLAT, state, replace(finishing(FLAT, state), service="recorder"))[0] == state


def test_an_open_loop_that_records_nothing_is_no_plan() -> None:
    with pytest.raises(ValueError, match="nobody to end it"):
        Plan(levels=(("body",),), iterations=(0,), stall_secs=1.0, open_loop=True)


def test_the_plan_follows_the_settings() -> None:
    plans = [plan_of(parse(table, origin="test")) for table in ({"scenario": "test"}, RECORDED, OPEN_LOOP)]
    assert [(plan.open_loop, plan.records) for plan in plans] == [(False, False), (False, True), (True, True)]


def said(done: int, service: str = "recorder") -> dict[tuple[str, str], BlockProgress]:
    return {("body", f"{service[0]}1"): BlockProgress(block="body", done=done, wanted=1000, unit="steps")}


def without(service: str) -> dict[str, Member]:
    return {life: member for life, member in HERE.items() if member.service != service}


def test_who_is_missing_and_how_far_the_recorder_is() -> None:
    state = replace(BABBLING, progress=said(300))
    assert waiting(OPEN, state) == "waiting for recorder: 300 of 1,000 steps of body"
    assert waiting(OPEN, replace(state, members=without("recorder"))) == "waiting for a recorder to appear"
    assert waiting(OPEN, replace(state, members=without("actor"))) == (
        "waiting for an actor to appear; recorder has 300 of 1,000 steps of body"
    )


def test_a_stall_of_an_open_loop_names_the_recorder() -> None:
    word = StatusReported(
        now=1.0, service="recorder", life="r1", term=1, versions={}, waiting_for="states of actors"
    )
    state, _ = play(OPEN, [Started(now=0.0), word])
    told = stalled(OPEN, replace(state, members=HERE), 61.0)
    assert "the coordinator is waiting for recorder: no word yet of body" in told
    assert "recorder says it is waiting for states of actors; 1 actor alive" in told


def test_where_a_run_that_learns_is_recorded_actors_wait_for_the_recorder_too() -> None:
    members = without("recorder") | {"e1": Member(service="encoder_learner")}
    state = replace(BABBLING, members=members, progress=said(300, "encoder_learner"))
    assert waiting(LEARNING, state) == (
        "waiting for a recorder to appear; encoder_learner has 300 of 1,000 steps of body"
    )
    assert waiting(replace(LEARNING, records=False), state).startswith("waiting for encoder_learner")
    fitting = replace(state, phase=MachinePhase.ENCODE)
    assert waiting(LEARNING, fitting).startswith("waiting for encoder_learner"), "no actor is needed there"


@pytest.mark.parametrize(
    ("plan", "left"), [(OPEN, "waiting for 2 members to leave"), (FLAT, "waiting for 1 member to leave")]
)
def test_the_recorder_is_waited_for_at_the_end_where_it_records(plan: Plan, left: str) -> None:
    assert waiting(plan, replace(BABBLING, phase=MachinePhase.DONE)) == left


def test_a_journal_says_that_it_is_of_an_open_loop_and_goes_on_as_that_alone(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    journal = Journal(path, "test", OPEN)
    state, _ = play(OPEN, [Started(now=0.0)])
    for event in (Started(now=0.0), finishing(OPEN, state)):
        journal.append(event)
    journal.close()
    again = Journal(path, "test", OPEN)
    again.close()
    assert replay(OPEN, again.events).phase is MachinePhase.DONE
    with pytest.raises(JournalError, match="open_loop = True, and now it is False"):
        Journal(path, "test", LEARNING)


def test_journals_of_runs_that_learn_are_as_they_always_were(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    Journal(path, "test", FLAT).close()
    assert set(json.loads(path.read_bytes())) == {"journal", "run", "levels", "iterations"}
    with pytest.raises(JournalError, match="open_loop = False, and now it is True"):
        Journal(path, "test", replace(FLAT, open_loop=True, records=True))


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    stage = Stage(tmp_path / "run", parse(OPEN_LOOP, origin="test"))
    stage.start("coordinator-1")
    stage.poll()
    for service in ("recorder", "actor"):
        stage.join(service, f"{service}-1")
    stage.poll()
    return stage


def record(stage: Stage, done: int) -> None:
    progress = Progress(block="body", done=done, wanted=100, unit="steps", finished=done >= 100)
    stage.say("recorder", term=1, progress=[progress])
    stage.poll()


def test_it_drives_an_open_loop_to_done_and_leaves_when_the_recorder_has_left(stage: Stage) -> None:
    record(stage, 60)
    assert stage.describe()["waiting"] == "waiting for recorder: 60 of 100 steps of body"
    stage.announced()
    record(stage, 100)
    assert stage.announced()[-1].phase is Phase.DONE
    stage.hub.crash("actor-1")
    assert stage.poll(FAREWELL_SECS + 1.0) is not None, "the recorder still writes"
    stage.hub.crash("recorder-1")
    assert stage.poll(2.0) is None


def test_it_does_not_wait_for_a_recorder_for_ever(stage: Stage) -> None:
    record(stage, 100)
    assert stage.poll(RECORDER_SECS - 1.0) is not None
    assert stage.poll(1.1) is None


def test_killed_at_any_moment_it_goes_on_with_the_open_loop(stage: Stage) -> None:
    record(stage, 60)
    stage.kill()
    stage.start("coordinator-2")
    stage.poll()
    assert stage.announced()[-1].phase is Phase.BABBLE
    record(stage, 100)
    stage.kill()
    stage.start("coordinator-3")
    stage.poll()
    assert stage.announced()[-1].phase is Phase.DONE
