"""The journal: what a kill leaves of it, what is refused, and that old journals still lead where they led."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.coordinator.journal import Journal, JournalError, parse, replay
from services.coordinator.machine import best_of, decide
from services.coordinator.state import Plan, State
from services.coordinator.table import Phase
from services.coordinator.words import (
    Announce,
    BlockProgress,
    Event,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    ScoreRow,
    Started,
    StatusReported,
    StopRequested,
    Ticked,
)

PLAN = Plan(levels=(("body",),), iterations=(1,), stall_secs=60.0)
RECORDED = sorted((Path(__file__).parent / "journals").glob("*.jsonl"))

ROW = ScoreRow(
    block="body",
    iteration=0,
    phase=Phase.GROUND,
    separation=0.1 + 0.2,
    separation_worst=1e-17,
    z_min=0.9,
    z_goal=0.97,
    switch_success=1.0,
    crossing=None,
    policy="mean",
    steps=2**53,
    encoder_version=3,
    policy_version=5,
)
WORD = StatusReported(
    now=1763816400.1234567,
    service="policy_learner",
    life="policy_learner-1",
    term=4,
    versions={"policy/body": 5},
    progress=(BlockProgress(block="body", done=3, wanted=16, unit="columns", finished=True),),
    scores=(
        ROW,
        replace(ROW, policy="sampled", crossing=0.25),
        replace(
            ROW,
            iteration=1,
            landmarks={"open": 0.97, "closed": 0.0},
            landmark_vertices={"open": 3},
            external_reward=-0.25,
            external_reward_by_vertex=(0.5, None),
        ),
    ),
    waiting_for='quotes ", line\nbreaks \u2028 and ünïcode',
)
HISTORY: list[Event] = [
    Started(now=0.0),
    MemberAppeared(now=0.1, service="actor", life="a"),
    LinkChanged(now=0.2, up=False),
    MemberVanished(now=0.3, service="actor", life="a"),
    LinkChanged(now=0.4, up=True),
    Ticked(now=90.5),
    WORD,
    StopRequested(now=99.0),
]


def write(path: Path, events: list[Event]) -> None:
    journal = Journal(path, "test", PLAN)
    for event in events:
        journal.append(event)
    journal.close()


def reread(path: Path) -> tuple[Event, ...]:
    journal = Journal(path, "test", PLAN)
    journal.close()
    return journal.events


def test_every_kind_of_event_is_read_as_it_was_written(tmp_path: Path) -> None:
    write(tmp_path / "journal.jsonl", HISTORY)
    assert list(reread(tmp_path / "journal.jsonl")) == HISTORY


WORDS = st.builds(
    StatusReported,
    now=st.floats(allow_nan=False, allow_infinity=False),
    versions=st.dictionaries(st.text(), st.integers(0, 2**53)),
    scores=st.just((ROW,)),
)


@given(WORDS)
def test_a_word_survives_the_line(word: StatusReported) -> None:
    line = json.dumps({"event": "StatusReported", "said": asdict(word)}).encode()
    assert parse(line) == word


def test_cut_at_any_byte_of_the_last_record_all_before_it_is_kept(tmp_path: Path) -> None:
    path, last = tmp_path / "journal.jsonl", replace(WORD, scores=(), waiting_for="ü")
    write(path, HISTORY[:-2])
    before = path.read_bytes()
    path.unlink()
    write(path, [*HISTORY[:-2], last])
    whole = path.read_bytes()
    for length in range(len(before), len(whole)):
        path.write_bytes(whole[:length])
        assert list(reread(path)) == HISTORY[:-2], f"cut after {length} bytes"
        journal = Journal(path, "test", PLAN)
        journal.append(last)
        journal.close()
        assert path.read_bytes() == whole, "the torn line is overwritten"


def test_cut_within_its_first_line_it_begins_anew(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, [])
    header = path.read_bytes()
    for length in range(len(header)):
        path.write_bytes(header[:length])
        assert reread(path) == ()
        assert path.read_bytes() == header


@pytest.mark.parametrize(
    "damage",
    [
        b"\x00\x00\xff",
        b"{}",
        b"[]",
        b'{"event":"Burnt","said":{}}',
        b'{"event":"Ticked","said":{"now":"x"}}',
        b"",
    ],
    ids=["noise", "empty", "list", "unknown", "wrong-type", "blank"],
)
def test_a_damaged_line_in_the_middle_is_named(tmp_path: Path, damage: bytes) -> None:
    path = tmp_path / "journal.jsonl"
    write(path, HISTORY)
    lines = path.read_bytes().split(b"\n")
    lines[3] = damage
    path.write_bytes(b"\n".join(lines))
    with pytest.raises(
        JournalError, match=r"line 4 of .*journal\.jsonl is damaged .*; put back a copy"
    ) as failure:
        reread(path)
    assert "\n" not in str(failure.value)
    assert path.read_bytes() == b"\n".join(lines), "nothing is changed"


@pytest.mark.parametrize("header", [b"not json", b"{}", b"[1]"])
def test_a_damaged_first_line_is_named(tmp_path: Path, header: bytes) -> None:
    path = tmp_path / "journal.jsonl"
    path.write_bytes(header + b"\n")
    with pytest.raises(JournalError, match="line 1 of"):
        reread(path)


@pytest.mark.parametrize(
    ("run", "plan", "sentence"),
    [
        ("other", PLAN, "run = 'test', and now it is 'other'"),
        ("test", replace(PLAN, levels=(("hand",),)), "levels = "),
        ("test", replace(PLAN, iterations=(9,)), r"iterations = \[1\], and now it is \[9\]"),
    ],
    ids=["run", "blocks", "iterations"],
)
def test_a_journal_of_another_run_or_plan_is_refused(
    tmp_path: Path, run: str, plan: Plan, sentence: str
) -> None:
    write(tmp_path / "journal.jsonl", HISTORY)
    with pytest.raises(JournalError, match=sentence):
        Journal(tmp_path / "journal.jsonl", run, plan)


def test_deadlines_may_change_between_starts(tmp_path: Path) -> None:
    write(tmp_path / "journal.jsonl", HISTORY)
    journal = Journal(tmp_path / "journal.jsonl", "test", replace(PLAN, stall_secs=1.0))
    assert list(journal.events) == list(HISTORY)
    journal.close()


def test_there_are_recorded_journals() -> None:
    assert len(RECORDED) >= 2


@pytest.mark.parametrize("path", RECORDED, ids=lambda path: path.stem)
def test_a_recorded_journal_leads_where_it_led(path: Path, tmp_path: Path) -> None:
    expected = json.loads(path.with_suffix(".expected.json").read_text(encoding="utf-8"))
    header = json.loads(path.read_text(encoding="utf-8").splitlines()[0])
    plan = Plan(
        levels=tuple(map(tuple, header["levels"])),
        iterations=(header["iterations"],) * len(header["levels"]),
        stall_secs=expected["stall_secs"],
    )
    copy = tmp_path / path.name
    copy.write_bytes(path.read_bytes())
    journal = Journal(copy, header["run"], plan)
    journal.close()
    state, announced = State(), list[list[object]]()
    for event in journal.events:
        before = state
        state, orders = decide(plan, state, event)
        assert state != before, f"only what changes the state is written, and {event} does not"
        announced += [
            [o.term, o.phase.value, o.level, o.iteration] for o in orders if isinstance(o, Announce)
        ]
    assert announced == expected["announced"]
    assert [list(row.key) for row in state.scores] == expected["scores"]
    kept = {block: best_of(state, block) for level in plan.levels for block in level}
    assert {block: best.iteration for block, best in kept.items() if best} == expected["best"]
    assert state == replay(plan, journal.events)


def test_a_journal_from_before_levels_had_their_own_iterations_is_gone_on_with(tmp_path: Path) -> None:
    old = next(path for path in RECORDED if path.stem == "hand_of_two_levels")
    path = tmp_path / "journal.jsonl"
    path.write_bytes(old.read_bytes())
    levels = (("thumb", "index"), ("hand",))
    plan = Plan(levels=levels, iterations=(1, 1), stall_secs=60.0)
    with pytest.raises(JournalError, match=r"iterations = \[1, 1\], and now it is \[1, 2\]"):
        Journal(path, "test", replace(plan, iterations=(1, 2)))
    journal = Journal(path, "test", plan)
    journal.close()
    assert set(replay(plan, journal.events).frozen) == {"thumb", "index"}


def test_a_second_coordinator_is_refused_until_the_first_has_ended(tmp_path: Path) -> None:
    path = tmp_path / "journal.jsonl"
    first = Journal(path, "r", PLAN)
    with pytest.raises(JournalError, match="another coordinator is writing"):
        Journal(path, "r", PLAN)
    first.close()
    Journal(path, "r", PLAN).close()
