"""The whole system in one process: memory bus, hand-turned clock, services polled in turn.

A seeded run repeats bit for bit. Services crash and start when the test says so.
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from protocol import keys
from protocol.codec import decode
from protocol.messages import Phase, Segment, Status, View
from services.actor.service import build as build_actor
from services.coordinator.service import CoordinatorService as build_coordinator
from services.encoder_learner.service import build as build_encoder_learner
from services.policy_learner.service import build as build_policy_learner
from services.runtime.bus import Bus, Wakeup
from services.runtime.checkpoint import Checkpoints
from services.runtime.clock import HandClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import Context, Service
from services.runtime.settings import RunSettings

BUILDERS: dict[str, Callable[[Context], Service]] = {
    "coordinator": build_coordinator,
    "encoder_learner": build_encoder_learner,
    "policy_learner": build_policy_learner,
    "actor": build_actor,
}
TURN_SECS = 0.005
"""How far the clock goes between two rounds of polls."""


@dataclass
class _Running:
    service: Service
    bus: Bus


@dataclass
class Simulation:
    """A run on the memory bus."""

    settings: RunSettings
    run_dir: Path
    run: str = "simulated"
    hub: MemoryBus = field(default_factory=MemoryBus)
    clock: HandClock = field(default_factory=lambda: HandClock(1_000.0))
    running: dict[str, _Running] = field(default_factory=dict)
    ended: list[str] = field(default_factory=list)
    sent_steps: dict[tuple[str, int, str], dict[tuple[str, int], int]] = field(default_factory=dict)
    """By (consumer, term, block): environment steps of each different segment (life, seq) that was sent."""
    used_steps: dict[tuple[str, int, str], int] = field(default_factory=dict)
    """By (learner, term, block): the most steps that the learner said it had used."""
    said: list[tuple[float, Segment | Status | View]] = field(default_factory=list)
    """Every segment, status and view with the time, in the order in which they were sent."""
    turn_secs: float = TURN_SECS
    rounds: int = 0

    def start(self, service: str, life: str, index: int = 0) -> None:
        """Start a service under a life name."""
        wakeup = Wakeup()
        bus = self.hub.connect(life, wakeup)
        self._note_what_is_published(bus)
        context = Context(
            bus=bus,
            clock=self.clock,
            settings=self.settings,
            run=self.run,
            run_dir=self.run_dir,
            life=life,
            wakeup=wakeup,
            index=index,
        )
        built = BUILDERS[service](context)
        bus.announce(keys.alive(self.run, service, life))
        self.running[life] = _Running(built, bus)

    def start_all(self, actors: int) -> None:
        """The coordinator, both learners and some actors."""
        self.start("coordinator", "coordinator-0")
        self.start("encoder_learner", "encoder_learner-0")
        self.start("policy_learner", "policy_learner-0")
        for index in range(actors):
            self.start("actor", f"actor-{index}", index)

    def _note_what_is_published(self, bus: Any) -> None:
        """Note segments, views and progress where they are said, before any fault of the bus."""
        publish = bus.publish

        def noting(kind: str, key: str, frame: bytes) -> None:
            if kind in ("segment", "status", "view"):
                self._note(decode(frame))
            publish(kind, key, frame)

        bus.publish = noting

    def _note(self, message: object) -> None:
        if isinstance(message, Segment | Status | View):
            self.said.append((self.clock.now_secs(), message))
        match message:
            case Segment() as s:
                sent = self.sent_steps.setdefault((s.consumer, s.term, s.block), {})
                sent[s.life, s.seq] = s.steps * s.columns
            case Status() as status:
                for progress in status.progress:
                    if progress.unit == "steps":
                        key = (status.service, status.term, progress.block)
                        self.used_steps[key] = max(progress.done, self.used_steps.get(key, 0))

    def segments(self, *phases: Phase) -> list[Segment]:
        """All that were sent in some phases, also those sent again."""
        return [said for _, said in self.said if isinstance(said, Segment) and said.phase in phases]

    def views(self, *phases: Phase) -> list[View]:
        """All that were sent in some phases."""
        phase_of = {said.term: said.phase for _, said in self.said if isinstance(said, Status)}
        return [said for _, said in self.said if isinstance(said, View) and phase_of[said.term] in phases]

    def statuses(self, life: str) -> list[tuple[float, Status]]:
        """All of one process, with their times."""
        return [(secs, said) for secs, said in self.said if isinstance(said, Status) and said.life == life]

    def crash(self, life: str) -> None:
        """As `kill -9`: no goodbye, nothing saved."""
        del self.running[life]
        self.hub.crash(life)

    def round(self) -> None:
        """Poll everything once and turn the clock."""
        self.rounds += 1
        for life, running in list(self.running.items()):
            if running.service.poll(self.clock.now_secs()) is None:
                running.bus.close()
                del self.running[life]
                self.ended.append(life)
        self.clock.advance(self.turn_secs)

    def book(self, learner: str) -> dict[str, Any]:
        """What a learner's newest checkpoint says of the experience it took."""
        found = Checkpoints(self.run_dir / "checkpoints" / learner).newest()
        assert found is not None
        assert isinstance(found[1], dict)
        book: dict[str, Any] = json.loads(found[1]["book"])
        return book

    def until(self, condition: Callable[[], bool], rounds: int = 20_000) -> None:
        """Go on until the condition holds. Raises AssertionError after so many rounds."""
        for _ in range(rounds):
            if condition():
                return
            self.round()
        raise AssertionError(f"not so after {rounds} rounds; running: {sorted(self.running)}")

    def until_all_ended(self) -> None:
        """Go on until every service has ended by itself."""
        self.until(lambda: not self.running)
