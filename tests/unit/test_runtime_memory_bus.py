"""The memory bus: what it delivers, to whom, in which order, and what its faults do."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from protocol import keys
from protocol.keys import MAX_FRAME_BYTES
from protocol.refusal import Reason, Refused
from services.runtime.bus import Frame, Inbox, Link, Membership, Question
from services.runtime.errors import BusError
from services.runtime.memory_bus import Connection, Faults, MemoryBus, matches

MODEL = keys.model("r", "encoder", "body")
STREAM = keys.segment("r", "learner", "body", "actor-1")


def data(inbox: Inbox) -> list[bytes]:
    return [arrival.data for arrival in inbox.take_all() if isinstance(arrival, Frame)]


def heard(bus: Connection, kind: str, key_expr: str) -> Inbox:
    inbox = Inbox(max_frames=100_000)
    bus.subscribe(kind, key_expr, inbox)
    return inbox


@pytest.mark.parametrize(
    ("key_expr", "key", "covered"),
    [
        ("a/b", "a/b", True),
        ("a/b", "a/b/c", False),
        ("a/*", "a/b", True),
        ("a/*", "a/b/c", False),
        ("a/*", "a", False),
        ("*/b", "a/b", True),
        ("a/**", "a", True),
        ("a/**", "a/b/c", True),
        ("a/**/d", "a/d", True),
        ("a/**/d", "a/b/c/d", True),
        ("a/**/d", "a/b/c", False),
        ("**", "a/b", True),
    ],
)
def test_key_expressions_cover_keys_chunk_by_chunk(key_expr: str, key: str, covered: bool) -> None:
    assert matches(key_expr, key) is covered


def test_every_matching_subscriber_hears_and_no_other() -> None:
    hub = MemoryBus()
    actor, one, two = hub.connect("actor-1"), hub.connect("a"), hub.connect("b")
    exact, wild = heard(one, "segment", STREAM), heard(two, "segment", keys.segment("r", "learner", "*", "*"))
    other = heard(two, "segment", keys.segment("r", "policy", "*", "*"))
    actor.publish("segment", STREAM, b"1")
    assert (data(exact), data(wild), data(other)) == ([b"1"], [b"1"], [])


def test_a_late_joiner_hears_only_the_newest_of_what_is_retained() -> None:
    hub = MemoryBus()
    learner = hub.connect("learner")
    for version in (b"1", b"2"):
        learner.publish("model", MODEL, version)
        learner.publish("segment", STREAM, version)
    late = hub.connect("late")
    models, segments = heard(late, "model", keys.model("r", "*", "*")), heard(late, "segment", STREAM)
    learner.publish("model", MODEL, b"3")
    assert (data(models), data(segments)) == ([b"2", b"3"], [])


def test_what_a_crashed_process_retained_goes_with_it() -> None:
    hub = MemoryBus()
    hub.connect("learner").publish("model", MODEL, b"1")
    hub.crash("learner")
    assert data(heard(hub.connect("late"), "model", MODEL)) == []


def test_members_come_and_go_by_closing_or_crashing() -> None:
    hub = MemoryBus()
    here, coming, watcher, inbox = hub.connect("a"), hub.connect("b"), hub.connect("c"), Inbox()
    here.announce(keys.alive("r", "actor", "a"))
    watcher.watch(keys.alive("r", "actor", "*"), inbox)
    coming.announce(keys.alive("r", "actor", "b"))
    coming.announce(keys.alive("r", "recorder", "b"))
    here.close()
    hub.crash("b")
    members = [(keys.member(m.key)[1], m.present) for m in inbox.take_all() if isinstance(m, Membership)]
    assert members == [("a", True), ("b", True), ("a", False), ("b", False)]


def test_a_cut_link_loses_frames_and_hides_members_until_it_is_mended() -> None:
    hub = MemoryBus()
    actor, learner = hub.connect("actor-1"), hub.connect("learner")
    segments, actor_sees, learner_sees = heard(learner, "segment", STREAM), Inbox(), Inbox()
    actor.announce(keys.alive("r", "actor", "actor-1"))
    learner.announce(keys.alive("r", "learner", "learner"))
    actor.watch(keys.alive("r", "learner", "*"), actor_sees)
    actor.watch_link(actor_sees)
    learner.watch(keys.alive("r", "actor", "*"), learner_sees)
    learner.watch_link(learner_sees)

    hub.cut("actor-1")
    assert not actor.linked()
    assert learner.linked()
    actor.publish("segment", STREAM, b"lost")
    assert data(segments) == []
    assert hub.dropped == 1
    hub.mend("actor-1")
    assert actor.linked()
    actor.publish("segment", STREAM, b"heard")
    assert data(segments) == [b"heard"]

    learner_key, actor_key = keys.alive("r", "learner", "learner"), keys.alive("r", "actor", "actor-1")
    lost_and_found = [Link(False), Membership(learner_key, False), Link(True), Membership(learner_key, True)]
    assert actor_sees.take_all() == [Membership(learner_key, True), *lost_and_found]
    assert learner_sees.take_all() == [Membership(actor_key, present) for present in (True, False, True)]


@pytest.mark.parametrize("cut", ["learner", "actor-1"])
def test_a_mended_link_brings_the_newest_retained_frame_once(cut: str) -> None:
    hub = MemoryBus()
    learner, actor = hub.connect("learner"), hub.connect("actor-1")
    models = heard(actor, "model", MODEL)
    learner.publish("model", MODEL, b"1")
    hub.cut(cut)
    learner.publish("model", MODEL, b"2")
    learner.publish("model", MODEL, b"3")
    assert data(models) == [b"1"]
    hub.mend(cut)
    assert data(models) == [b"3"]
    hub.cut(cut)
    hub.mend(cut)
    assert data(models) == []


def play(seed: int, faults: Faults, count: int = 400) -> tuple[list[int], MemoryBus]:
    hub = MemoryBus(seed)
    hub.faults = faults
    actor, learner = hub.connect("actor-1"), hub.connect("learner")
    segments = heard(learner, "segment", STREAM)
    for seq in range(count):
        actor.publish("segment", STREAM, seq.to_bytes(4, "big"))
    for _ in range(20):
        actor.publish("status", keys.status("r", "actor", "actor-1"), b"")
    return [int.from_bytes(frame, "big") for frame in data(segments)], hub


def test_faults_of_each_sort_happen_about_as_often_as_asked_and_are_counted() -> None:
    sequence, hub = play(1, Faults(drop=0.1))
    assert len(sequence) == 400 - hub.dropped
    assert 15 < hub.dropped < 80
    sequence, hub = play(1, Faults(duplicate=0.1))
    assert len(sequence) == 400 + hub.duplicated
    assert 15 < hub.duplicated < 80
    sequence, hub = play(1, Faults(reorder=0.1))
    assert sequence != sorted(sequence)
    assert sorted(sequence) == list(range(400))
    assert 15 < hub.reordered < 80


def test_faults_touch_only_the_kinds_named() -> None:
    sequence, hub = play(1, Faults(drop=1.0, kinds={"ack"}))
    assert sequence == list(range(400))
    assert hub.dropped == 0


@given(st.integers(0, 2**32))
@settings(max_examples=30, deadline=None)
def test_the_same_seed_gives_the_same_history(seed: int) -> None:
    faults = Faults(drop=0.1, duplicate=0.1, reorder=0.1)
    assert play(seed, faults, 40)[0] == play(seed, faults, 40)[0]


def test_different_seeds_give_different_histories() -> None:
    faults = Faults(drop=0.1, duplicate=0.1, reorder=0.1)
    assert play(1, faults)[0] != play(2, faults)[0]


def test_a_question_is_answered_when_the_services_get_their_turn() -> None:
    hub = MemoryBus()
    asker, answerer, inbox = hub.connect("launcher"), hub.connect("coordinator"), Inbox()
    key = keys.command("r", "coordinator")
    answerer.answer(key, inbox)

    def turn() -> None:
        match inbox.take():
            case Question(data=asked, reply=reply):
                reply(b"re: " + asked)

    hub.pump = turn
    assert asker.ask(key, b"stop", 1.0) == b"re: stop"
    hub.pump = lambda: None
    assert asker.ask(key, b"stop", 1.0) is None
    assert asker.ask(keys.command("r", "nobody"), b"stop", 1.0) is None
    hub.cut("coordinator")
    assert asker.ask(key, b"stop", 1.0) is None


def test_oversized_frames_are_refused_and_a_closed_connection_says_so() -> None:
    hub = MemoryBus()
    actor = hub.connect("actor-1")
    with pytest.raises(Refused) as refusal:
        actor.publish("model", MODEL, bytes(MAX_FRAME_BYTES + 1))
    assert refusal.value.reason is Reason.OVERSIZED
    actor.close()
    actor.close()
    assert not actor.linked()
    with pytest.raises(BusError, match=r"actor-1.*closed"):
        actor.publish("model", MODEL, b"1")


def test_a_life_name_joins_once() -> None:
    hub = MemoryBus()
    hub.connect("actor-1")
    with pytest.raises(ValueError, match="actor-1"):
        hub.connect("actor-1")
