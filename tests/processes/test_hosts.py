"""Actors on hosts of their own: they come, work, vanish and return as they like, each as fast as it can."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.processes.namespaces import Host, Network, laid_network
from tests.processes.owned import Owner, Process, wait_for
from tests.processes.spread_run import SpreadRun

pytestmark = [pytest.mark.processes, pytest.mark.slow]

WORKING_SECS = 20.0
GONE_SECS = 5.0
FROZEN_SECS, THAWED_SECS = 0.3, 0.1


@pytest.fixture
def network() -> Iterator[Network]:
    with laid_network() as network:
        yield network


@pytest.fixture
def lab(network: Network) -> Host:
    return network.host("lab")


@pytest.fixture
def office(network: Network) -> Host:
    return network.host("office")


@pytest.fixture
def run(owner: Owner, network: Network, lab: Host, office: Host, tmp_path: Path) -> SpreadRun:
    """One actor works at the lab; the office may join."""
    run = SpreadRun(owner, tmp_path, network.host("home"), [lab, office])
    run.join(lab, "first")
    run.wait_for_segments(4)
    return run


@contextmanager
def slowed(process: Process) -> Iterator[None]:
    """Let a process run for a quarter of the time only; its links live on (a lease is 1 s)."""
    over = threading.Event()

    def hold_up() -> None:
        while not over.wait(THAWED_SECS):
            process.freeze()
            over.wait(FROZEN_SECS)
            process.thaw()

    holding = threading.Thread(target=hold_up)
    holding.start()
    try:
        yield
    finally:
        over.set()
        holding.join()


def test_a_second_host_joins_works_vanishes_and_returns(run: SpreadRun, office: Host) -> None:
    for name in ("second", "third"):
        run.join(office, name)
    wait_for("both work", lambda: run.at_work(office) == 2, WORKING_SECS)
    for name in ("second", "third"):
        run.kill(name)
    lives = set(run.actors(office))
    assert len(lives) == 2

    def missed() -> bool:
        return all(any(life in text for text in run.events("lost")) for life in lives)

    wait_for("the office is missed", missed, GONE_SECS)
    run.wait_for_segments(4)
    before = run.sent(office)
    run.join(office, "fourth")
    wait_for("the office works again", lambda: run.sent(office) >= before + 2, WORKING_SECS)
    run.end()
    assert len(run.actors(office)) == 3
    run.assert_nothing_lost_or_counted_twice()


def test_actors_of_different_speed_share_the_work(run: SpreadRun, lab: Host, office: Host) -> None:
    slow = run.join(office, "second")
    wait_for("the office works", lambda: run.sent(office) >= 1, WORKING_SECS)
    before = {host.name: run.sent(host) for host in (lab, office)}
    began_secs = time.monotonic()
    with slowed(slow):
        run.wait_for_segments(300)
        shares = {host.name: run.sent(host) - before[host.name] for host in (lab, office)}
    print(f"segments sent in {time.monotonic() - began_secs:.1f} s: {shares}")
    assert shares["office"] >= 2, "the slow one is given nothing"
    assert shares["lab"] >= 1.5 * shares["office"], "the fast one waits for the slow one"
    run.end()
    run.assert_all_explained()
