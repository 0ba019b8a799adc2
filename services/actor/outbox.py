"""An actor's streams of segments: numbered, granted, windowed, sent again until acknowledged."""

from dataclasses import dataclass

from protocol import keys
from protocol.codec import encode
from protocol.messages import Ack, Phase, Segment
from protocol.refusal import Refused
from protocol.window import SendWindow
from services.actor.collect import Finished
from services.runtime.bus import Bus
from services.runtime.settings import SettingsError

CONSUMER_OF = {
    Phase.BABBLE: "encoder_learner",
    Phase.WALK: "encoder_learner",
    Phase.GROUND: "policy_learner",
    Phase.PRACTISE: "policy_learner",
    Phase.EVALUATE: "policy_learner",
}
"""Who learns from a phase's experience; phases that are not here produce none."""


@dataclass
class _Stream:
    window: SendWindow
    ack: Ack | None = None


class Outbox:
    """The streams of one life, one per consumer and block."""

    def __init__(
        self, bus: Bus, *, run: str, life: str, fingerprint: str, window: int, resend_secs: float
    ) -> None:
        self._bus = bus
        self._run = run
        self._life = life
        self._fingerprint = fingerprint
        self._window = window
        self._resend_secs = resend_secs
        self._streams: dict[tuple[str, str], _Stream] = {}
        self.segments = 0
        self.unwanted = 0
        """Finished segments that nobody wanted any more."""

    def hear(self, ack: Ack) -> None:
        """Take a consumer's word; it frees the window and grants what may follow."""
        stream = self._stream(ack.consumer, ack.block)
        stream.window.acked(ack.upto)
        stream.ack = ack

    def grant(self, phase: Phase, term: int, block: str) -> Ack | None:
        """The grant under which the next segment may be begun, if there is one."""
        consumer = CONSUMER_OF.get(phase)
        if consumer is None:
            return None
        stream = self._stream(consumer, block)
        ack = stream.ack
        if ack is None or ack.term != term or not stream.window.may_send(ack.granted):
            return None
        return ack

    def send(self, finished: Finished, phase: Phase, term: int, now_secs: float) -> None:
        """Publish a finished segment if it is still wanted."""
        if self.grant(phase, term, finished.block) is None:
            self.unwanted += 1
            return
        consumer = CONSUMER_OF[phase]
        stream = self._stream(consumer, finished.block)
        segment = Segment(
            run=self._run,
            term=term,
            block=finished.block,
            life=self._life,
            seq=stream.window.next_seq,
            consumer=consumer,
            fingerprint=self._fingerprint,
            phase=phase,
            encoder_version=finished.encoder_version,
            policy_version=finished.policy_version,
            policy=finished.policy,
            steps=finished.steps,
            columns=finished.columns,
            first_step=finished.first_step,
            arrays=finished.arrays,
        )
        try:
            frame = encode(segment)
        except Refused as refused:
            raise SettingsError(
                f"actors.segment_steps and actors.envs_per_actor are too large: {refused}"
            ) from None
        stream.window.sent(segment.seq, frame, now_secs)
        self.segments += 1
        self._publish(consumer, finished.block, frame)

    def resend(self, now_secs: float) -> None:
        """Send again what has waited too long for its acknowledgement."""
        for (consumer, block), stream in self._streams.items():
            for _, frame in stream.window.due(now_secs):
                self._publish(consumer, block, frame)

    @property
    def unacknowledged(self) -> int:
        """Segments sent and not yet acknowledged."""
        return sum(stream.window.unacknowledged for stream in self._streams.values())

    @property
    def resent(self) -> int:
        """Segments sent again, in total."""
        return sum(stream.window.resent for stream in self._streams.values())

    @property
    def ignored_acks(self) -> int:
        """Acknowledgements that went back or spoke of what was never sent, in total."""
        return sum(stream.window.ignored_acks for stream in self._streams.values())

    def _publish(self, consumer: str, block: str, frame: bytes) -> None:
        self._bus.publish("segment", keys.segment(self._run, consumer, block, self._life), frame)

    def _stream(self, consumer: str, block: str) -> _Stream:
        if (consumer, block) not in self._streams:
            window = SendWindow(self._window, self._resend_secs)
            self._streams[consumer, block] = _Stream(window)
        return self._streams[consumer, block]
