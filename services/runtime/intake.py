"""A consumer's side of the experience: each segment is taken once, kept safely, then acknowledged.

Order matters: judge (ledger), keep (spool, synced), use, acknowledge. A consumer killed at any
point finds in its spool whatever it had acknowledged since its checkpoint.
"""

from collections.abc import Collection, Iterator, Mapping
from typing import Any, Literal

from protocol import keys
from protocol.codec import decode, encode
from protocol.gate import Gate
from protocol.ledger import Ledger, Verdict
from protocol.messages import Ack, Segment
from protocol.refusal import Refused
from services.runtime.allotment import Allotment
from services.runtime.bus import Bus, Frame, Inbox, Membership, Wakeup
from services.runtime.errors import SpoolError
from services.runtime.spool import Spool

Want = Literal["random", "sampled", "mean"]
"""How actors should act for the experience that is wanted."""
MAX_MEMBER_NEWS = 65_536
"""Comings and goings of actors between two looks; far more than any run has."""
ACK_REPEAT_SECS = 0.5
"""Acknowledgements and grants are repeated after this time, since one may be lost."""


class Intake:
    """Hears a consumer's segments of some blocks, and says to each sender what is held and wanted."""

    def __init__(
        self,
        bus: Bus,
        gate: Gate,
        *,
        consumer: str,
        blocks: Collection[str],
        run: str,
        life: str,
        spool: Spool,
        wakeup: Wakeup,
    ) -> None:
        self._bus = bus
        self._gate = gate
        self._consumer = consumer
        self._run = run
        self._life = life
        self._spool = spool
        self._inbox = Inbox(wakeup, max_frames=keys.DELIVERY["segment"].keep)
        # Apart from the segments: those are sent again when they are dropped, members' comings are not.
        self._members = Inbox(wakeup, max_frames=MAX_MEMBER_NEWS)
        self._said: dict[tuple[str, str], tuple[float, Ack]] = {}
        self._acks = 0
        self.ledger = Ledger()
        self.present: set[str] = set()
        """Lives of the actors that are there."""
        for block in blocks:
            bus.subscribe("segment", keys.segment(run, consumer, block, "*"), self._inbox)
        bus.watch(keys.alive(run, "actor", "*"), self._members)

    @property
    def queue_depth(self) -> int:
        """Arrivals that wait to be judged."""
        return len(self._inbox)

    @property
    def dropped(self) -> int:
        """Frames dropped because the inbox was full; their senders send them again."""
        return self._inbox.dropped

    def collect(self, limit: int = 64) -> list[Segment]:
        """The segments newly taken, in order, all of them kept on disk already."""
        for news in self._members.take_all():
            if isinstance(news, Membership):
                self._note_member(news.key, news.present)
        fresh: list[Segment] = []
        for _ in range(limit):
            arrival = self._inbox.take()
            if arrival is None:
                break
            if isinstance(arrival, Frame) and (segment := self._judge(arrival.key, arrival.data)) is not None:
                fresh.append(segment)
        if fresh:
            self._spool.sync()
        return fresh

    def restore(self, book: Mapping[str, Any]) -> None:
        """Take over a checkpoint's book. Its lives count as gone until they are seen to be there."""
        self.ledger.restore(book)
        for life in self.ledger.lives():
            if life not in self.present:
                self.ledger.forget(life)

    def replay(self, generation: int) -> Iterator[Segment]:
        """The segments taken since the restored checkpoint of this generation, in their old order.

        Raises `SpoolError` for frames that this version of Babble cannot read.
        """
        for frame in self._spool.replay(generation):
            try:
                segment = decode(frame)
            except Refused as refused:
                raise SpoolError(
                    f"what was acknowledged before the restart cannot be read any more: {refused}; "
                    "go on with the version of Babble that began the run, or start a new run"
                ) from None
            if not isinstance(segment, Segment):
                continue
            if self.ledger.judge(segment.life, segment.block, segment.seq) is Verdict.NEW:
                self.ledger.accept(segment.life, segment.block, segment.seq)
                yield segment

    def answer(
        self,
        block: str,
        allotment: Allotment,
        *,
        term: int,
        policy_floor: int,
        want: Want,
        now_secs: float,
        progress: float = 0.0,
    ) -> None:
        """Tell every actor that is there what is held of it and what it may send of this block.

        `progress`: the share of what is wanted in this term that is held, of all actors; 0 if not known.
        """
        for life, granted in allotment.grant(now_secs).items():
            ack = Ack(
                run=self._run,
                term=term,
                block=block,
                life=self._life,
                seq=0,
                to=life,
                consumer=self._consumer,
                upto=self.ledger.upto(life, block),
                granted=granted,
                policy_floor=policy_floor,
                want=want,
                progress=progress,
            )
            said_secs, said = self._said.get((life, block), (0.0, None))
            if said == ack and now_secs - said_secs < ACK_REPEAT_SECS:
                continue
            self._said[life, block] = (now_secs, ack)
            numbered = ack.model_copy(update={"seq": self._acks})
            self._acks += 1
            self._bus.publish("ack", keys.ack(self._run, life, self._consumer), encode(numbered))

    def _judge(self, key: str, data: bytes) -> Segment | None:
        segment = self._gate.admit(key, data)
        if not isinstance(segment, Segment):
            return None
        verdict = self.ledger.judge(segment.life, segment.block, segment.seq)
        if verdict is not Verdict.NEW:
            self.ledger.refuse(segment.life, segment.block, segment.seq)
            # Its sender may not know what is held: say it again at once.
            self._said.pop((segment.life, segment.block), None)
            return None
        self._spool.append(data)
        self.ledger.accept(segment.life, segment.block, segment.seq)
        return segment

    def _note_member(self, key: str, present: bool) -> None:
        _, life = keys.member(key)
        if present:
            self.present.add(life)
            self.ledger.remember(life)
        else:
            self.present.discard(life)
            self.ledger.forget(life)
            for said in [said for said in self._said if said[0] == life]:
                del self._said[said]
