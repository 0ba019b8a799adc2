"""The list of hosts is edited while the router runs: who is added may work, who is taken out may not."""

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import encode
from protocol.messages import Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.credentials_stage import CredentialsStage, GuardedRouter
from tests.processes.owned import Owner, wait_for

pytestmark = pytest.mark.processes

RUN = "r"
BACK_SECS = 10.0


class Lab:
    """A guarded router, and processes of this test that hear and speak through it."""

    def __init__(self, owner: Owner, folder: Path) -> None:
        self.stage = CredentialsStage(folder)
        self.credential = self.stage.path("router")
        hosts = folder / "hosts"
        hosts.write_text("old\n")
        self.router = GuardedRouter(owner, hosts, "--credential", str(self.credential), "--hosts", str(hosts))
        self.buses: list[ZenohBus] = []
        self._heard = Inbox()
        listener = self.join("dashboard", "dashboard-00000001")
        listener.subscribe("status", keys.status(RUN, "actor", "*"), self._heard)
        self._sent = 0

    def join(self, identity: str, life: str) -> ZenohBus:
        """Connect a process of this test."""
        bus = ZenohBus(self.router.endpoint, life, Wakeup(), 10.0, self.stage.credential(identity))
        self.buses.append(bus)
        return bus

    def arrives(self, bus: ZenohBus, life: str) -> Callable[[], bool]:
        """Sends a status each time it is asked, and tells whether one has arrived since."""
        self._heard.take_all()

        def look() -> bool:
            status = Status(run=RUN, term=0, block="all", life=life, seq=self._sent, service="actor")
            bus.publish("status", keys.status(RUN, "actor", life), encode(status))
            self._sent += 1
            heard = self._heard.take_all()
            return any(isinstance(arrival, Frame) and arrival.key.endswith(life) for arrival in heard)

        return look

    def wait_for_log(self, text: str) -> str:
        """The first line of the router's log with the text."""
        lines = self.router.process.err
        return wait_for(text, lambda: next((line for line in list(lines) if text in line), None), BACK_SECS)


@pytest.fixture
def lab(owner: Owner, tmp_path: Path) -> Iterator[Lab]:
    """A router that lets in the host `old`."""
    made = Lab(owner, tmp_path)
    yield made
    for bus in made.buses:
        bus.close()


def test_a_host_that_is_added_may_work_at_once_and_the_others_come_back(lab: Lab) -> None:
    old = lab.join("actor.old", "actor-old-00000001")
    wait_for("the old host's status", lab.arrives(old, "actor-old-00000001"))
    lab.router.hosts.write_text("old\nnew\n")
    assert "added new" in lab.wait_for_log("opening anew")
    new = lab.join("actor.new", "actor-new-00000001")
    wait_for("the new host's status", lab.arrives(new, "actor-new-00000001"), BACK_SECS)
    wait_for("the old host's status again", lab.arrives(old, "actor-old-00000001"), BACK_SECS)
    assert lab.router.process.running()


def test_a_host_that_is_taken_out_is_turned_away_and_heard_no_more(lab: Lab) -> None:
    lab.router.hosts.write_text("old\nlost\n")
    lab.wait_for_log("added lost")
    lost, old = lab.join("actor.lost", "actor-lost-00000001"), lab.join("actor.old", "actor-old-00000001")
    wait_for("the host's status", lab.arrives(lost, "actor-lost-00000001"), BACK_SECS)
    lab.router.hosts.write_text("old\n")
    lab.wait_for_log("taken out lost")
    line = lab.wait_for_log("turned away 'actor.lost'")
    assert "127.0.0.1" in line
    wait_for("the other host's status", lab.arrives(old, "actor-old-00000001"), BACK_SECS)
    arrived = lab.arrives(lost, "actor-lost-00000001")
    assert not any(arrived() for _ in range(200))
    wait_for("the end of its connection", lambda: not lost.linked(), BACK_SECS)


@pytest.mark.parametrize(
    ("damage", "said"),
    [
        (lambda hosts: hosts.write_text("old\nLab-2\n"), "line 2 is 'Lab-2'"),
        (lambda hosts: hosts.unlink(), "cannot read the list of hosts"),
    ],
)
def test_a_list_that_is_none_changes_nothing(lab: Lab, damage: Callable[[Path], object], said: str) -> None:
    old = lab.join("actor.old", "actor-old-00000001")
    damage(lab.router.hosts)
    line = lab.wait_for_log(said)
    assert "goes on with the hosts it had" in line
    wait_for("the host's status", lab.arrives(old, "actor-old-00000001"))
    assert old.linked()
    lab.router.hosts.write_text("old\nnew\n")
    lab.wait_for_log("added new")
    assert len(lab.router.process.err) == 2


def test_a_renewed_credential_of_the_router_is_taken_up_and_a_damaged_one_is_not(lab: Lab) -> None:
    old = lab.join("actor.old", "actor-old-00000001")
    lab.credential.write_text("half of a fi")
    assert "goes on with the credential it had" in lab.wait_for_log("no credential")
    wait_for("the host's status", lab.arrives(old, "actor-old-00000001"))
    lab.credential.write_bytes(lab.stage.path("router").read_bytes())
    lab.wait_for_log("the router's own credential is new")
    wait_for("the host's status again", lab.arrives(old, "actor-old-00000001"), BACK_SECS)


def test_a_router_without_a_list_of_hosts_does_not_start(owner: Owner, tmp_path: Path) -> None:
    stage = CredentialsStage(tmp_path)
    process = owner.start_service(
        "router", "--listen", "tls/127.0.0.1:0", "--credential", str(stage.path("router"))
    )
    assert process.ended() == 2
    (sentence,) = process.err
    assert str(tmp_path / "hosts") in sentence
    assert "babble certs" in sentence
