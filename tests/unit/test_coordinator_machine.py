"""The coordinator's machine: the sequence of phases, what ends one, and that strange words do no harm."""

import subprocess
import sys
from dataclasses import fields, replace
from itertools import pairwise

import pytest

from protocol import messages
from services.coordinator.machine import decide
from services.coordinator.state import OwnLink, Plan, State, present
from services.coordinator.table import NEXT, Phase
from services.coordinator.words import (
    Announce,
    BlockProgress,
    End,
    Event,
    Frozen,
    KeepBest,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    RecordScores,
    SayStalled,
    ScoreRow,
    Started,
    StatusReported,
    StopRequested,
    Ticked,
)
from tests.unit.coordinator_play import FLAT, HAND, OPEN, finishing, play, run_through, score, walk_to


def test_a_flat_run_goes_through_the_phases_of_the_thesis() -> None:
    said = [(a.term, a.phase.value, a.iteration, a.evaluates) for a in run_through(FLAT)]
    assert said == [
        (1, "babble", 0, None),
        (2, "encode", 0, None),
        (3, "ground", 0, None),
        (4, "evaluate", 0, Phase.GROUND),
        (5, "walk", 1, None),
        (6, "refine", 1, None),
        (7, "practise", 1, None),
        (8, "evaluate", 1, Phase.PRACTISE),
        (9, "walk", 2, None),
        (10, "refine", 2, None),
        (11, "practise", 2, None),
        (12, "evaluate", 2, Phase.PRACTISE),
        (13, "done", 2, None),
    ]


def test_levels_train_bottom_up_and_each_starts_with_babble() -> None:
    said = run_through(HAND)
    assert [a.level for a in said if a.phase is Phase.BABBLE] == [0, 1]
    assert {tuple(a.floors) for a in said if a.level == 0} == {("thumb", "index")}
    assert {tuple(a.floors) for a in said if a.level == 1 and a.phase is not Phase.DONE} == {("hand",)}
    assert [a.term for a in said] == list(range(1, 18))


def test_each_level_iterates_as_often_as_its_plan_says() -> None:
    said = run_through(replace(HAND, iterations=(0, 2)))
    assert [(a.level, a.iteration) for a in said if a.phase is Phase.EVALUATE] == [
        (0, 0), (1, 0), (1, 1), (1, 2),
    ]  # fmt: skip


def test_without_iterations_a_run_ends_after_the_first_evaluation() -> None:
    said = run_through(replace(FLAT, iterations=(0,)))
    assert [a.phase.value for a in said] == ["babble", "encode", "ground", "evaluate", "done"]


def test_done_ends_the_coordinator() -> None:
    state = walk_to(FLAT, Phase.EVALUATE, iteration=2)
    state, orders = decide(FLAT, state, finishing(FLAT, state))
    assert state.phase is Phase.DONE
    assert orders[-1] == End(completed=True)


def test_every_move_of_the_table_is_made_and_no_other() -> None:
    made = {move for plan in (HAND, OPEN) for move in pairwise(a.phase for a in run_through(plan))}
    assert made == {(phase, to) for phase, moves in NEXT.items() for to in moves}


@pytest.mark.parametrize(
    "change",
    [
        {"service": "actor"},
        {"service": "encoder_learner"},
        {"term": 2},
        {"term": 4},
        {"progress": (BlockProgress(block="body", done=5, wanted=5, unit="steps"),)},
        {"progress": (BlockProgress(block="tail", done=5, wanted=5, unit="steps", finished=True),)},
        {"progress": ()},
    ],
    ids=["an-actor", "the-other-learner", "late", "early", "unfinished", "unknown-block", "silent"],
)
def test_only_the_responsible_learner_in_this_term_ends_a_phase(change: dict[str, object]) -> None:
    state = walk_to(FLAT, Phase.GROUND)
    assert decide(FLAT, state, finishing(FLAT, state))[0].phase is Phase.EVALUATE
    word = replace(finishing(FLAT, state), **change)  # type: ignore[arg-type]
    assert decide(FLAT, state, word)[0].term == state.term


def test_a_phase_waits_for_every_block_whichever_life_finished_it() -> None:
    state = walk_to(HAND, Phase.BABBLE)
    word = finishing(HAND, state)
    state, orders = decide(HAND, state, replace(word, life="before", progress=word.progress[:1]))
    assert (state.phase, orders) == (Phase.BABBLE, [])
    state, _ = decide(HAND, state, replace(word, life="after", progress=word.progress[1:]))
    assert state.phase is Phase.ENCODE


def said_at(state: State, row: ScoreRow) -> StatusReported:
    """The end of an evaluation in which the row is found of its block, and little of the others."""
    word = finishing(HAND, state)
    others = (replace(other, z_min=0.1) for other in word.scores if other.block != row.block)
    return replace(word, scores=(*others, row), versions={})


def left_level_0(*rows: dict[str, object], plan: Plan = HAND) -> State:
    """At the beginning of level 1; the rows are what the evaluations found of the thumb."""
    state = walk_to(plan, Phase.EVALUATE)
    for iteration, row in enumerate(rows):
        while (state.phase, state.iteration) != (Phase.EVALUATE, iteration):
            state, _ = decide(plan, state, finishing(plan, state))
        state, _ = decide(plan, state, said_at(state, score(state, "thumb", **row)))
    assert (state.level, state.phase) == (1, Phase.BABBLE)
    return state


def test_a_block_is_frozen_at_its_newest_versions_where_these_are_its_best() -> None:
    rows = (
        {"z_min": 0.5, "encoder_version": 102, "policy_version": 103},
        {"z_min": 0.9, "encoder_version": 106, "policy_version": 107},
    )
    assert left_level_0(*rows).frozen["thumb"] == Frozen(
        encoder=106, policy=107, of_encoder=106, of_policy=107
    )


def test_a_block_whose_best_iteration_was_not_the_last_is_frozen_at_versions_yet_to_come() -> None:
    rows = (
        {"z_min": 0.95, "encoder_version": 102, "policy_version": 103},
        {"z_min": 0.4, "encoder_version": 106, "policy_version": 107},
    )
    state = left_level_0(*rows)
    assert state.frozen["thumb"] == Frozen(encoder=107, policy=108, of_encoder=102, of_policy=103)
    assert set(state.frozen) == {"thumb", "index"}
    published = StatusReported(
        now=5.0, service="policy_learner", life="a", term=state.term, versions={"policy/thumb": 108}
    )
    after, orders = decide(HAND, state, published)
    assert (after.frozen, after.versions["policy/thumb"], orders) == (state.frozen, 108, [])


def test_the_mean_policy_decides_what_is_frozen() -> None:
    state = walk_to(HAND, Phase.EVALUATE)
    word = said_at(state, score(state, "thumb", z_min=0.5, encoder_version=102, policy_version=103))
    state, _ = decide(HAND, state, word)
    while state.phase is not Phase.EVALUATE:
        state, _ = decide(HAND, state, finishing(HAND, state))
    row = score(state, "thumb", z_min=1.0, policy="sampled", encoder_version=106, policy_version=107)
    state, _ = decide(HAND, state, said_at(state, row))
    assert state.frozen["thumb"].of_policy == 103


def test_a_block_without_a_score_is_frozen_at_its_newest_versions() -> None:
    plan = replace(HAND, iterations=(0, 0))
    state = walk_to(plan, Phase.EVALUATE)
    state, _ = decide(plan, state, replace(finishing(plan, state), scores=(), versions={}))
    assert state.frozen["index"] == Frozen(encoder=102, policy=103, of_encoder=102, of_policy=103)


def test_what_is_frozen_is_said_in_every_later_phase_and_of_every_level_below() -> None:
    tree = Plan(levels=(("thumb", "index"), ("hand",), ("arm",)), iterations=(0, 0, 0), stall_secs=60.0)
    said = run_through(tree)
    below = {0: set[str](), 1: {"thumb", "index"}, 2: {"thumb", "index", "hand"}}
    assert all(set(a.frozen) == below[a.level] for a in said)
    assert {a.phase for a in said if a.level == 2} >= {Phase.BABBLE, Phase.EVALUATE, Phase.DONE}
    assert len({str(a.frozen["thumb"]) for a in said if a.level > 0}) == 1, "it stays as it was"
    assert all(a.frozen == {} for a in run_through(FLAT))


def test_floors_are_the_versions_the_learners_reported() -> None:
    said = {a.term: dict(a.floors) for a in run_through(FLAT)}
    assert said[1] == {"body": (0, 0)}
    assert said[3] == {"body": (102, 0)}
    assert said[4] == {"body": (102, 103)}
    assert said[7] == {"body": (106, 104)}


def test_a_learner_is_believed_about_its_own_models_only() -> None:
    state = walk_to(FLAT, Phase.ENCODE)
    lie = replace(finishing(FLAT, state), service="policy_learner", versions={"encoder/body": 999})
    assert decide(FLAT, state, lie) == (state, [])


def test_a_lesser_version_is_a_late_word() -> None:
    state = walk_to(FLAT, Phase.GROUND)
    held = replace(finishing(FLAT, state), progress=(), versions={"policy/body": 7})
    state, _ = decide(FLAT, state, held)
    assert decide(FLAT, state, replace(held, versions={"policy/body": 6})) == (state, [])


def test_a_score_is_recorded_once_and_the_best_is_said_when_it_changes() -> None:
    state = walk_to(FLAT, Phase.EVALUATE)
    word = replace(finishing(FLAT, state), progress=(), scores=(score(state, "body", z_min=0.5),))
    state, orders = decide(FLAT, state, word)
    assert [type(order) for order in orders] == [RecordScores, KeepBest]
    assert decide(FLAT, state, word) == (state, [])
    sampled = replace(word, scores=(score(state, "body", policy="sampled"),))
    _, orders = decide(FLAT, state, sampled)
    assert [type(order) for order in orders] == [RecordScores]


def test_scores_of_another_time_or_block_are_not_recorded() -> None:
    state = walk_to(FLAT, Phase.EVALUATE)
    for row in (score(state, "body", iteration=1), score(state, "tail")):
        assert decide(FLAT, state, replace(finishing(FLAT, state), progress=(), scores=(row,)))[1] == []
    state = walk_to(FLAT, Phase.GROUND)
    assert (
        decide(FLAT, state, replace(finishing(FLAT, state), progress=(), scores=(score(state, "body"),)))[1]
        == []
    )


def appeared(life: str, service: str = "actor", now: float = 0.0) -> MemberAppeared:
    return MemberAppeared(now=now, service=service, life=life)


def vanished(life: str, service: str = "actor", now: float = 0.0) -> MemberVanished:
    return MemberVanished(now=now, service=service, life=life)


def test_a_member_that_vanishes_is_gone() -> None:
    state, _ = play(FLAT, [Started(now=0.0), appeared("a"), appeared("b"), vanished("a", now=1.0)])
    assert present(state) == {"b": "actor"}
    state, _ = decide(FLAT, state, Ticked(now=9.0))
    assert set(state.members) == {"b"}


@pytest.mark.parametrize("link_first", [True, False], ids=["link-first", "members-first"])
def test_a_storm_of_losses_while_the_own_link_is_down_is_the_link(link_first: bool) -> None:
    members = [f"actor-{n}" for n in range(20)]
    storm: list[Event] = [vanished(life, now=10.0) for life in members]
    storm.insert(0 if link_first else len(storm), LinkChanged(now=10.0, up=False))
    state, _ = play(FLAT, [Started(now=0.0), *map(appeared, members), *storm, Ticked(now=50.0)])
    assert set(present(state)) == set(members)
    back: list[Event] = [LinkChanged(now=60.0, up=True), *(appeared(life, now=60.5) for life in members[1:])]
    state, _ = play(FLAT, [*back, Ticked(now=61.0)], state)
    assert set(present(state)) == set(members), "within the grace period the last one may still come"
    state, _ = decide(FLAT, state, Ticked(now=63.5))
    assert set(present(state)) == set(members[1:])
    assert state.link is OwnLink.UP


def test_a_stall_is_said_once_and_again_after_progress() -> None:
    state = walk_to(FLAT, Phase.GROUND)
    begun = state.progress_at_secs
    state, orders = play(
        FLAT, [Ticked(now=begun + 59.0), Ticked(now=begun + 60.0), Ticked(now=begun + 99.0)], state
    )
    assert [type(order) for order in orders] == [SayStalled]
    word = replace(
        finishing(FLAT, state, now=begun + 100.0),
        progress=(BlockProgress(block="body", done=1, wanted=5, unit="steps"),),
    )
    state, _ = decide(FLAT, state, word)
    assert not state.stalled
    _, orders = play(FLAT, [replace(word, now=begun + 150.0), Ticked(now=begun + 160.0)], state)
    assert [type(order) for order in orders] == [SayStalled], "hearing the same count again is no progress"


def test_a_run_that_is_done_or_stopped_does_not_stall() -> None:
    done, _ = decide(FLAT, *_last_word())
    stopped, _ = decide(FLAT, walk_to(FLAT, Phase.WALK, 1), StopRequested(now=2.0))
    for state in (done, stopped, State()):
        assert decide(FLAT, state, Ticked(now=1e6)) == (state, [])


def _last_word() -> tuple[State, StatusReported]:
    state = walk_to(FLAT, Phase.EVALUATE, iteration=2)
    return state, finishing(FLAT, state)


def test_a_stopped_run_goes_on_where_it_was() -> None:
    state = walk_to(FLAT, Phase.REFINE, iteration=1)
    stopped, orders = decide(FLAT, state, StopRequested(now=2.0))
    assert orders == [End(completed=False)]
    assert decide(FLAT, stopped, finishing(FLAT, stopped)) == (stopped, []), "it has stopped listening"
    again, orders = decide(FLAT, stopped, Started(now=900.0))
    assert [(order.term, order.phase) for order in orders if isinstance(order, Announce)] == [
        (6, Phase.REFINE)
    ]
    assert decide(FLAT, again, finishing(FLAT, again))[0].phase is Phase.PRACTISE


def test_a_restart_forgets_who_was_there_and_keeps_what_was_done() -> None:
    state = walk_to(HAND, Phase.GROUND)
    word = finishing(HAND, state)
    state, _ = play(HAND, [appeared("a"), replace(word, progress=word.progress[:1])], state)
    again, _ = decide(HAND, state, Started(now=1e4))
    assert present(again) == {}
    assert again.finished == {"thumb"}
    assert decide(HAND, again, Ticked(now=1e4 + 59.0))[1] == [], "the time it was away is not a stall"


def test_the_words_are_those_of_the_wire() -> None:
    assert [(p.name, p.value) for p in Phase] == [(p.name, p.value) for p in messages.Phase]
    assert ["run", *(field.name for field in fields(ScoreRow))] == list(messages.Score.model_fields)
    assert {field.name for field in fields(BlockProgress)} == set(messages.Progress.model_fields)


def test_the_machine_is_pure() -> None:
    program = (
        "import sys; before = set(sys.modules); import services.coordinator.machine; "
        "print(*sorted({name.split('.')[0] for name in set(sys.modules) - before}))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    loaded = set(done.stdout.split())
    assert "services" in loaded
    assert not loaded & {
        "protocol",
        "numpy",
        "pydantic",
        "zenoh",
        "torch",
        "mujoco",
        "socket",
        "asyncio",
        "random",
    }
