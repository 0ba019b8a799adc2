"""Coordinator and learner in one, for an actor that is to be measured: takes and grants everything."""

import time

from bench.scene import RUN, offers_of, world_of
from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Ack, Model, ModelFloor, Phase, PhaseAnnounced, Segment, Status
from services.runtime.bus import Bus, Frame, Inbox, Membership, Wakeup
from services.runtime.interface import interface_of
from services.runtime.settings import RunSettings

CONSUMER = "policy_learner"
LIFE = "stand-in"


class StandIn:
    """Announces GROUND, publishes both models, and acknowledges each segment with the next grant."""

    def __init__(self, bus: Bus, settings: RunSettings, wakeup: Wakeup) -> None:
        self.first_segment_secs: float | None = None
        """`time.monotonic()` at the arrival of the first segment."""
        self.steps = 0
        """Environment steps received, summed over the columns."""
        self.statuses: list[tuple[float, Status]] = []
        """What the actor said of itself, with `time.monotonic()` at its arrival."""
        self._bus = bus
        self._block = settings.block[0].name
        self._window = settings.actors.window
        self._inbox = Inbox(wakeup)
        self._answers = 0
        bus.subscribe("segment", keys.segment(RUN, CONSUMER, "*", "*"), self._inbox)
        bus.subscribe("status", keys.status(RUN, "actor", "*"), self._inbox)
        bus.watch(keys.alive(RUN, "actor", "*"), self._inbox)
        for model in _models(settings):
            bus.publish("model", keys.of(model), encode(model))
        announced = PhaseAnnounced(
            run=RUN,
            term=1,
            block="all",
            life=LIFE,
            seq=0,
            phase=Phase.GROUND,
            blocks={self._block: ModelFloor(encoder=1, policy=1)},
        )
        bus.publish("phase", keys.of(announced), encode(announced))

    def poll(self) -> None:
        """Take what has arrived and answer it."""
        for arrival in self._inbox.take_all():
            match arrival:
                case Membership(key=key, present=True):
                    self._answer(keys.member(key)[1], 0)
                case Frame(data=data):
                    self._hear(decode(data))

    def _hear(self, message: object) -> None:
        if isinstance(message, Status):
            self.statuses.append((time.monotonic(), message))
        elif isinstance(message, Segment):
            if self.first_segment_secs is None:
                self.first_segment_secs = time.monotonic()
            self.steps += message.steps * message.columns
            self._answer(message.life, message.seq + 1)

    def _answer(self, life: str, upto: int) -> None:
        ack = Ack(
            run=RUN,
            term=1,
            block=self._block,
            life=LIFE,
            seq=self._answers,
            to=life,
            consumer=CONSUMER,
            upto=upto,
            granted=upto + 2 * self._window,
            want="sampled",
        )
        self._answers += 1
        self._bus.publish("ack", keys.of(ack), encode(ack))


def _models(settings: RunSettings) -> list[Model]:
    world = world_of(settings, 1)
    interface = interface_of(settings, senses=world.senses, action_size=world.action_size)
    block, fingerprint = settings.block[0].name, interface.fingerprint()
    return [
        offer.message(run=RUN, term=1, block=block, life=LIFE, fingerprint=fingerprint)
        for offer in offers_of(settings)
    ]
