"""The sentences on who waits for whom."""

from dataclasses import replace

import pytest

from services.coordinator.state import Member, OwnLink, Plan, State
from services.coordinator.table import Phase
from services.coordinator.waiting import phase_name, stalled, waiting
from services.coordinator.words import BlockProgress

PLAN = Plan(levels=(("body",), ("a", "b", "c", "d", "e", "f")), iterations=(2, 2), stall_secs=60.0)
ALL = {
    "e1": Member(service="encoder_learner"),
    "p1": Member(service="policy_learner"),
    "a1": Member(service="actor"),
}
STATE = State(term=2, phase=Phase.ENCODE, members=ALL)


def progress(done: int, life: str = "e1", block: str = "body") -> dict[tuple[str, str], BlockProgress]:
    return {(block, life): BlockProgress(block=block, done=done, wanted=5000, unit="updates")}


def test_it_names_the_learner_and_how_far_it_is() -> None:
    state = replace(STATE, progress=progress(1200))
    assert waiting(PLAN, state) == "waiting for encoder_learner: 1,200 of 5,000 updates of body"


def test_a_learner_that_said_nothing_yet_is_named_too() -> None:
    assert waiting(PLAN, STATE) == "waiting for encoder_learner: no word yet of body"


def test_a_missing_learner_is_named() -> None:
    state = replace(STATE, phase=Phase.GROUND, members={"a1": ALL["a1"], "e1": ALL["e1"]})
    assert waiting(PLAN, state) == "waiting for a policy_learner to appear"
    assert waiting(PLAN, replace(STATE, members={})) == "waiting for an encoder_learner to appear"


@pytest.mark.parametrize("phase", [Phase.BABBLE, Phase.WALK])
def test_a_data_phase_without_actors_says_so(phase: Phase) -> None:
    members = {**ALL, "a1": Member(service="actor", lost_at_secs=3.0)}
    state = replace(STATE, phase=phase, members=members, progress=progress(1200))
    assert waiting(PLAN, state) == (
        "waiting for an actor to appear; encoder_learner has 1,200 of 5,000 updates of body"
    )
    assert waiting(PLAN, replace(state, phase=Phase.ENCODE)).startswith("waiting for encoder_learner")


def test_finished_blocks_are_left_out_and_many_are_counted() -> None:
    state = replace(STATE, level=1, finished=frozenset({"a"}), progress=progress(7, block="b"))
    assert waiting(PLAN, state) == (
        "waiting for encoder_learner: 7 of 5,000 updates of b, no word yet of c, no word yet of d, "
        "no word yet of e, and 1 more block"
    )


def test_after_a_restart_of_the_learner_the_living_one_is_quoted() -> None:
    state = replace(STATE, progress={**progress(4000, life="e0"), **progress(10, life="e1")})
    assert waiting(PLAN, state).endswith("10 of 5,000 updates of body")


FINGERS = Plan(
    levels=(("thumb", "index", "ring", "little"), ("hand",)),
    iterations=(1, 1),
    stall_secs=60.0,
    processes={"encoder_learner": 2, "policy_learner": 2},
    shares={("policy_learner", name): 1 for name in ("ring", "little")},
)
TWO = {**ALL, "p2": Member(service="policy_learner")}


def test_the_process_that_is_missing_is_named_with_its_blocks_and_the_others_go_on() -> None:
    said = {**progress(1200, life="p1", block="thumb"), **progress(7, life="p1", block="index")}
    state = replace(STATE, phase=Phase.GROUND, progress=said)
    assert waiting(FINGERS, state) == (
        "waiting for policy_learner 1 of ring, little to appear; policy_learner has "
        "1,200 of 5,000 updates of thumb, 7 of 5,000 updates of index"
    )
    assert waiting(FINGERS, replace(state, finished=frozenset({"thumb", "index"}))) == (
        "waiting for policy_learner 1 of ring, little to appear"
    )
    assert "little" not in waiting(FINGERS, replace(state, finished=frozenset({"little"})))


def test_a_process_that_is_there_and_has_said_nothing_yet_is_not_missing() -> None:
    state = replace(STATE, phase=Phase.GROUND, members=TWO, progress=progress(1, life="p1", block="thumb"))
    assert waiting(FINGERS, state).startswith("waiting for policy_learner: 1 of 5,000 updates of thumb")


def test_a_process_that_was_lost_is_missing_however_much_it_had_said() -> None:
    said = {**progress(1, life="p1", block="thumb"), **progress(4000, life="p2", block="ring")}
    members = {**TWO, "p2": Member(service="policy_learner", lost_at_secs=3.0)}
    state = replace(STATE, phase=Phase.GROUND, members=members, progress=said)
    assert waiting(FINGERS, state).startswith("waiting for policy_learner 1 of ring, little to appear")


def test_two_processes_that_learn_the_same_blocks_leave_the_others_waiting() -> None:
    said = {**progress(1, life="p1", block="thumb"), **progress(2, life="p2", block="thumb")}
    state = replace(STATE, phase=Phase.GROUND, members=TWO, progress=said)
    assert "waiting for policy_learner 1 of ring, little to appear" in waiting(FINGERS, state)


def test_a_process_without_blocks_on_this_level_is_no_substitute() -> None:
    state = replace(STATE, phase=Phase.GROUND, level=1, members=ALL)
    assert waiting(FINGERS, state) == "waiting for policy_learner 0 of hand to appear"
    assert waiting(FINGERS, replace(state, members=TWO)) == "waiting for policy_learner: no word yet of hand"


def test_several_learners_that_wait_are_named_by_their_lives() -> None:
    state = replace(
        STATE, phase=Phase.GROUND, members=TWO, workers_wait_for={"p1": "experience", "p2": "a rollout"}
    )
    assert (
        "p1 says it is waiting for experience; p2 says it is waiting for a rollout; 1 actor alive"
        in stalled(FINGERS, state, 99.0)
    )


def test_the_own_link_comes_first() -> None:
    assert (
        waiting(PLAN, replace(STATE, link=OwnLink.DOWN))
        == "waiting for this process's own link to the router"
    )


def test_at_the_end_it_waits_for_the_others_to_leave() -> None:
    state = replace(STATE, phase=Phase.DONE)
    assert waiting(PLAN, state) == "waiting for 3 members to leave"
    onlooking = {"c": Member(service="coordinator"), "d": Member(service="dashboard")}
    assert waiting(PLAN, replace(state, members=onlooking)) == ""


def test_before_the_start_and_after_a_stop_it_says_so() -> None:
    assert waiting(PLAN, State()) == "waiting to be started"
    assert "--resume" in waiting(PLAN, replace(STATE, stopping=True))


def test_a_stall_names_who_waits_for_whom() -> None:
    state = replace(
        STATE,
        phase=Phase.WALK,
        term=5,
        iteration=1,
        progress_at_secs=100.0,
        progress=progress(1200),
        workers_wait_for={"e1": "experience of body", "e0": "its predecessor"},
    )
    assert stalled(PLAN, state, 165.0) == (
        "no progress for 65 s in walk (level 0, iteration 1, term 5): the coordinator is waiting for "
        "encoder_learner: 1,200 of 5,000 updates of body; encoder_learner says it is waiting for experience "
        "of body; 1 actor alive"
    )
    assert stalled(PLAN, replace(state, members={}), 165.0).endswith("no actor is alive")


def test_an_evaluation_says_what_it_measures() -> None:
    state = replace(STATE, phase=Phase.EVALUATE, evaluates=Phase.GROUND, term=4)
    assert phase_name(state) == "evaluate of ground (level 0, iteration 0, term 4)"
