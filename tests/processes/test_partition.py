"""A host of actors that cannot be reached for a while: what it does then, and that nothing is lost."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.processes.namespaces import Host, Network, laid_network
from tests.processes.owned import Owner, wait_for
from tests.processes.spread_run import SpreadRun

pytestmark = [pytest.mark.processes, pytest.mark.slow]

GONE_SECS = 5.0
"""Members that fall silent are missed within this time (a lease is 1 s)."""
BACK_SECS = 12.0
"""Measured: 0.1 to 4 s after healing, as the pauses between the kernel's attempts to connect fall."""


@pytest.fixture
def network() -> Iterator[Network]:
    with laid_network() as network:
        yield network


@pytest.fixture
def away(network: Network) -> Host:
    return network.host("away")


@pytest.fixture
def other(network: Network) -> Host:
    return network.host("other")


@pytest.fixture
def run(owner: Owner, network: Network, away: Host, other: Host, tmp_path: Path) -> SpreadRun:
    """All actors are on one host, and it is at work."""
    run = SpreadRun(owner, tmp_path, network.host("home"), [away, other])
    for name in ("first", "second"):
        run.join(away, name)
    run.wait_for_segments(6)
    return run


@pytest.mark.parametrize("cut_secs", [5.0, 60.0])
def test_actors_cut_off_in_the_middle_come_back_and_nothing_is_lost(
    run: SpreadRun, away: Host, cut_secs: float
) -> None:
    away.cut_off()
    cut_at_secs = time.monotonic()
    wait_for("both actors are missed", lambda: len(run.events("lost")) >= 2, GONE_SECS)
    while time.monotonic() < cut_at_secs + cut_secs:
        run.statuses()
        time.sleep(0.05)
    before = run.received()
    assert len(run.events("phase")) == 1, "the cut did not fall into the middle of BABBLE"
    away.heal()
    healed_secs = time.monotonic()

    def linked() -> bool:
        return all(run.heard_secs[life] > healed_secs for life in run.actors(away))

    wait_for("both actors are heard again", linked, BACK_SECS)
    back_secs = time.monotonic() - healed_secs
    wait_for("they work again", lambda: run.received() > before, BACK_SECS)
    work_secs = time.monotonic() - healed_secs
    print(
        f"cut off for {cut_secs:.0f} s: heard {back_secs:.2f} s and at work {work_secs:.2f} s after healing"
    )
    run.end()
    assert len(run.actors(away)) == 2, "an actor was started anew"
    run.assert_all_explained()


def test_a_host_that_is_cut_off_holds_up_nobody_else(run: SpreadRun, away: Host, other: Host) -> None:
    run.join(other, "third")
    wait_for("the other host works", lambda: run.sent(other) >= 3, BACK_SECS)
    away.cut_off()
    cut_at_secs = time.monotonic()
    run.wait_for_segments(300)
    print(f"300 segments came {time.monotonic() - cut_at_secs:.2f} s after two of three actors were cut off")
    away.heal()
    before = run.sent(away)
    wait_for("the healed host works again", lambda: run.sent(away) >= before + 2, BACK_SECS)
    run.end()
    run.assert_all_explained()


def test_a_pulled_cable_that_is_put_back_loses_nothing(run: SpreadRun, away: Host) -> None:
    away.unplug()
    wait_for("both actors are missed", lambda: len(run.events("lost")) >= 2, GONE_SECS)
    before = run.received()
    away.plug()
    wait_for("they work again", lambda: run.received() > before, BACK_SECS)
    run.end()
    run.assert_all_explained()


def test_a_router_that_was_killed_and_started_again_loses_nothing(run: SpreadRun, away: Host) -> None:
    run.router.kill()
    run.start_router()
    started_secs = time.monotonic()
    run.wait_for_segments(300)
    print(f"300 segments came {time.monotonic() - started_secs:.2f} s after the router was there again")
    run.end()
    run.assert_all_explained()
