"""The life of `babble up`: start, look after, show, end."""

import signal
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from services.launcher.address import LOCAL_ACTOR, Address
from services.launcher.child import ChildProcess
from services.launcher.dashboard import HOST, Ports
from services.launcher.display import Display
from services.launcher.interrupts import Interrupts
from services.launcher.listening import Listener
from services.launcher.members import Picture
from services.launcher.run_folder import RunFolder
from services.launcher.supervisor import USER_ERROR, Part, Supervisor
from services.runtime.bus import Bus, Wakeup
from services.runtime.errors import StorageError, UserError
from services.runtime.process import new_life
from services.runtime.settings import RunSettings
from services.runtime.sharing import name_of

DASHBOARD, RECORDER = "dashboard", "recorder"
POLL_SECS = 0.1
BRISK_SECS = 0.02
"""Between two looks at processes that are ending."""
SCORES_SECS = 0.5
"""`scores.jsonl` is looked at so often."""
LEAVE_SECS = 10.0
"""After the end of the run, and without a coordinator, the others have so long to leave."""
STOP_SECS = 3.4
"""Processes asked to stop have so long; one that is killed then goes on from its checkpoint and spool."""
ONLOOKER_SECS = 3.0
"""The dashboard has so long from the end of the run, or the word to stop; it is not waited for any longer."""
ROUTER_SECS = 0.5
"""The router goes last and has so long."""
KILL_SECS = 0.3
"""Killed processes are waited for so long, for the sake of their CPU seconds.

With the above, and what the launcher itself needs to end on a busy machine, everything ends within 5 s.
"""


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """How `babble up` ended."""

    code: int
    sentence: str
    """what went wrong; empty if nothing did, or a signal stopped it"""
    completed: bool
    """True if the run is done"""
    scores_secs: float
    """from the start of the processes to the end of the run"""
    cpu_secs: dict[str, float]
    """of the processes, by name"""


class Launcher:
    """Runs one run to its end; see `run`."""

    def __init__(
        self,
        folder: RunFolder,
        settings: RunSettings,
        address: Address,
        display: Display,
        dashboard: Ports | None = None,
    ) -> None:
        """`dashboard` are the ports of one; None for a run without."""
        self._folder, self._display, self._address = folder, display, address
        self._connect_secs = settings.wire.connect_secs
        self._supervisor = Supervisor(parts_of(folder, settings, address, dashboard), ChildProcess)
        self._picture = Picture(folder.run, folder.shown, time.monotonic())
        self._picture.know(settings)
        self._picture.dashboard = dashboard.url if dashboard else ""
        self._wakeup = Wakeup()
        self._listener = Listener(self._picture, self._wakeup)
        self._bus: Bus | None = None
        self._unconnected = ""
        self._scores_size, self._scores_at_secs = -1, float("-inf")
        self._done_secs: float | None = None
        self._unled_secs: float | None = None

    def run(self, interrupts: Interrupts) -> Outcome:
        """Start all processes and look after them until the run is done or cannot go on, or a signal comes.

        Raises `StorageError` or `UserError` if not even that is possible.
        """
        self._folder.note_endpoint(self._address.connect)
        self._folder.note_dashboard(self._picture.dashboard)
        try:
            with self._display:
                return self._work(interrupts)
        finally:
            # Whatever happened above: nothing that was started is left behind.
            self._supervisor.stop(signal.SIGKILL, everything=True)
            with suppress(StorageError):
                self._folder.forget_addresses()

    def _work(self, interrupts: Interrupts) -> Outcome:
        """Start all at once (they take seconds to import what they need), look after them, end."""
        self._supervise()
        # The launcher's own connection is made on a thread, so that no signal has to wait for it.
        threading.Thread(target=self._connect, name="connect", daemon=True).start()
        while not self._over(interrupts):
            self._wakeup.wait(POLL_SECS)
            self._hear()
            self._supervise()
            self._display.show(self._picture, time.monotonic())
        self._end(interrupts)
        self._read_scores(float("inf"))
        self._display.show(self._picture, time.monotonic())
        return self._outcome(interrupts)

    def _over(self, interrupts: Interrupts) -> bool:
        over = self._supervisor.finished() or self._supervisor.fatal or self._unconnected
        return bool(interrupts.numbers or over or self._overdue())

    def _overdue(self) -> bool:
        """True if the run is done and some stay all the same, with nobody there to tell them."""
        if not self._picture.done or self._supervisor.led():
            self._unled_secs = None
            return False
        self._unled_secs = self._unled_secs or time.monotonic()
        return time.monotonic() > self._unled_secs + LEAVE_SECS

    def _supervise(self) -> None:
        now_secs = time.monotonic()
        for sentence in self._supervisor.poll(now_secs, done=self._picture.done):
            self._picture.note_mishap(sentence, now_secs)
        if self._picture.dashboard and DASHBOARD in self._supervisor.given_up:
            self._picture.dashboard = ""
            self._folder.note_dashboard("")

    def _connect(self) -> None:
        from services.runtime.zenoh_bus import ZenohBus

        try:
            bus = ZenohBus(
                self._address.connect,
                new_life("launcher"),
                self._wakeup,
                self._connect_secs,
                self._address.credential(),
            )
            self._listener.connect(bus)
        except UserError as error:
            self._unconnected = str(error)
            return
        self._bus = bus

    def _hear(self) -> None:
        now_secs = time.monotonic()
        self._listener.hear(now_secs)
        self._read_scores(now_secs)
        if self._picture.done and self._done_secs is None:
            self._done_secs = now_secs

    def _read_scores(self, now_secs: float) -> None:
        if now_secs < self._scores_at_secs + SCORES_SECS:
            return
        self._scores_at_secs = now_secs
        size = self._folder.scores_size()
        if size != self._scores_size:
            self._scores_size = size
            self._picture.scores = self._folder.scores()

    def _end(self, interrupts: Interrupts) -> None:
        """End all processes in order; at another signal at once."""
        heard, began_secs = len(interrupts.numbers), self._done_secs or time.monotonic()

        def hurried() -> bool:
            return len(interrupts.numbers) > heard

        if self._bus is not None:
            threading.Thread(target=self._bus.close, name="close", daemon=True).start()
        self._supervisor.stop(signal.SIGTERM)
        self._wait(STOP_SECS, lambda: self._supervisor.finished() or hurried())
        left_secs = began_secs + ONLOOKER_SECS - time.monotonic()
        self._wait(left_secs, lambda: self._supervisor.alone() or hurried())
        self._supervisor.dismiss()
        self._supervisor.stop(signal.SIGTERM, everything=True)
        self._wait(ROUTER_SECS, lambda: self._supervisor.ended() or hurried())
        self._supervisor.stop(signal.SIGKILL, everything=True)
        self._wait(KILL_SECS, self._supervisor.ended)

    def _wait(self, most_secs: float, until: Callable[[], bool]) -> None:
        deadline_secs = time.monotonic() + most_secs
        self._supervise()
        while not until() and time.monotonic() < deadline_secs:
            time.sleep(BRISK_SECS)
            self._supervise()

    def _outcome(self, interrupts: Interrupts) -> Outcome:
        supervisor, unfinished = self._supervisor, self._supervisor.unfinished()
        completed = self._picture.done and not unfinished
        early = " and ".join(unfinished) if self._picture.done else "the processes"
        code, sentence = (0, "") if completed else (supervisor.fatal_code, f"{early} ended too early")
        if interrupts.numbers:
            code, sentence = 128 + interrupts.numbers[0], ""
        elif self._unconnected:
            code, sentence = USER_ERROR, self._unconnected
        elif supervisor.fatal is not None:
            code, sentence = supervisor.fatal_code, supervisor.fatal
        return Outcome(
            code=code,
            sentence=sentence,
            completed=completed,
            scores_secs=(self._done_secs or time.monotonic()) - self._picture.began_secs,
            cpu_secs=supervisor.cpu_secs(),
        )


def parts_of(
    folder: RunFolder, settings: RunSettings, address: Address, dashboard: Ports | None = None
) -> list[Part]:
    """The processes of a run, with a dashboard if it has ports."""
    run_dir = ("--run-dir", str(folder.path))

    def part(name: str, service: str, *more: str) -> Part:
        told = address.options(LOCAL_ACTOR if service == "actor" else service)
        return Part(
            name=name,
            arguments=("-m", f"services.{service}", *more, *told),
            log=folder.log(name),
            expendable=service == "actor",
            outlasts=service == "router",
            leads=service == "coordinator",
            optional=service == DASHBOARD,
            must_finish=service == RECORDER,
        )

    actors = [part(f"actor-{i}", "actor", *run_dir, "--index", str(i)) for i in range(settings.actors.count)]
    counts = {"encoder_learner": settings.learners.encoder, "policy_learner": settings.learners.policy}
    counts = {} if settings.phases.open_loop else counts
    learners = [
        part(name_of(kind, i), kind, *run_dir, "--index", str(i))
        for kind, count in counts.items()
        for i in range(count)
    ]
    if settings.recording.every_steps:
        learners.append(part(RECORDER, RECORDER, *run_dir))
    if dashboard is not None:
        ports = ("--web-port", str(dashboard.web), "--grpc-port", str(dashboard.grpc))
        actors.append(part(DASHBOARD, DASHBOARD, *run_dir, "--bind", HOST, *ports))
    return [part("router", "router"), part("coordinator", "coordinator", *run_dir), *learners, *actors]
