"""Behind TLS and the table of rights, a router may be killed at any time, as without them."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from protocol import keys
from services.runtime.bus import Frame, Inbox, Membership, Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.attacks import all_until
from tests.processes.credentials_stage import CredentialsStage, GuardedRouter
from tests.processes.owned import Owner, wait_for

pytestmark = pytest.mark.processes

LIFE = "actor-lab-00000001"
PHASE, MODEL, MODELS = keys.phase("r"), keys.model("r", "encoder", "body"), keys.model("r", "*", "*")
ALIVE, SEGMENT = keys.alive("r", "actor", LIFE), keys.segment("r", "encoder_learner", "body", LIFE)

Join = Callable[[str], ZenohBus]


@pytest.fixture
def stage(tmp_path: Path) -> CredentialsStage:
    """An authority of this test."""
    return CredentialsStage(tmp_path)


@pytest.fixture
def guarded(owner: Owner, stage: CredentialsStage) -> GuardedRouter:
    """A router that can be killed and started again."""
    return stage.router(owner, ["lab", "other"])


@pytest.fixture
def join(stage: CredentialsStage, guarded: GuardedRouter) -> Iterator[Join]:
    """Connects under an identity; closed at the end."""
    with ExitStack() as closing:

        def joined(who: str) -> ZenohBus:
            bus = ZenohBus(guarded.endpoint, f"{who}-1", Wakeup(), 10.0, stage.credential(who))
            closing.callback(bus.close)
            return bus

        yield joined


def listening(bus: ZenohBus) -> dict[str, Inbox]:
    """What an actor hears of phase and models from now on, by key."""
    inboxes = {PHASE: Inbox(), MODEL: Inbox()}
    bus.subscribe("phase", PHASE, inboxes[PHASE])
    bus.subscribe("model", MODELS, inboxes[MODEL])
    return inboxes


def hears(inboxes: dict[str, Inbox], word: bytes) -> None:
    """Soon, of both."""
    for key, inbox in inboxes.items():
        all_until(inbox, Frame(key, word))


def restart(router: GuardedRouter, buses: list[ZenohBus], meanwhile: Callable[[], None]) -> None:
    """Kill the router, do something once all have noticed, start another."""
    router.process.kill()
    wait_for("all to notice", lambda: not any(bus.linked() for bus in buses))
    meanwhile()
    router.start_again()
    wait_for("all to return", lambda: all(bus.linked() for bus in buses))


def test_what_is_newest_reaches_who_was_there_and_who_comes_late(guarded: GuardedRouter, join: Join) -> None:
    coordinator, learner, actor = join("coordinator"), join("encoder_learner"), join("actor.lab")

    def say(word: bytes) -> None:
        coordinator.publish("phase", PHASE, word)
        learner.publish("model", MODEL, word)

    say(b"old")
    inboxes = listening(actor)
    hears(inboxes, b"old")
    restart(guarded, [coordinator, learner, actor], lambda: say(b"new"))
    hears(inboxes, b"new")
    hears(listening(join("actor.other")), b"new")


def test_members_experience_and_acknowledgements_come_back(guarded: GuardedRouter, join: Join) -> None:
    coordinator, learner, actor = join("coordinator"), join("encoder_learner"), join("actor.lab")
    members, segments, acks = Inbox(), Inbox(), Inbox()
    coordinator.watch(keys.alive("r", "*", "*"), members)
    learner.subscribe("segment", keys.segment("r", "encoder_learner", "*", "*"), segments)
    actor.subscribe("ack", keys.ack("r", LIFE, "*"), acks)
    actor.announce(ALIVE)
    all_until(members, Membership(ALIVE, True))
    restart(guarded, [coordinator, learner, actor], lambda: None)
    all_until(members, Membership(ALIVE, True))

    def acknowledged() -> bool:
        actor.publish("segment", SEGMENT, b"words")
        if segments.take_all():
            learner.publish("ack", keys.ack("r", LIFE, "encoder_learner"), b"read")
        return len(acks) > 0

    wait_for("an acknowledgement", acknowledged)
