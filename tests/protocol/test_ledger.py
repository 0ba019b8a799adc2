"""The ledger takes each segment once and in order, whatever the link does."""

import json

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.ledger import Ledger, Verdict
from protocol.refusal import Reason


def hear(ledger: Ledger, life: str, block: str, seq: int) -> Verdict:
    """What a consumer does with a segment."""
    verdict = ledger.judge(life, block, seq)
    if verdict is Verdict.NEW:
        ledger.accept(life, block, seq)
    else:
        ledger.refuse(life, block, seq)
    return verdict


def test_only_the_expected_number_is_new():
    ledger = Ledger()
    assert [hear(ledger, "a", "b", seq) for seq in (0, 1, 1, 0, 3, 2, 3)] == [
        Verdict.NEW,
        Verdict.NEW,
        Verdict.DUPLICATE,
        Verdict.DUPLICATE,
        Verdict.GAP,
        Verdict.NEW,
        Verdict.NEW,
    ]
    assert (ledger.upto("a", "b"), ledger.new, ledger.duplicated, ledger.gaps) == (4, 4, 2, 1)


def test_lives_and_blocks_are_counted_apart():
    ledger = Ledger()
    for life, block in (("a", "x"), ("a", "y"), ("b", "x")):
        assert hear(ledger, life, block, 0) is Verdict.NEW
    hear(ledger, "a", "x", 1)
    assert [ledger.upto(*stream) for stream in (("a", "x"), ("a", "y"), ("b", "x"), ("c", "x"))] == [
        2,
        1,
        1,
        0,
    ]


def test_judging_changes_nothing():
    ledger = Ledger()
    hear(ledger, "a", "b", 0)
    before = ledger.state()
    for seq in (0, 1, 7):
        ledger.judge("a", "b", seq)
        ledger.judge("stranger", "b", seq)
    assert ledger.state() == before


def test_what_is_not_new_cannot_be_accepted_and_what_is_new_not_refused():
    ledger = Ledger()
    with pytest.raises(ValueError, match="segment 1 of a/b is out-of-order"):
        ledger.accept("a", "b", 1)
    with pytest.raises(ValueError, match="is new and may not be refused"):
        ledger.refuse("a", "b", 0)
    assert ledger.new == 0


def test_a_refusal_names_both_numbers():
    ledger = Ledger()
    hear(ledger, "a", "b", 0)
    refusal = ledger.refuse("a", "b", 5)
    assert refusal.reason is Reason.OUT_OF_ORDER
    assert str(refusal) == "segment 5 of a/b came where 1 is expected"


def test_what_a_gone_sender_made_up_is_lost_within_what_a_status_can_say():
    ledger = Ledger()
    for life in ("a-1", "a-2"):
        ledger.refuse(life, "body", 2**53)
        ledger.forget(life)
    assert ledger.lost == 2**53


def test_a_gap_counts_as_lost_only_when_its_sender_is_gone_for_good():
    ledger = Ledger()
    hear(ledger, "a", "b", 0)
    hear(ledger, "a", "b", 3)
    assert ledger.lost == 0
    ledger.forget("a")
    ledger.forget("a")
    assert ledger.lost == 3
    assert hear(ledger, "a", "b", 1) is Verdict.NEW, "its link was down, it was not gone"
    assert ledger.lost == 0
    ledger.forget("a")
    assert ledger.lost == 2


def test_forgetting_a_life_that_was_never_heard_is_nothing():
    ledger = Ledger()
    ledger.forget("a")
    assert ledger.state() == Ledger().state()


def test_memory_is_bounded_and_only_gone_lives_make_room():
    ledger = Ledger(max_lives=2)
    hear(ledger, "a", "b", 0)
    hear(ledger, "a", "b", 2)
    hear(ledger, "c", "b", 0)
    assert hear(ledger, "d", "b", 0) is Verdict.NO_ROOM
    assert hear(ledger, "d", "b", 4) is Verdict.NO_ROOM
    assert ledger.turned_away == 2
    ledger.forget("c")
    ledger.forget("a")
    assert hear(ledger, "d", "b", 0) is Verdict.NEW
    assert (ledger.forgotten, ledger.lost) == (1, 2)
    assert ledger.judge("a", "b", 1) is Verdict.NEW, "c was gone for longer"
    assert hear(ledger, "e", "b", 0) is Verdict.NEW
    assert (ledger.forgotten, ledger.lost) == (2, 2), "a is gone from memory, its loss is not"
    assert hear(ledger, "f", "b", 0) is Verdict.NO_ROOM


def test_a_life_cannot_fill_the_memory_with_blocks():
    ledger = Ledger()
    verdicts = [hear(ledger, "a", f"b{block}", 0) for block in range(300)]
    assert verdicts.count(Verdict.NEW) == 256
    assert set(verdicts[256:]) == {Verdict.NO_ROOM}
    assert [hear(ledger, "a", f"x{block}", 5) for block in range(9)] == [Verdict.NO_ROOM] * 9


def test_gaps_of_strangers_do_not_fill_the_memory():
    ledger = Ledger(max_lives=1)
    hear(ledger, "a", "b", 0)
    ledger.forget("a")
    for stranger in range(50):
        assert hear(ledger, f"s{stranger}", "b", 1) is Verdict.GAP
    assert len(ledger.state()["streams"]) == 1


events = st.lists(
    st.tuples(st.sampled_from("abc"), st.sampled_from("xy"), st.integers(0, 4), st.booleans()), max_size=60
)


@given(history=events, later=events)
def test_a_restored_ledger_goes_on_as_the_one_that_was_saved(history, later):
    first, second = Ledger(max_lives=2), Ledger(max_lives=2)
    play(first, history)
    second.restore(json.loads(json.dumps(first.state())))
    assert (second.lost, second.state()) == (first.lost, first.state())
    assert play(first, later) == play(second, later)
    assert second.state() == first.state()


def play(ledger: Ledger, history: list[tuple[str, str, int, bool]]) -> list[Verdict]:
    """The verdicts on a history of segments and farewells."""
    verdicts = []
    for life, block, seq, gone in history:
        if gone:
            ledger.forget(life)
        else:
            verdicts.append(hear(ledger, life, block, seq))
    return verdicts


@given(history=events)
def test_each_stream_is_taken_once_and_in_order(history):
    ledger, taken = Ledger(), {}
    for life, block, seq, _ in history:
        if hear(ledger, life, block, seq) is Verdict.NEW:
            taken.setdefault((life, block), []).append(seq)
    for stream, seqs in taken.items():
        assert seqs == list(range(len(seqs)))
        assert ledger.upto(*stream) == len(seqs)
    assert ledger.new == sum(map(len, taken.values()))
    assert ledger.new + ledger.duplicated + ledger.gaps == len(history)
