"""One real actor process, fed by a stand-in learner over a real router."""

import os
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bench.processes import Child, router, service
from bench.scene import write_run_folder
from bench.stand_in import LIFE, StandIn
from services.runtime.bus import Wakeup
from services.runtime.settings import RunSettings
from services.runtime.zenoh_bus import ZenohBus

DEADLINE_SECS = 60.0
CONNECT_SECS = 20.0


class Fed:
    """An actor process and the stand-in that feeds it."""

    def __init__(self, child: Child, stand_in: StandIn, wakeup: Wakeup) -> None:
        self.child = child
        self.stand_in = stand_in
        self._wakeup = wakeup

    def until(self, condition: Callable[[], bool]) -> None:
        """Feed it until the condition holds. Raises RuntimeError if it ends or the deadline passes."""
        deadline = time.monotonic() + DEADLINE_SECS
        while not condition():
            if not self.child.running() or time.monotonic() > deadline:
                raise RuntimeError(f"the actor got nowhere; its log: {self.child.log.read_text()[-2000:]}")
            self._wakeup.wait(0.01)
            self.stand_in.poll()


@contextmanager
def fed_actor(settings: RunSettings, core: int | None = None) -> Iterator[Fed]:
    """Start router, stand-in and actor, in this order, and end them."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_run_folder(folder, settings)
        with router(folder) as (endpoint, _):
            wakeup = Wakeup()
            bus = ZenohBus(endpoint, LIFE, wakeup, CONNECT_SECS)
            try:
                stand_in = StandIn(bus, settings, wakeup)
                child = service("actor", folder, endpoint, core=core)
                try:
                    yield Fed(child, stand_in, wakeup)
                finally:
                    child.end()
            finally:
                bus.close()


def over_zenoh(settings: RunSettings, cores: Sequence[int], secs: float) -> tuple[float, float]:
    """Environment steps per second and per CPU second, by the actor's own status; it has a core to itself."""
    mine = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, cores[1:] or cores)
        with fed_actor(settings, core=cores[0]) as fed:
            fed.until(lambda: fed.stand_in.first_segment_secs is not None)
            fed.stand_in.statuses.clear()
            until_secs = time.monotonic() + secs
            fed.until(lambda: time.monotonic() > until_secs and len(fed.stand_in.statuses) > 1)
            (began_secs, first), (ended_secs, last) = fed.stand_in.statuses[0], fed.stand_in.statuses[-1]
    finally:
        os.sched_setaffinity(0, mine)
    steps = last.totals["env_steps"] - first.totals["env_steps"]
    cpu_secs = last.metrics["cpu_secs"] - first.metrics["cpu_secs"]
    return steps / (ended_secs - began_secs), steps / cpu_secs
