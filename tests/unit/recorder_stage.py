"""A recorder on a memory bus, actors that send it states, and the coordinator that the test plays."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from babble.bodies import make_body
from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import ALL_BLOCKS, RECORDER, Ack, Phase, Segment
from services.recorder.service import build
from services.runtime.bus import Frame, Inbox
from services.runtime.interface import interface_of
from services.runtime.settings import RunSettings, parse
from tests.unit.learner_stage import RUN, LearnerStage

STEPS, COLUMNS = 16, 8
ROWS = STEPS * COLUMNS
LIFE = "recorder-1"


class Killed(BaseException):
    """`kill -9`, at a line."""


def settings_of(**tables: Any) -> RunSettings:
    """A run that records the cuboid; in small segments and files."""
    table: dict[str, Any] = {
        "scenario": "recorded", "seed": 3,
        "actors": {"segment_steps": STEPS, "envs_per_actor": COLUMNS},
        "recording": {"every_steps": 1, "group_rows": 1024},
    }  # fmt: skip
    return parse(table | tables, origin="test")


def open_loop(steps: int, **tables: Any) -> RunSettings:
    """The same in open loop."""
    return settings_of(phases={"open_loop": True, "babble_steps": steps}, **tables)


def fingerprint_of(settings: RunSettings) -> str:
    world, tree = make_body(settings.world.id, settings.world.parameters, settings.block, columns=1, seed=0)
    spec = interface_of(
        settings, senses=world.senses, action_size=world.action_size, blocks=tree.specs.values()
    )
    return spec.fingerprint()


def states_of(life: str, first_step: int, steps: int = STEPS, columns: int = COLUMNS, every: int = 1) -> Any:
    """(T, E, 3): which actor, column and step each row is of."""
    states = np.empty((steps, columns, 3), np.float32)
    states[..., 0] = int(life.split("-")[1])
    states[..., 1] = np.arange(columns)
    states[..., 2] = (first_step + every * np.arange(steps))[:, None]
    return states


class FakeActor:
    """Sends what is granted, keeps it until it is acknowledged, and sends it again until then."""

    def __init__(self, stage: "RecorderStage", life: str) -> None:
        self.life, self._stage = life, stage
        self._bus = stage.hub.connect(life)
        self._bus.announce(keys.alive(RUN, "actor", life))
        self._heard = Inbox()
        self._bus.subscribe("ack", keys.ack(RUN, life, "*"), self._heard)
        self._kept: dict[int, bytes] = {}
        self.acks: list[Ack] = []
        self.step = self.sent = 0

    def hear(self) -> Ack | None:
        """The newest word of the recorder."""
        for frame in self._heard.take_all():
            if isinstance(frame, Frame) and isinstance(ack := decode(frame.data), Ack):
                self.acks.append(ack)
        return self.acks[-1] if self.acks else None

    def pump(self, phase: Phase, term: int, window: int = 4) -> None:
        """Hear, forget what is acknowledged, send all else again, and what more is granted."""
        ack = self.hear()
        if ack is None:
            return
        self._kept = {seq: frame for seq, frame in self._kept.items() if seq >= ack.upto}
        for frame in self._kept.values():
            self._publish(frame)
        while ack.term == term and self.sent < ack.granted and len(self._kept) < window:
            self.send(phase, term)

    def send(self, phase: Phase, term: int, **fields: Any) -> None:
        """A segment; its arrays may be given, and any other field."""
        arrays = {
            "state": states_of(self.life, fields.get("first_step", self.step), fields.get("steps", STEPS)),
            "episode": np.full((fields.get("steps", STEPS), COLUMNS), 7, np.int32),
        }
        segment = Segment(
            **{
                "run": RUN, "term": term, "block": ALL_BLOCKS, "life": self.life, "seq": self.sent,
                "consumer": RECORDER, "fingerprint": self._stage.fingerprint, "phase": phase,
                "steps": STEPS, "columns": COLUMNS, "first_step": self.step, "arrays": arrays,
            } | fields | {"arrays": arrays | fields.get("arrays", {})}
        )  # fmt: skip
        self.sent, self.step = self.sent + 1, segment.first_step + segment.steps
        self._kept[segment.seq] = encode(segment)
        self._publish(self._kept[segment.seq])

    def leave(self) -> None:
        """End in order."""
        self._bus.close()

    def _publish(self, frame: bytes) -> None:
        self._bus.publish("segment", keys.segment(RUN, RECORDER, ALL_BLOCKS, self.life), frame)


class RecorderStage(LearnerStage):
    """A run folder, a bus, a recorder and actors."""

    def __init__(self, settings: RunSettings, run_dir: Path) -> None:
        super().__init__(settings, run_dir, build)
        self.fingerprint = fingerprint_of(settings)
        self.actors: list[FakeActor] = []

    def actor(self, number: int = 1) -> FakeActor:
        """A new actor, that is there."""
        self.actors.append(FakeActor(self, f"actor-{number}"))
        return self.actors[-1]

    @contextmanager
    def killed(self) -> Iterator[None]:
        """What happens inside ends in a `Killed`, and the recorder is gone."""
        with pytest.raises(Killed):
            yield
        self.services.clear()
        self.hub.crash(LIFE)

    def turn(self, phase: Phase, term: int) -> None:
        """Everybody once."""
        self.poll(1)
        for actor in self.actors:
            actor.pump(phase, term)

    def until_finished(self, term: int, rounds: int = 400) -> None:
        """Go on with an open loop until the recorder says that it has what it wants."""
        for _ in range(rounds):
            self.turn(Phase.BABBLE, term)
            if any(progress.finished for progress in self.status(LIFE).progress):
                return
        raise AssertionError(f"not finished after {rounds} rounds: {self.status(LIFE)}")
