"""What a dashboard takes from the run it shows: periods with one and without, in turn, within one run."""

import os
import socket
import tempfile
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from statistics import median

from bench.processes import Child, router, service, start, wait_for_line
from bench.scene import RUN, cuboid, write_run_folder
from bench.stand_in import LIFE, StandIn
from bench.tables import Table, count, ratio
from protocol import keys
from protocol.codec import decode
from protocol.messages import Phase, Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.settings import RunSettings
from services.runtime.zenoh_bus import ZenohBus

ACTORS = 8
SETTLE_SECS = 1.0
"""Between a change and the period that is measured."""
BEGIN_SECS = 120.0
END_SECS = 10.0
POLL_SECS = 0.02
MOST_STEPS = 1 << 40

Heard = tuple[float, Status]
"""A status and when it came."""
Company = Callable[[Path, str, RunSettings], AbstractContextManager[None]]
"""Whom actors need to be busy, given the run's folder and router."""


@dataclass(frozen=True)
class Period:
    """What the actors did in a period, and what the dashboard took, if there was one."""

    steps_per_sec: float
    """of all actors together"""
    steps_per_cpu_sec: float
    """by the actors' CPU time"""
    dashboard_share: float = 0.0
    """of one core"""
    dashboard_mb: float = 0.0
    """most resident memory"""
    views_per_sec: float = 0.0
    """that it drew"""


class Watch:
    """Hears what the actors and the dashboard of a run say of themselves."""

    def __init__(self, endpoint: str) -> None:
        self._inbox = Inbox(max_frames=keys.DELIVERY["status"].keep)
        self._bus = ZenohBus(endpoint, "bench-watch", Wakeup(), connect_secs=10.0)
        for name in ("actor", "dashboard"):
            self._bus.subscribe("status", keys.status(RUN, name, "*"), self._inbox)

    def close(self) -> None:
        """Hear no more."""
        self._bus.close()

    def wait_for(self, phase: Phase, actors: int) -> None:
        """Until that many actors step in a phase. Raises RuntimeError at the deadline."""
        deadline, steps = time.monotonic() + BEGIN_SECS, dict[str, int]()
        busy: set[str] = set()
        while len(busy) < actors:
            if time.monotonic() > deadline:
                raise RuntimeError(f"only {len(busy)} of {actors} actors were busy in {phase}")
            for _, status in self.statuses():
                done = status.totals.get("env_steps", 0)
                if status.phase is phase and done > steps.setdefault(status.life, done):
                    busy.add(status.life)
            time.sleep(POLL_SECS)

    def statuses(self) -> list[Heard]:
        """What has come, with the time at which it is looked at."""
        now_secs = time.monotonic()
        arrived = (decode(arrival.data) for arrival in self._inbox.take_all() if isinstance(arrival, Frame))
        return [(now_secs, status) for status in arrived if isinstance(status, Status)]

    def measured(self, secs: float, dashboard: Child | None) -> Period:
        """A period of so long: from each actor's first word in it to its last."""
        self.statuses()
        first: dict[str, Heard] = {}
        last: dict[str, Heard] = {}
        began_secs = time.monotonic()
        cpu_secs = dashboard.cpu_so_far_secs() if dashboard else 0.0
        while time.monotonic() < began_secs + secs:
            for heard in self.statuses():
                first.setdefault(heard[1].life, heard)
                last[heard[1].life] = heard
            time.sleep(POLL_SECS)
        took_secs = time.monotonic() - began_secs
        share = (dashboard.cpu_so_far_secs() - cpu_secs) / took_secs if dashboard else 0.0
        pairs = [(first[life], last[life]) for life in first if last[life][0] > first[life][0]]
        actors = [(a, b) for a, b in pairs if a[1].service == "actor"]
        actors_cpu_secs = sum(b[1].metrics["cpu_secs"] - a[1].metrics["cpu_secs"] for a, b in actors)
        return Period(
            steps_per_sec=sum(_per_sec(a, b, "env_steps") for a, b in actors),
            steps_per_cpu_sec=sum(_grown(a, b, "env_steps") for a, b in actors) / actors_cpu_secs,
            dashboard_share=share,
            dashboard_mb=dashboard.peak_mb() if dashboard else 0.0,
            views_per_sec=sum(_per_sec(a, b, "views") for a, b in pairs if a[1].service == "dashboard"),
        )


def measure(*, periods: int = 5, period_secs: float = 3.0, actors: int = ACTORS) -> list[Table]:
    """Actors of a run that practises for ever, and actors that nobody lets wait."""
    settings = cuboid(
        actors={"count": actors},
        phases={"babble_steps": 2048, "ground_steps": MOST_STEPS},
        encoder={"encode": {"updates": 30}},
        wire={"status_secs": 0.5},
    )
    return [
        _table(f"{actors} actors of a run in GROUND", *_in_turn(settings, _learners, periods, period_secs)),
        _table(f"{actors} actors without a learner", *_in_turn(settings, _stand_in, periods, period_secs)),
    ]


def _grown(a: Heard, b: Heard, total: str) -> int:
    return b[1].totals[total] - a[1].totals[total]


def _per_sec(a: Heard, b: Heard, total: str) -> float:
    return _grown(a, b, total) / (b[0] - a[0])


def _in_turn(
    settings: RunSettings, company: Company, periods: int, period_secs: float
) -> tuple[list[Period], list[Period]]:
    """Periods without and with a dashboard, in one run."""
    without: list[Period] = []
    shown: list[Period] = []
    with tempfile.TemporaryDirectory() as name, _running(Path(name), settings, company) as (endpoint, watch):
        without.append(watch.measured(period_secs, None))
        for number in range(periods):
            with _dashboard(Path(name), endpoint, number) as dashboard:
                time.sleep(SETTLE_SECS)
                shown.append(watch.measured(period_secs, dashboard))
            time.sleep(SETTLE_SECS)
            without.append(watch.measured(period_secs, None))
    return without, shown


@contextmanager
def _running(folder: Path, settings: RunSettings, company: Company) -> Iterator[tuple[str, Watch]]:
    """Actors that are busy in GROUND, and whom they need for that."""
    write_run_folder(folder, settings)
    indices = range(settings.actors.count)
    with (
        router(folder) as (endpoint, _),
        company(folder, endpoint, settings),
        _watch(endpoint) as watch,
        _ended(service("actor", folder, endpoint, index=index) for index in indices),
    ):
        watch.wait_for(Phase.GROUND, settings.actors.count)
        yield endpoint, watch


@contextmanager
def _watch(endpoint: str) -> Iterator[Watch]:
    watch = Watch(endpoint)
    try:
        yield watch
    finally:
        watch.close()


@contextmanager
def _ended(starting: Iterable[Child]) -> Iterator[None]:
    """Processes that are ended afterwards."""
    children: list[Child] = []
    try:
        children.extend(starting)
        yield
    finally:
        for child in reversed(children):
            child.end()


@contextmanager
def _learners(folder: Path, endpoint: str, settings: RunSettings) -> Iterator[None]:
    """The coordinator and both learners."""
    names = ("coordinator", "encoder_learner", "policy_learner")
    with _ended(service(name, folder, endpoint) for name in names):
        yield


@contextmanager
def _stand_in(folder: Path, endpoint: str, settings: RunSettings) -> Iterator[None]:
    """One that grants everything at once."""
    wakeup, over = Wakeup(), threading.Event()
    bus = ZenohBus(endpoint, LIFE, wakeup, connect_secs=10.0)
    stand_in = StandIn(bus, settings, wakeup)

    def work() -> None:
        while not over.is_set():
            wakeup.wait(POLL_SECS)
            stand_in.poll()

    worker = threading.Thread(target=work)
    worker.start()
    try:
        yield
    finally:
        over.set()
        worker.join()
        bus.close()


@contextmanager
def _dashboard(folder: Path, endpoint: str, number: int) -> Iterator[Child]:
    """A dashboard that is ready."""
    ports = ("--web-port", str(_free_port()), "--grpc-port", str(_free_port()))
    told = ("--run-dir", str(folder), "--connect", endpoint, *ports)
    child = start(f"dashboard-{number}", folder, "-m", "services.dashboard", *told)
    try:
        wait_for_line(child, "ready in run")
        yield child
    finally:
        child.end()


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def _table(what: str, without: Sequence[Period], shown: Sequence[Period]) -> Table:
    rows = [
        ("steps/s of all actors", [p.steps_per_sec for p in without], [p.steps_per_sec for p in shown]),
        (
            "steps per CPU second of an actor",
            [p.steps_per_cpu_sec for p in without],
            [p.steps_per_cpu_sec for p in shown],
        ),
    ]
    shares = [period.dashboard_share for period in shown]
    return Table(
        title=f"A dashboard beside {what} ({len(os.sched_getaffinity(0))} cores)",
        columns=["", "without", "with", "ratio", "least", "most"],
        rows=[_row(*row) for row in rows],
        notes=[
            f"Medians of {len(without)} periods without and {len(shown)} with one, in turn; "
            "a ratio is that of a period with one to the mean of its two neighbours without.",
            f"For comparison, steps/s of neighbours without differ by {_unrest(without):.0%} (median); where "
            "that is much, the machine was not idle and the ratios tell little.",
            f"The dashboard took {median(shares):.2f} of a core ({min(shares):.2f} to {max(shares):.2f}) "
            f"and {max(period.dashboard_mb for period in shown):.0f} MB at most for "
            f"{median(period.views_per_sec for period in shown):.0f} views a second; no page was open.",
        ],
    )


def _unrest(without: Sequence[Period]) -> float:
    """By how much the speed changes from one period without a dashboard to the next."""
    speeds = [period.steps_per_sec for period in without]
    return median(abs(b / a - 1) for a, b in pairwise(speeds))


def _row(name: str, without: Sequence[float], shown: Sequence[float]) -> list[str]:
    ratios = [on / ((a + b) / 2) for a, on, b in zip(without, shown, without[1:], strict=False)]
    compared = [ratio(median(ratios)), ratio(min(ratios)), ratio(max(ratios))]
    return [name, count(median(without)), count(median(shown)), *compared]
