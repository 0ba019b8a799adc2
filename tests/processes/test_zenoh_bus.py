"""The bus between processes does what `Bus` promises, through a real router."""

import time
from collections.abc import Callable, Iterator

import pytest

from protocol import keys
from protocol.keys import MAX_FRAME_BYTES
from protocol.refusal import Reason, Refused
from services.runtime.bus import Arrival, Frame, Inbox, Link, Membership, Question, Wakeup
from services.runtime.errors import BusError
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, RunningRouter, free_port, wait_for

pytestmark = pytest.mark.processes

Connect = Callable[[str], ZenohBus]
MODEL = keys.model("r", "encoder", "body")
PHASE = keys.phase("r")


@pytest.fixture(scope="module")
def router() -> Iterator[RunningRouter]:
    """One for all: nothing of a test is left once its connections are closed."""
    with Owner() as owner:
        yield owner.router()


def newest(inbox: Inbox) -> Callable[[], Frame | None]:
    def look() -> Frame | None:
        frames = [arrival for arrival in inbox.take_all() if isinstance(arrival, Frame)]
        return frames[-1] if frames else None

    return look


@pytest.mark.parametrize(
    ("kind", "key", "key_expr"),
    [("model", MODEL, keys.model("r", "*", "*")), ("phase", PHASE, PHASE)],
)
def test_a_late_joiner_hears_the_newest_and_only_it(
    connect: Connect, kind: str, key: str, key_expr: str
) -> None:
    early = connect("learner-1")
    for version in (b"1", b"2", b"3"):
        early.publish(kind, key, version)
    late, inbox = connect("actor-1"), Inbox()
    late.subscribe(kind, key_expr, inbox)
    wait_for("the retained frame", lambda: len(inbox) > 0)
    early.publish(kind, key, b"4")
    heard: list[bytes] = []

    def all_heard() -> bool:
        heard.extend(arrival.data for arrival in inbox.take_all() if isinstance(arrival, Frame))
        return b"4" in heard

    wait_for("the next frame", all_heard)
    assert heard == [b"3", b"4"]


def test_what_is_only_best_effort_is_not_retained(connect: Connect) -> None:
    early = connect("actor-1")
    key = keys.status("r", "actor", "actor-1")
    early.publish("status", key, b"old")
    late, inbox = connect("coordinator-1"), Inbox()
    late.subscribe("status", keys.status("r", "*", "*"), inbox)

    def heard() -> list[Frame]:
        early.publish("status", key, b"new")
        return [arrival for arrival in inbox.take_all() if isinstance(arrival, Frame)]

    assert all(frame == Frame(key, b"new") for frame in wait_for("a status", heard))


def test_a_model_of_5_mb_arrives_whole(connect: Connect) -> None:
    learner, actor, inbox = connect("learner-1"), connect("actor-1"), Inbox()
    actor.subscribe("model", MODEL, inbox)
    frame = bytes(range(256)) * 20_000
    learner.publish("model", MODEL, frame)
    assert wait_for("the model", newest(inbox)).data == frame


def test_a_frame_of_exactly_the_limit_arrives_and_one_byte_more_is_refused(connect: Connect) -> None:
    learner, actor, inbox = connect("learner-1"), connect("actor-1"), Inbox()
    actor.subscribe("model", MODEL, inbox)
    learner.publish("model", MODEL, bytes(MAX_FRAME_BYTES))
    assert len(wait_for("the model", newest(inbox), within_secs=30.0).data) == MAX_FRAME_BYTES
    with pytest.raises(Refused) as refusal:
        learner.publish("model", MODEL, bytes(MAX_FRAME_BYTES + 1))
    assert refusal.value.reason is Reason.OVERSIZED
    learner.publish("model", MODEL, b"small")
    assert wait_for("the next model", newest(inbox)).data == b"small"


def test_members_are_seen_coming_present_and_going(connect: Connect) -> None:
    first, watcher, inbox = connect("actor-1"), connect("coordinator-1"), Inbox()
    key = keys.alive("r", "actor", "actor-1")
    first.announce(key)
    watcher.watch(keys.alive("r", "*", "*"), inbox)
    assert wait_for("the member that was there", inbox.take) == Membership(key, True)
    second = connect("actor-2")
    second.announce(keys.alive("r", "actor", "actor-2"))
    assert wait_for("the member that came", inbox.take) == Membership(
        keys.alive("r", "actor", "actor-2"), True
    )
    first.close()
    assert wait_for("the member that went", inbox.take) == Membership(key, False)


def test_a_question_is_answered_on_the_answerers_own_time(
    owner: Owner, router: RunningRouter, connect: Connect
) -> None:
    key = keys.command("r", "coordinator")
    asker = owner.start_code(
        "asker",
        """
import sys
from services.runtime.bus import Wakeup
from services.runtime.zenoh_bus import ZenohBus
bus = ZenohBus(sys.argv[1], "launcher-1", Wakeup(), 10.0)
print("asking", flush=True)
print("answer:", bus.ask(sys.argv[2], b"how are you", 20.0))
bus.close()
""",
        router.endpoint,
        key,
    )
    bus, inbox = connect("coordinator-1"), Inbox()
    bus.answer(key, inbox)
    question = wait_for("the question", inbox.take, within_secs=20.0)
    assert isinstance(question, Question)
    assert (question.key, question.data) == (key, b"how are you")
    question.reply(b"well")
    asker.expect("answer: b'well'")
    assert asker.ended() == 0


def test_an_unanswered_question_ends_with_none(connect: Connect) -> None:
    asker, deaf, inbox = connect("launcher-1"), connect("coordinator-1"), Inbox()
    assert asker.ask(keys.command("r", "nobody"), b"?", 5.0) is None
    deaf.answer(keys.command("r", "coordinator"), inbox)

    def ask_in_vain() -> Arrival | None:
        # A question before the router has told who answers reaches nobody.
        began = time.monotonic()
        assert asker.ask(keys.command("r", "coordinator"), b"?", 0.5) is None
        assert time.monotonic() - began < 5.0
        return inbox.take()

    held = wait_for("the question", ask_in_vain)
    assert isinstance(held, Question)
    held.reply(b"too late")


def test_frames_on_one_key_arrive_in_order_and_complete(connect: Connect) -> None:
    actor, learner, inbox = connect("actor-1"), connect("encoder_learner-1"), Inbox(max_frames=1000)
    learner.subscribe("segment", keys.segment("r", "encoder_learner", "*", "*"), inbox)
    key = keys.segment("r", "encoder_learner", "body", "actor-1")
    wait_until_heard(actor, learner)
    for seq in range(500):
        actor.publish("segment", key, seq.to_bytes(4, "big") + bytes(2000))
    wait_for("500 segments", lambda: len(inbox) == 500, within_secs=20.0)
    heard = [
        int.from_bytes(arrival.data[:4], "big") for arrival in inbox.take_all() if isinstance(arrival, Frame)
    ]
    assert heard == list(range(500))


def wait_until_heard(sender: ZenohBus, receiver: ZenohBus) -> None:
    """Until what `receiver` subscribed so far is known to `sender`."""
    probe = Inbox()
    receiver.subscribe("segment", keys.segment("probe", "*", "*", "*"), probe)

    def heard() -> bool:
        sender.publish("segment", keys.segment("probe", "a", "b", "c"), b"")
        return len(probe) > 0

    wait_for("the subscription", heard)


def test_closing_with_live_subscribers_returns_and_then_everything_raises(connect: Connect) -> None:
    bus, other = connect("actor-1"), connect("learner-1")
    inbox = Inbox(max_frames=4)
    bus.subscribe("model", MODEL, inbox)
    bus.subscribe("segment", keys.segment("r", "*", "*", "*"), inbox)
    bus.watch(keys.alive("r", "*", "*"), inbox)
    bus.watch_link(inbox)
    bus.answer(keys.command("r", "actor"), inbox)
    bus.announce(keys.alive("r", "actor", "actor-1"))
    bus.publish("status", keys.status("r", "actor", "actor-1"), b"")
    for _ in range(50):
        other.publish("segment", keys.segment("r", "a", "b", "c"), bytes(100_000))
    began = time.monotonic()
    bus.close()
    bus.close()
    assert time.monotonic() - began < 2.5
    assert not bus.linked()
    assert not [arrival for arrival in inbox.take_all() if isinstance(arrival, Link)]
    with pytest.raises(BusError, match=r"actor-1.*closed"):
        bus.subscribe("model", MODEL, inbox)
    with pytest.raises(BusError, match="actor-1"):
        bus.publish("status", keys.status("r", "actor", "actor-1"), b"")


def test_no_router_is_one_sentence_after_the_deadline() -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    began = time.monotonic()
    with pytest.raises(BusError) as failure:
        ZenohBus(endpoint, "actor-1", Wakeup(), connect_secs=1.0)
    assert 0.9 < time.monotonic() - began < 5.0
    assert str(failure.value) == (
        f"no router answered at {endpoint} within 1 s: nobody listens there; "
        "start one with `python -m services.router` or check the address"
    )


def test_a_router_that_comes_later_is_found(owner: Owner) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = owner.start_service("router", "--listen", endpoint)
    bus = ZenohBus(endpoint, "actor-1", Wakeup(), connect_secs=20.0)
    assert bus.linked()
    bus.close()
    assert router.running()


def test_a_program_that_forgets_to_close_still_ends(owner: Owner, router: RunningRouter) -> None:
    process = owner.start_code(
        "careless",
        """
import sys
from services.runtime.bus import Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
bus = ZenohBus(sys.argv[1], "actor-1", Wakeup(), 10.0)
bus.subscribe("model", "babble/r/model/*/*", Inbox())
raise RuntimeError("oops")
""",
        router.endpoint,
    )
    assert process.ended() == 1
    assert "RuntimeError: oops" in process.err[-1]
