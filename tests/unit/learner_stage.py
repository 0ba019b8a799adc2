"""Learners on a memory bus, and the coordinator that the test plays."""

from collections.abc import Callable, Iterable
from pathlib import Path

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Frozen, ModelFloor, Phase, PhaseAnnounced, Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.clock import HandClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import Context, Service
from services.runtime.settings import RunSettings

RUN = "r"


class LearnerStage:
    """A run folder, a bus, and learners made by `build`."""

    def __init__(self, settings: RunSettings, run_dir: Path, build: Callable[[Context], Service]) -> None:
        self.settings, self.run_dir, self.build = settings, run_dir, build
        self.hub, self.clock = MemoryBus(), HandClock(100.0)
        self.services: dict[str, Service] = {}
        self._coordinator = self.hub.connect("coordinator-1")
        self._heard = Inbox()
        self._coordinator.subscribe("status", keys.status(RUN, "*", "*"), self._heard)
        self._statuses: dict[str, Status] = {}

    def start(self, life: str, index: int = 0) -> None:
        """Start a learner, which may find the checkpoints of an earlier one."""
        wakeup = Wakeup()
        self.services[life] = self.build(
            Context(
                bus=self.hub.connect(life, wakeup), clock=self.clock, settings=self.settings, run=RUN,
                run_dir=self.run_dir, life=life, wakeup=wakeup, index=index,
            )
        )  # fmt: skip

    def crash(self, life: str) -> None:
        """As `kill -9`."""
        del self.services[life]
        self.hub.crash(life)

    def actor_appears(self, life: str) -> None:
        """An actor is there."""
        self.hub.connect(f"{life}-token").announce(keys.alive(RUN, "actor", life))

    def announce(
        self,
        phase: Phase,
        term: int,
        blocks: Iterable[str],
        frozen: dict[str, Frozen] | None = None,
        floor: ModelFloor | None = None,
    ) -> None:
        """Say as the coordinator what all do now."""
        message = PhaseAnnounced(
            run=RUN, term=term, block="all", life="coordinator-1", seq=term, phase=phase,
            blocks={block: floor or ModelFloor() for block in blocks}, frozen=frozen or {},
        )  # fmt: skip
        self._coordinator.publish("phase", keys.phase(RUN), encode(message))

    def poll(self, rounds: int = 3) -> None:
        """Poll all learners some times, a quarter of a second apart."""
        for _ in range(rounds):
            for service in self.services.values():
                service.poll(self.clock.now_secs())
            self.clock.advance(0.25)

    def status(self, life: str) -> Status:
        """The last word of a learner. Raises KeyError before its first."""
        for frame in self._heard.take_all():
            if isinstance(frame, Frame) and isinstance(status := decode(frame.data), Status):
                self._statuses[status.life] = status
        return self._statuses[life]
