"""A coordinator on the memory bus with everybody else played by the test."""

import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import (
    ALL_BLOCKS,
    Command,
    Phase,
    PhaseAnnounced,
    Progress,
    Reply,
    Score,
    SettingsAnnounced,
    Status,
)
from services.coordinator.service import CoordinatorService, build
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.clock import HandClock
from services.runtime.memory_bus import Connection, MemoryBus
from services.runtime.process import Context
from services.runtime.settings import RunSettings, parse

RUN = "test"
ENCODERS = {Phase.BABBLE, Phase.ENCODE, Phase.WALK, Phase.REFINE}


@dataclass
class Stage:
    """A coordinator on the memory bus; everybody else is played by the test."""

    run_dir: Path
    settings: RunSettings = field(
        default_factory=lambda: parse({"scenario": "test", "phases": {"iterations": 1}}, origin="test")
    )
    hub: MemoryBus = field(default_factory=MemoryBus)
    clock: HandClock = field(default_factory=lambda: HandClock(1000.0))
    coordinator: CoordinatorService | None = None
    life: str = ""
    seq: int = 0

    def __post_init__(self) -> None:
        self.audience = self.hub.connect("audience")
        self.phases, self.statuses = Inbox(), Inbox()
        self.audience.subscribe("phase", keys.phase(RUN), self.phases)
        self.audience.subscribe("status", keys.status(RUN, "coordinator", "*"), self.statuses)

    def start(self, life: str) -> None:
        self.life = life
        bus, wakeup = self.hub.connect(life), Wakeup()
        context = Context(
            bus=bus,
            clock=self.clock,
            settings=self.settings,
            run=RUN,
            run_dir=self.run_dir,
            life=life,
            wakeup=wakeup,
        )
        self.coordinator = build(context)
        bus.announce(keys.alive(RUN, "coordinator", life))
        self.hub.pump = self.turn

    def kill(self) -> None:
        self.hub.crash(self.life)
        self.coordinator = None

    def turn(self) -> None:
        self.poll()

    def poll(self, secs: float = 0.0) -> float | None:
        assert self.coordinator is not None
        self.clock.advance(secs)
        return self.coordinator.poll(self.clock.now_secs())

    def join(self, service: str, life: str) -> Connection:
        bus = self.hub.connect(life)
        bus.announce(keys.alive(RUN, service, life))
        return bus

    def everybody_joins(self) -> None:
        for service in ("encoder_learner", "policy_learner", "actor"):
            self.join(service, f"{service}-1")

    def say(self, service: str, life: str = "", **fields: Any) -> None:
        status = Status(
            run=RUN, block=ALL_BLOCKS, life=life or f"{service}-1", seq=self.seq, service=service, **fields
        )
        self.seq += 1
        self.audience.publish("status", keys.status(RUN, service, status.life), encode(status))

    def announced(self) -> list[PhaseAnnounced]:
        return [
            message
            for message in map(_message, self.phases.take_all())
            if isinstance(message, PhaseAnnounced)
        ]

    def said(self) -> list[Status]:
        return [message for message in map(_message, self.statuses.take_all()) if isinstance(message, Status)]

    def told_settings(self, life: str) -> SettingsAnnounced:
        """What somebody hears who comes now and knows only the run's name."""
        inbox = Inbox()
        self.hub.connect(life).subscribe("settings", keys.settings(RUN), inbox)
        (told,) = map(_message, inbox.take_all())
        assert isinstance(told, SettingsAnnounced)
        return told

    def progress(self, done: int, term: int, **fields: Any) -> None:
        """The encoder learner's word on block "body"."""
        said = Progress(block="body", done=done, wanted=100, unit="steps", finished=done >= 100)
        self.say("encoder_learner", term=term, progress=[said], **fields)

    def finish_term(self) -> PhaseAnnounced:
        """The responsible learner finishes the current term; the next announcement."""
        now = self.describe()
        term, phase = now["term"], Phase(now["phase"])
        learner, model = ("encoder_learner", "encoder") if phase in ENCODERS else ("policy_learner", "policy")
        blocks = self.settings.levels[now["level"]]
        self.say(
            learner,
            term=term,
            versions={f"{model}/{block}": term for block in blocks},
            progress=[
                Progress(block=block, done=9, wanted=9, unit="steps", finished=True) for block in blocks
            ],
            scores=[a_score(now["iteration"], now["evaluates"], block) for block in blocks]
            if phase is Phase.EVALUATE
            else [],
        )
        self.announced()
        self.poll()
        return self.announced()[0]

    def finish_until(self, term: int) -> PhaseAnnounced:
        while (announced := self.finish_term()).term < term:
            pass
        return announced

    def describe(self) -> dict[str, Any]:
        return json.loads(self.command("describe").text)  # type: ignore[no-any-return]

    def command(self, name: str) -> Reply:
        asked = Command(run=RUN, term=0, block=ALL_BLOCKS, life="audience", seq=0, id="ask-1", name=name)  # type: ignore[arg-type]
        answer = self.audience.ask(keys.command(RUN, "coordinator"), encode(asked), 5.0)
        assert answer, "an empty answer is a failure"
        reply = decode(answer)
        assert isinstance(reply, Reply)
        return reply

    def lines(self, name: str) -> list[dict[str, Any]]:
        return [json.loads(line) for line in (self.run_dir / name).read_text().splitlines()]


def _message(arrival: object) -> object:
    assert isinstance(arrival, Frame)
    return decode(arrival.data)


def a_score(iteration: int, phase: str, block: str = "body") -> Score:
    return Score(
        run=RUN,
        block=block,
        iteration=iteration,
        phase=Phase(phase),
        separation=0.95,
        separation_worst=0.9,
        z_min=0.93,
        z_goal=0.97,
        switch_success=1.0,
        crossing=None,
        policy="mean",
        steps=4000,
        encoder_version=3,
        policy_version=iteration + 5,
    )
