"""Fixtures of the tests with real processes: an owner that ends what a test started, a ready router."""

from collections.abc import Callable, Iterator

import pytest

from services.runtime.bus import Wakeup
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, RunningRouter


@pytest.fixture
def owner() -> Iterator[Owner]:
    """Starts processes; whatever still runs at the end of the test is killed, by its id."""
    with Owner() as starting:
        yield starting


@pytest.fixture
def router(owner: Owner) -> RunningRouter:
    """A router of this test's own, on a free port."""
    return owner.router()


@pytest.fixture
def connect(router: RunningRouter) -> Iterator[Callable[[str], ZenohBus]]:
    """Connects the test itself to its router under a life name; closed at the end."""
    buses: list[ZenohBus] = []

    def join(life: str) -> ZenohBus:
        buses.append(ZenohBus(router.endpoint, life, Wakeup(), connect_secs=10.0))
        return buses[-1]

    yield join
    for bus in buses:
        bus.close()
