"""The watch over clients: who is over a limit is cut off, named, kept out for a while, and let in again."""

import logging
from collections.abc import Callable

import pytest

from protocol import keys
from protocol.codec import encode
from protocol.messages import Status
from services.router.bans import Bans
from services.router.conduct import Sliding
from services.router.turnstile import MUTE_POLLS
from tests.unit.router_stage import WatchStage

LIFE = "actor-lab-00000001"
SEGMENTS, STATUSES = keys.segment("*", "*", "*", "*"), keys.status("*", "actor", "*")
SEGMENT = keys.segment("r", "encoder_learner", "body", LIFE)
ALIVE = keys.alive("*", "actor", "*")


def status_of(life: str) -> bytes:
    return encode(Status(run="r", term=1, block="all", life=life, seq=0, service="actor"))


def send_many_bytes(stage: WatchStage) -> None:
    for peer, identity in stage.router.open.items():
        if identity == "actor.lab":
            stage.router.received[peer] += 60_000_000


def send_many_messages(stage: WatchStage) -> None:
    stage.router.publishes(STATUSES, keys.status("r", "actor", LIFE), status_of(LIFE), times=501)


def send_garbage(stage: WatchStage) -> None:
    stage.router.publishes(SEGMENTS, SEGMENT, b"garbage", times=6)


def send_another_ones_status(stage: WatchStage) -> None:
    other = status_of("actor-den-00000001")
    stage.router.publishes(STATUSES, keys.status("r", "actor", LIFE), other, times=6)


def have_many_lives(stage: WatchStage) -> None:
    for number in range(4):
        stage.router.announces(ALIVE, keys.alive("r", "actor", f"actor-lab-{number:08x}"))


def have_lives_that_nobody_can_have(stage: WatchStage) -> None:
    for end in ("A", "$*"):
        for run in ("r", "*", "s"):
            stage.router.announces(ALIVE, f"babble/{run}/alive/actor/actor-lab-{end}")
            stage.router.announces(ALIVE, f"babble/{run}/alive/actor/actor-lab-{end}", present=False)


def come_and_go(stage: WatchStage) -> None:
    for number in range(501):
        stage.router.announces(ALIVE, keys.alive("r", "actor", LIFE), present=number % 2 == 0)


def connect_often(stage: WatchStage) -> None:
    for port in range(6):
        stage.router.connect("actor.lab", 2000 + port)


@pytest.mark.parametrize(
    ("misbehave", "named"),
    [
        (send_many_bytes, "12.0 MB/s over 5 s (limit 10)"),
        (send_many_messages, "100 messages/s over 5 s (limit 100)"),
        (send_garbage, "6 frames of garbage in 10 s (limit 5), the last: not a MessagePack frame"),
        (send_another_ones_status, "its header belongs to"),
        (have_many_lives, "more than 3 processes at once"),
        (have_lives_that_nobody_can_have, "6 frames of garbage in 10 s (limit 5), the last: 'babble/s/alive"),
        (come_and_go, "messages/s"),
        (connect_often, "7 connections at once (limit 6)"),
    ],
)
def test_whoever_is_over_a_limit_is_cut_off_and_nobody_else(
    caplog: pytest.LogCaptureFixture, misbehave: Callable[[WatchStage], None], named: str
) -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    stage.router.connect("actor.den", 1002)
    stage.router.connect("encoder_learner", 1003)
    stage.poll()
    misbehave(stage)
    with caplog.at_level(logging.WARNING):
        stage.poll()
    (record,) = caplog.records
    for part in ("cut off actor.lab", "10.0.0.7", named, "kept out for 60 s"):
        assert part in record.message
    assert stage.watch.last_error == record.message
    assert set(stage.router.cut) == {"actor.lab"}
    assert set(stage.router.open.values()) == {"actor.den", "encoder_learner"}
    assert (stage.total("cut_off"), stage.total("banned")) == (1, 1)


@pytest.mark.parametrize("secs", [20, 60])
def test_what_keeps_below_the_limits_is_never_cut_off(secs: int) -> None:
    stage = WatchStage()
    peer = stage.router.connect("actor.lab", 1001)
    for number in range(3):
        stage.router.announces(ALIVE, keys.alive("r", "actor", f"actor-lab-{number:08x}"))
    for _ in range(secs * 4):
        stage.router.received[peer] += 2_400_000
        stage.router.publishes(STATUSES, keys.status("r", "actor", LIFE), status_of(LIFE), times=24)
        stage.poll()
    assert stage.router.cut == []
    assert stage.total("bytes") == secs * 4 * 2_400_000
    assert stage.total("messages") == secs * 4 * 24


def test_a_short_burst_is_no_flood() -> None:
    stage = WatchStage()
    peer = stage.router.connect("actor.lab", 1001)
    for _ in range(10):
        stage.router.received[peer] += 45_000_000
        stage.poll()
        stage.poll(after_secs=6.0)
    assert stage.router.cut == []


def test_a_new_connection_on_an_old_port_begins_anew() -> None:
    stage = WatchStage()
    peer = stage.router.connect("actor.lab", 1001)
    stage.router.received[peer] = 30_000_000
    stage.poll()
    stage.router.received[peer] = 1_000_000
    stage.poll()
    assert stage.total("bytes") == 31_000_000


def test_while_it_is_kept_out_each_new_connection_is_cut_and_afterwards_it_may_come_again(
    caplog: pytest.LogCaptureFixture,
) -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    have_many_lives(stage)
    stage.poll()
    stage.router.cut.clear()
    for port in range(1100, 1110):
        stage.router.connect("actor.lab", port)
        stage.poll(after_secs=5.0)
    assert stage.router.cut == ["actor.lab"] * 10
    with caplog.at_level(logging.INFO):
        stage.poll(after_secs=11.0)
    assert "actor.lab may connect again; 11 of its connections were cut" in caplog.text
    stage.router.connect("actor.lab", 1200)
    stage.poll()
    assert ("10.0.0.7", 1200) in stage.router.open
    assert stage.total("banned") == 0


def test_a_new_connection_of_one_who_is_kept_out_is_not_heard_and_cut_only_after_a_while() -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    have_many_lives(stage)
    stage.poll()
    stage.router.cut.clear()
    peer = stage.router.knock("actor.lab", 1002)
    stage.router.knock("actor.den", 1003)
    assert stage.router.mute == [peer]
    for _ in range(MUTE_POLLS):
        stage.poll()
    assert stage.router.cut == []
    stage.poll()
    assert stage.router.cut == ["actor.lab"]
    assert stage.total("turned_away") == 2


def test_what_slips_through_before_it_is_not_heard_is_undone_at_once() -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    have_many_lives(stage)
    stage.poll()
    stage.router.cut.clear()
    stage.router.knock("actor.lab", 1002)
    stage.router.announces(ALIVE, keys.alive("r", "actor", "actor-den-00000001"))
    assert stage.router.cut == []
    stage.router.announces(ALIVE, keys.alive("r", "actor", LIFE))
    assert stage.router.cut == ["actor.lab"]


def test_what_waited_when_it_was_cut_off_does_not_count_against_it_later() -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    for _ in range(3):
        send_many_messages(stage)
        send_garbage(stage)
        stage.poll()
    stage.poll(after_secs=61.0)
    stage.poll()
    assert stage.total("cut_off") == 1


def test_who_is_not_listed_is_turned_away_and_named_once(caplog: pytest.LogCaptureFixture) -> None:
    stage = WatchStage("lab")
    with caplog.at_level(logging.WARNING):
        for port, identity in enumerate(["actor.den", "actor.den", "stranger", "router", None]):
            stage.router.connect(identity, 1000 + port)
            stage.poll()
    assert stage.router.cut == ["actor.den", "actor.den", "stranger", "router", None]
    assert stage.total("turned_away") == 5
    assert [text.count("actor.den") for text in (record.message for record in caplog.records)] == [1, 0, 0, 0]


def test_who_connects_and_does_not_say_who_he_is_is_let_go() -> None:
    stage = WatchStage()
    stage.router.connect("actor.lab", 1001)
    stage.router.nameless |= {("10.0.0.8", 1), ("10.0.0.8", 2)}
    for _ in range(4):
        stage.poll(after_secs=2.0)
    stage.router.nameless.remove(("10.0.0.8", 2))
    stage.router.connect("actor.lab", 2, host="10.0.0.8")
    assert stage.router.cut == []
    stage.poll(after_secs=2.0)
    stage.poll(after_secs=20.0)
    assert stage.router.cut == ["nameless"]


def test_taking_a_host_out_and_in_again_lifts_its_ban() -> None:
    stage = WatchStage("lab", "den")
    stage.router.connect("actor.lab", 1001)
    have_many_lives(stage)
    stage.poll()
    stage.watch.attach(stage.router, frozenset({"den"}))
    stage.watch.attach(stage.router, frozenset({"lab", "den"}))
    stage.router.connect("actor.lab", 1002)
    stage.poll()
    assert stage.total("banned") == 0
    assert ("10.0.0.7", 1002) in stage.router.open


def test_a_role_of_the_run_has_the_same_limits() -> None:
    stage = WatchStage()
    peer = stage.router.connect("policy_learner", 1001)
    stage.router.received[peer] = 60_000_000
    stage.poll()
    assert "cut off policy_learner" in stage.watch.last_error


def test_each_ban_is_twice_as_long_up_to_an_hour_and_good_conduct_is_rewarded() -> None:
    bans, now_secs, lengths = Bans(), 0.0, []
    for _ in range(8):
        lengths.append(bans.ban("actor.lab", now_secs))
        assert bans.left_secs("actor.lab", now_secs + lengths[-1] - 1) > 0
        assert bans.banned(now_secs + lengths[-1]) == frozenset()
        now_secs += lengths[-1] + 100
    assert lengths == [60, 120, 240, 480, 960, 1920, 3600, 3600]
    assert bans.ban("actor.lab", now_secs + 3600) == 60


def test_a_sliding_sum_forgets() -> None:
    sliding = Sliding(5.0)
    for now_secs in range(10):
        sliding.add(float(now_secs), 2)
    assert sliding.sum(9.0) == 10
    assert sliding.sum(12.5) == 4
    assert sliding.sum(30.0) == 0
