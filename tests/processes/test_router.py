"""The router as a process: quick to start, quick to end, clear about what is wrong."""

import signal
import time
from pathlib import Path

import pytest

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Phase, PhaseAnnounced, Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, RunningRouter, free_port, wait_for

pytestmark = pytest.mark.processes

FLOOD = """
import sys
from services.runtime.bus import Inbox, Wakeup
from services.runtime.zenoh_bus import ZenohBus
bus = ZenohBus(sys.argv[1], "flooded-1", Wakeup(), 10.0)
inbox = Inbox()
bus.subscribe("segment", "babble/r/segment/*/*/*", inbox)
print("listening")
Wakeup().wait(60)
"""


def test_ready_soon(owner: Owner) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    process = owner.start_service("router", "--listen", endpoint)
    assert endpoint in process.expect("ready", within_secs=5.0)
    ZenohBus(endpoint, "actor-1", Wakeup(), connect_secs=5.0).close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_ends_it_soon_with_code_0(router: RunningRouter, number: int) -> None:
    bus = ZenohBus(router.endpoint, "actor-1", Wakeup(), connect_secs=10.0)
    router.process.interrupt(number)
    assert router.process.ended(within_secs=3.0) == 0
    assert router.process.err == []
    bus.close()


def test_a_frozen_client_does_not_keep_it_from_ending(owner: Owner, router: RunningRouter) -> None:
    frozen = owner.start_code("frozen", FLOOD, router.endpoint)
    frozen.expect("listening")
    bus = ZenohBus(router.endpoint, "actor-1", Wakeup(), connect_secs=10.0)
    frozen.freeze()
    for _ in range(30):
        bus.publish("segment", "babble/r/segment/encoder_learner/body/actor-1", bytes(1_000_000))
    router.process.interrupt()
    assert router.process.ended(within_secs=3.0) == 0
    bus.close()


def test_a_taken_address_is_one_sentence_and_code_2(owner: Owner, router: RunningRouter) -> None:
    second = owner.start_service("router", "--listen", router.endpoint)
    assert second.ended() == 2
    assert second.out == []
    (sentence,) = second.err
    assert router.endpoint in sentence
    assert "in use" in sentence
    assert "--listen" in sentence


def test_what_is_no_address_is_one_sentence_and_code_2(owner: Owner) -> None:
    process = owner.start_service("router", "--listen", "localhost:7447")
    assert process.ended() == 2
    (sentence,) = process.err
    assert "'localhost:7447' is not an address" in sentence


def test_a_closed_stdout_does_not_end_it(owner: Owner) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    code = f"""
import os, sys
os.close(1)
os.dup2(os.pipe()[1], 1)
sys.argv[1:] = ["--listen", {endpoint!r}]
from services.router.__main__ import main
sys.exit(main())
"""
    process = owner.start_code("router", code)
    bus = ZenohBus(endpoint, "actor-1", Wakeup(), connect_secs=5.0)
    bus.close()
    process.interrupt()
    assert process.ended() == 0


def test_it_is_small_and_idle(owner: Owner, router: RunningRouter) -> None:
    def cpu_ticks() -> int:
        with open(f"/proc/{router.process.pid}/stat") as stat:
            fields = stat.read().rsplit(")", 1)[1].split()
        return int(fields[11]) + int(fields[12])

    def resident_mb() -> float:
        with open(f"/proc/{router.process.pid}/statm") as statm:
            return int(statm.read().split()[1]) * 4096 / 1e6

    before, since = cpu_ticks(), time.monotonic()
    Wakeup().wait(1.0)
    busy_secs = (cpu_ticks() - before) / 100
    assert busy_secs / (time.monotonic() - since) < 0.2
    assert resident_mb() < 150


def test_plain_tcp_beyond_this_machine_is_refused_unless_it_is_asked_for(owner: Owner) -> None:
    endpoint = f"tcp/0.0.0.0:{free_port()}"
    refused = owner.start_service("router", "--listen", endpoint)
    assert refused.ended() == 2
    (sentence,) = refused.err
    assert endpoint in sentence
    assert "certificate" in sentence
    assert "--plain" in sentence
    asked = owner.start_service("router", "--listen", endpoint, "--plain")
    assert endpoint in asked.expect("ready")


def announce(bus: ZenohBus, term: int, phase: Phase) -> None:
    announced = PhaseAnnounced(
        run="r", term=term, block="all", life="coordinator-1", seq=0, phase=phase, blocks={}
    )
    bus.publish("phase", keys.phase("r"), encode(announced))


def test_until_done_it_ends_once_the_run_is_done_and_all_have_left(owner: Owner) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    router = owner.start_service("router", "--listen", endpoint, "--until-done")
    router.expect("ready")
    coordinator = ZenohBus(endpoint, "coordinator-1", Wakeup(), connect_secs=10.0)
    statuses, phases = Inbox(), list[Phase | None]()
    coordinator.subscribe("status", keys.status("r", "router", "*"), statuses)
    coordinator.announce(keys.alive("r", "coordinator", "coordinator-1"))

    def heard(phase: Phase) -> int:
        """How often the router's status had this phase, which the coordinator says again and again."""
        announce(coordinator, term=1 + (phase is Phase.DONE), phase=phase)
        frames = [arrival.data for arrival in statuses.take_all() if isinstance(arrival, Frame)]
        phases.extend(message.phase for message in map(decode, frames) if isinstance(message, Status))
        return phases.count(phase)

    wait_for("the router's status in BABBLE", lambda: heard(Phase.BABBLE) > 0)
    wait_for("the router's status, twice after the run was done", lambda: heard(Phase.DONE) > 1)
    coordinator.close()
    assert router.ended(within_secs=5.0) == 0


def test_it_is_well_even_where_nobody_is(
    owner: Owner, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    health = tmp_path / "health"
    monkeypatch.setenv("BABBLE_HEALTH", str(health))
    owner.router()
    wait_for("the health file", health.exists)
    asked = owner.start("health", "-m", "services.runtime.health")
    assert asked.ended() == 0
    assert "healthy: router" in asked.out[0]
