"""What the router does not let a valid certificate do, each from the attacker's side, with a witness."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest

from services.runtime.bus import Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.attacks import COMMAND, OTHER_LIFE, Act, Hall
from tests.processes.credentials_stage import ATTACKER, CredentialsStage
from tests.processes.owned import Owner

pytestmark = pytest.mark.processes

HONEST = ("coordinator", "encoder_learner", "dashboard", "launcher", "recorder", "actor.other")
LAB_LIFE = "actor-lab-00000009"
"""Of the attacker, where it has the credential of the actors of the host "lab"."""

DENIED = [
    Act("actor.lab", "says", "phase"),
    Act("actor.lab", "retains", "phase"),
    Act("actor.lab", "deletes", "phase"),
    Act("actor.lab", "says", "settings"),
    Act("actor.lab", "retains", "settings"),
    Act("actor.lab", "deletes", "settings"),
    Act("actor.lab", "says", "model/encoder/body"),
    Act("actor.lab", "retains", "model/encoder/body"),
    Act("actor.lab", "deletes", "model/encoder/body"),
    Act("actor.lab", "retains", "model/policy/body"),
    Act("actor.lab", "says", f"ack/{OTHER_LIFE}/encoder_learner"),
    Act("actor.lab", "says", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    Act("actor.lab", "says", "segment/encoder_learner/body/actor-lab_2-00000009"),
    Act("actor.lab", "says", f"status/actor/{OTHER_LIFE}"),
    Act("actor.lab", "deletes", f"status/actor/{OTHER_LIFE}"),
    Act("actor.lab", "says", f"status/coordinator/{LAB_LIFE}"),
    Act("actor.lab", "says", "status/coordinator/coordinator-00000009"),
    Act("actor.lab", "says", f"view/posture/{OTHER_LIFE}"),
    Act("actor.lab", "announces", "alive/coordinator/coordinator-00000009"),
    Act("actor.lab", "announces", "alive/actor/actor-other-00000009"),
    Act("actor.lab", "announces", f"alive/coordinator/{LAB_LIFE}"),
    Act("actor.lab", "announces", "alive/actor/actor-lab-$*"),
    Act("actor.lab", "announces", "alive/actor/actor-lab-NOBODY"),
    Act("actor.lab", "asks", COMMAND),
    Act("actor.lab", "asks", "@/*/router/**"),
    Act("actor.lab", "asks", "**"),
    Act("actor.lab", "answers", COMMAND),
    Act("actor.lab", "hears", "segment/*/*/*"),
    Act("actor.lab", "hears", "status/*/*"),
    Act("actor.lab", "hears", "view/*/*"),
    Act("actor.lab", "hears", f"ack/{OTHER_LIFE}/*"),
    Act("actor.lab", "hears", "ack/*/*"),
    Act("actor.lab", "hears", "**"),
    Act("actor.lab", "watches", "alive/*/*"),
    Act("actor.lab", "says", "phase", calls_itself="router"),
    Act("actor.lab", "announces", "alive/coordinator/coordinator-00000009", calls_itself="router"),
    Act("actor.lab", "hears", "**", calls_itself="router"),
    Act("actor.lab", "says", "phase", calls_itself="peer"),
    Act("encoder_learner", "says", "phase"),
    Act("encoder_learner", "retains", "phase"),
    Act("encoder_learner", "says", "settings"),
    Act("encoder_learner", "says", "model/policy/body"),
    Act("encoder_learner", "retains", "model/policy/body"),
    Act("encoder_learner", "deletes", "model/encoder/body"),
    Act("encoder_learner", "says", f"ack/{OTHER_LIFE}/policy_learner"),
    Act("encoder_learner", "says", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    Act("encoder_learner", "says", "status/policy_learner/policy_learner-00000009"),
    Act("encoder_learner", "announces", "alive/actor/actor-other-00000009"),
    Act("encoder_learner", "asks", COMMAND),
    Act("encoder_learner", "hears", "segment/policy_learner/*/*"),
    Act("encoder_learner", "hears", "status/*/*"),
    Act("encoder_learner", "watches", "alive/*/*"),
    Act("policy_learner", "says", "phase"),
    Act("policy_learner", "retains", "model/encoder/body"),
    Act("policy_learner", "hears", "segment/encoder_learner/*/*"),
    Act("coordinator", "says", "model/encoder/body"),
    Act("coordinator", "says", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    Act("coordinator", "asks", COMMAND),
    Act("dashboard", "says", "phase"),
    Act("dashboard", "says", "settings"),
    Act("dashboard", "says", "model/encoder/body"),
    Act("dashboard", "says", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    Act("dashboard", "says", f"view/posture/{OTHER_LIFE}"),
    Act("dashboard", "announces", "alive/coordinator/coordinator-00000009"),
    Act("dashboard", "asks", COMMAND),
    Act("dashboard", "asks", "model/*/*/@adv/**"),
    Act("dashboard", "answers", COMMAND),
    Act("dashboard", "hears", "segment/*/*/*"),
    Act("dashboard", "hears", "model/*/*"),
    Act("launcher", "says", "phase"),
    Act("launcher", "retains", "phase"),
    Act("launcher", "says", "settings"),
    Act("launcher", "says", f"status/actor/{OTHER_LIFE}"),
    Act("launcher", "announces", "alive/coordinator/coordinator-00000009"),
    Act("launcher", "answers", COMMAND),
    Act("launcher", "hears", "segment/*/*/*"),
    Act("recorder", "says", "phase"),
    Act("recorder", "says", "model/encoder/body"),
    Act("recorder", "says", f"ack/{OTHER_LIFE}/encoder_learner"),
    Act("recorder", "says", f"segment/encoder_learner/body/{OTHER_LIFE}"),
    Act("recorder", "says", f"status/actor/{OTHER_LIFE}"),
    Act("recorder", "asks", COMMAND),
    Act("recorder", "hears", "segment/*/*/*"),
    Act("recorder", "hears", "status/*/*"),
    Act("recorder", "hears", "model/*/*"),
    Act("recorder", "watches", "alive/*/*"),
]
"""Who may not do what at which key, though it has a certificate."""

ALLOWED = [
    Act("actor.lab", "hears", "phase"),
    Act("actor.lab", "hears", "settings"),
    Act("actor.lab", "hears", "model/*/*"),
    Act("actor.lab", "asks", "model/*/*/@adv/**"),
    Act("actor.other", "hears", f"ack/{OTHER_LIFE}/*"),
    Act("actor.lab", "says", f"segment/encoder_learner/body/{LAB_LIFE}"),
    Act("actor.lab", "says", f"status/actor/{LAB_LIFE}"),
    Act("actor.lab", "says", f"view/posture/{LAB_LIFE}"),
    Act("actor.lab", "announces", f"alive/actor/{LAB_LIFE}"),
    Act("encoder_learner", "hears", "phase"),
    Act("encoder_learner", "hears", "segment/encoder_learner/*/*"),
    Act("encoder_learner", "watches", "alive/actor/*"),
    Act("encoder_learner", "says", f"ack/{OTHER_LIFE}/encoder_learner"),
    Act("encoder_learner", "retains", "model/encoder/body"),
    Act("policy_learner", "retains", "model/policy/body"),
    Act("policy_learner", "announces", "alive/policy_learner/policy_learner-00000009"),
    Act("coordinator", "retains", "phase"),
    Act("coordinator", "retains", "settings"),
    Act("coordinator", "hears", "status/*/*"),
    Act("coordinator", "watches", "alive/*/*"),
    Act("coordinator", "answers", COMMAND),
    Act("dashboard", "hears", "view/*/*"),
    Act("dashboard", "hears", "status/*/*"),
    Act("dashboard", "hears", "phase"),
    Act("dashboard", "watches", "alive/*/*"),
    Act("dashboard", "says", "status/dashboard/dashboard-00000009"),
    Act("launcher", "hears", "phase"),
    Act("launcher", "watches", "alive/*/*"),
    Act("launcher", "asks", COMMAND),
    Act("recorder", "hears", "segment/recorder/*/*"),
    Act("recorder", "hears", "phase"),
    Act("recorder", "says", f"ack/{OTHER_LIFE}/recorder"),
    Act("recorder", "watches", "alive/actor/*"),
    Act("recorder", "announces", "alive/recorder/recorder-00000009"),
]
"""Who may do what, and is noticed when it does."""

ONE_OF_EACH = {act.does: act for act in reversed(DENIED)}


@pytest.fixture(scope="module")
def hall(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Hall]:
    """Behind TLS and the table of rights; the attacker has stolen whatever credential it needs."""
    stage = CredentialsStage(tmp_path_factory.mktemp("certs"))
    with Owner() as owner, ExitStack() as closing:
        router = stage.router(owner, ["lab", "other"])
        buses = {}
        for who in HONEST:
            buses[who] = ZenohBus(router.endpoint, f"{who}-1", Wakeup(), 10.0, stage.credential(who))
            closing.callback(buses[who].close)
        yield Hall(router.endpoint, owner, buses, stage.path)


@pytest.fixture(scope="module")
def open_hall() -> Iterator[Hall]:
    """A plain router, where everybody may do everything."""

    def nothing(_: str) -> Path | None:
        return None

    with Owner() as owner, ExitStack() as closing:
        router = owner.router()
        buses = {who: ZenohBus(router.endpoint, f"{who}-1", Wakeup(), 10.0) for who in HONEST}
        for bus in buses.values():
            closing.callback(bus.close)
        yield Hall(router.endpoint, owner, buses, nothing)


def repeats(act: Act) -> bool:
    """True if an actor tries the same: then the table alone differs, which test_router_access.py checks."""
    return act.who != "actor.lab" and Act("actor.lab", act.does, act.key) in DENIED


@pytest.mark.parametrize(
    "act", [pytest.param(act, marks=pytest.mark.slow if repeats(act) else ()) for act in DENIED], ids=str
)
def test_denied(hall: Hall, act: Act) -> None:
    assert hall.attack(act) == []


@pytest.mark.parametrize("act", ALLOWED, ids=str)
def test_allowed(hall: Hall, act: Act) -> None:
    assert hall.attack(act) != []


def test_an_actor_hears_by_heartbeats_that_it_missed_a_model(hall: Hall) -> None:
    heartbeats = "babble/heartbeats/model/*/*/@adv/pub/**"
    given = (hall.endpoint, str(hall.stolen("actor.lab")), "client", "hears", heartbeats)
    actor = hall.owner.start_code("actor", ATTACKER, *given)
    actor.expect("door 1")
    hall.say("model", "heartbeats", b"newest")
    actor.expect("model/encoder/body/@adv/pub/")


@pytest.mark.parametrize("does", ONE_OF_EACH)
def test_the_witnesses_notice_the_same_where_nothing_is_denied(open_hall: Hall, does: str) -> None:
    assert open_hall.attack(ONE_OF_EACH[does]) != []
