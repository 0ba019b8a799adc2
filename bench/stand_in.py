"""Coordinator and learner in one, for an actor that is to be measured: takes and grants everything."""

import time

from bench.scene import RUN, body_of, offers_of
from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Ack, Frozen, Model, ModelFloor, Phase, PhaseAnnounced, Segment, Status
from services.runtime.bus import Bus, Frame, Inbox, Membership, Wakeup
from services.runtime.interface import interface_of
from services.runtime.settings import RunSettings

CONSUMER = "policy_learner"
LIFE = "stand-in"


class StandIn:
    """Announces GROUND, publishes all models, and acknowledges each segment with the next grant."""

    def __init__(self, bus: Bus, settings: RunSettings, wakeup: Wakeup, level: int = 0) -> None:
        """`level` is the one whose blocks are at work, with those below them as their limbs."""
        self.first_segment_secs: float | None = None
        """`time.monotonic()` at the arrival of the first segment."""
        self.steps = 0
        """Environment steps received, summed over the columns; all blocks of the level share them."""
        self.statuses: list[tuple[float, Status]] = []
        """What the actor said of itself, with `time.monotonic()` at its arrival."""
        self._bus = bus
        self._blocks = settings.levels[level]
        self._row_env_steps = settings.rows_env_steps(self._blocks[0], Phase.GROUND)
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
            level=level,
            blocks={block: ModelFloor(encoder=1, policy=1) for block in self._blocks},
            frozen={
                block: Frozen(encoder=1, policy=1, of_encoder=1, of_policy=1)
                for below in settings.levels[:level]
                for block in below
            },
        )
        bus.publish("phase", keys.of(announced), encode(announced))

    def poll(self) -> None:
        """Take what has arrived and answer it."""
        for arrival in self._inbox.take_all():
            match arrival:
                case Membership(key=key, present=True):
                    for block in self._blocks:
                        self._answer(keys.member(key)[1], block, 0)
                case Frame(data=data):
                    self._hear(decode(data))

    def _hear(self, message: object) -> None:
        if isinstance(message, Status):
            self.statuses.append((time.monotonic(), message))
        elif isinstance(message, Segment):
            if self.first_segment_secs is None:
                self.first_segment_secs = time.monotonic()
            if message.block == self._blocks[0]:
                self.steps += message.steps * message.columns * self._row_env_steps
            self._answer(message.life, message.block, message.seq + 1)

    def _answer(self, life: str, block: str, upto: int) -> None:
        ack = Ack(
            run=RUN,
            term=1,
            block=block,
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
    world, tree = body_of(settings)
    interface = interface_of(
        settings, senses=world.senses, action_size=world.action_size, blocks=tree.specs.values()
    )
    fingerprint = interface.fingerprint()
    return [
        offer.message(run=RUN, term=1, block=block, life=LIFE, fingerprint=fingerprint)
        for block, offers in offers_of(settings).items()
        for offer in offers
    ]
