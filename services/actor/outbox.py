"""An actor's streams of segments: numbered, granted, windowed, sent again until acknowledged."""

from dataclasses import dataclass
from typing import Any

from protocol import keys
from protocol.codec import encode
from protocol.messages import ALL_BLOCKS, MAX_COUNT, RECORDER, Ack, Phase, PhaseAnnounced, Segment
from protocol.refusal import Refused
from protocol.window import SendWindow
from services.actor.collect import Finished
from services.actor.recording import Recording
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
    """The streams of one life, one per consumer and block; the recorder has one of all blocks."""

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
        self.recorded_rows = 0
        """Rows sent to the recorder, a row being one environment step of one column."""

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
        return self._granted(self._stream(consumer, block), term)

    def may_record(self, term: int) -> bool:
        """True if the recorder has granted a chunk of rows in this term and there is room for it."""
        return self._granted(self._stream(RECORDER, ALL_BLOCKS), term) is not None

    def progress(self, term: int) -> float:
        """The most that a consumer said it holds of what it wants in this term, from 0 to 1."""
        acks = (stream.ack for stream in self._streams.values())
        return max((ack.progress for ack in acks if ack is not None and ack.term == term), default=0.0)

    def send(self, finished: Finished, announced: PhaseAnnounced, now_secs: float) -> None:
        """Publish a finished segment if it is still wanted."""
        if self.grant(announced.phase, announced.term, finished.block) is None:
            self.unwanted += 1
            return
        about = {
            "encoder_version": finished.encoder_version,
            "policy_version": finished.policy_version,
            "policy": finished.policy,
            "steps": finished.steps,
            "columns": finished.columns,
            "first_step": finished.first_step,
            "arrays": finished.arrays,
        }
        self._send(CONSUMER_OF[announced.phase], finished.block, announced, about, now_secs)
        self.segments += 1

    def record(self, recording: Recording, now_secs: float) -> bool:
        """Publish what is full of a recording, as far as there is room; true once all of it is.

        A grant is needed to begin a chunk, and none to send it: rows that are there are not thrown away.
        """
        window = self._stream(RECORDER, ALL_BLOCKS).window
        while recording.full and window.may_send(MAX_COUNT):
            chunk = recording.full.popleft()
            about = {
                "steps": chunk.steps,
                "columns": chunk.columns,
                "first_step": chunk.first_step,
                "arrays": chunk.arrays,
            }
            self._send(RECORDER, ALL_BLOCKS, chunk.announced, about, now_secs)
            self.recorded_rows += chunk.steps * chunk.columns
        return not recording.full

    def _granted(self, stream: _Stream, term: int) -> Ack | None:
        ack = stream.ack
        if ack is None or ack.term != term or not stream.window.may_send(ack.granted):
            return None
        return ack

    def _send(
        self, consumer: str, block: str, announced: PhaseAnnounced, about: dict[str, Any], now_secs: float
    ) -> None:
        stream = self._stream(consumer, block)
        segment = Segment(
            run=self._run,
            term=announced.term,
            block=block,
            life=self._life,
            seq=stream.window.next_seq,
            consumer=consumer,
            fingerprint=self._fingerprint,
            phase=announced.phase,
            level=announced.level,
            iteration=announced.iteration,
            **about,
        )
        try:
            frame = encode(segment)
        except Refused as refused:
            raise SettingsError(
                f"actors.segment_steps and actors.envs_per_actor are too large: {refused}"
            ) from None
        stream.window.sent(segment.seq, frame, now_secs)
        self._publish(consumer, block, frame)

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
    def unrecorded(self) -> int:
        """Those of them that were sent to the recorder."""
        return self._stream(RECORDER, ALL_BLOCKS).window.unacknowledged

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
