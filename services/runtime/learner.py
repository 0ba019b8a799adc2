"""The shell that both learners share: hear phases and experience, work, publish versions, survive.

What is learned is in the `Work` of each block; everything that has to do with being a process of a
run (terms, acknowledgements, checkpoints, status) is here and the same for all learners.
"""

import json
import logging
from collections import Counter, deque
from collections.abc import Mapping, Sequence
from pickle import UnpicklingError
from typing import Any

from protocol import keys
from protocol.codec import encode
from protocol.gate import Gate
from protocol.latest import LatestPhase
from protocol.messages import MAX_ENTRIES, Phase, PhaseAnnounced, Progress, Segment
from protocol.refusal import Reason, Refused
from services.runtime.allotment import Allotment
from services.runtime.bus import Frame, Inbox
from services.runtime.checkpoint import Checkpoints
from services.runtime.errors import CheckpointError
from services.runtime.freezing import freeze
from services.runtime.intake import Intake
from services.runtime.process import Context
from services.runtime.settings import RunSettings
from services.runtime.sharing import claim, name_of
from services.runtime.spool import Spool
from services.runtime.status import Heart
from services.runtime.work import Work, share_of, version_of

log = logging.getLogger(__name__)

IDLE_SECS = 0.1
NEWS_SECS = 0.2
"""While it trains, its measurements are published so often: they are the learning curves."""
ADVANCE_SECS = 0.25
"""No block's quantum is begun so long after the first one's: with many blocks too, acks keep flowing."""
MOST_METRICS = MAX_ENTRIES - 16
"""Measurements in one status; it has the process's own besides."""
LONGEST_SPOOL_BYTES = 256 << 20
"""A spool this long is checkpointed away before its time."""


class Learner:
    """A learner service around the works of its blocks, perhaps of none; see `poll`.

    Works whose blocks a term does not name rest: they offer their models, and nothing else is asked of them.
    """

    def __init__(self, context: Context, works: Sequence[Work], *, service: str, fingerprint: str) -> None:
        self._context = context
        self._works = {work.block: work for work in works}
        self._fingerprint = fingerprint
        self._folder = context.run_dir / "checkpoints" / name_of(service, context.index)
        self._claim = claim(self._folder)
        settings = context.settings
        self._allotments = {block: _allotment(settings) for block in self._works}
        self._control = Inbox(context.wakeup, max_frames=keys.DELIVERY["phase"].keep)
        self._control_gate = Gate(context.run, {"phase"})
        self._gate = Gate(context.run, {"segment"}, fingerprint=fingerprint)
        self._latest = LatestPhase()
        self._announced: PhaseAnnounced | None = None
        self._published: dict[str, int] = {}
        self._finished: set[str] = set()
        self._to_advance = deque(self._works)
        self._to_tell = deque(self._works)
        self._rested: dict[str, bytes] = {}
        """States of works at rest, which do not change until another level is at work."""
        self._checkpoints = Checkpoints(self._folder)
        self._spool = Spool(self._folder)
        self._generation = 0
        self._checkpointed_secs = 0.0
        self._told_secs = float("-inf")
        self._known: set[str] = set()
        self._stale = 0
        self._received = 0
        self._stopping = False
        self._urgent = False
        self._intake = self._new_intake(service)
        self._heart = Heart(
            context.bus,
            run=context.run,
            service=service,
            life=context.life,
            interval_secs=settings.wire.status_secs,
        )
        self._resume()
        context.bus.subscribe("phase", keys.phase(context.run), self._control)

    def stop(self) -> None:
        """Checkpoint and end at the next poll."""
        self._stopping = True

    def poll(self, now_secs: float) -> float | None:
        """Hear, work a little, publish what is new; None once the run is done or stopped."""
        over = self._hear_phase()
        if over or self._stopping:
            self._collect(now_secs)
            self._checkpoint(now_secs)
            self._heart.poll(now_secs, self._report, urgent=True)
            return None
        self._collect(now_secs)
        busy = self._advance(now_secs)
        self._answer(now_secs)
        due = now_secs - self._checkpointed_secs > self._context.settings.wire.checkpoint_secs
        if due or self._spool.size_bytes > LONGEST_SPOOL_BYTES:
            self._checkpoint(now_secs)
        told = busy and now_secs - self._told_secs >= NEWS_SECS
        if self._urgent or told:
            self._told_secs = now_secs
        self._heart.poll(now_secs, self._report, urgent=self._urgent or told)
        self._urgent = False
        return 0.0 if busy else IDLE_SECS

    def _new_intake(self, service: str) -> Intake:
        return Intake(
            self._context.bus,
            self._gate,
            consumer=service,
            blocks=self._works,
            run=self._context.run,
            life=self._context.life,
            spool=self._spool,
            wakeup=self._context.wakeup,
        )

    def _hear_phase(self) -> bool:
        """Take the newest announcement; True if it says that the run is done."""
        for arrival in self._control.take_all():
            if not isinstance(arrival, Frame):
                continue
            message = self._control_gate.admit(arrival.key, arrival.data)
            if isinstance(message, PhaseAnnounced) and self._latest.admit(message):
                self._begin(message)
        return self._announced is not None and self._announced.phase is Phase.DONE

    def _begin(self, announced: PhaseAnnounced) -> None:
        if self._announced is not None and announced.term <= self._announced.term:
            return
        self._catch_up(announced)
        if self._announced is None or announced.blocks.keys() != self._announced.blocks.keys():
            self._rested.clear()
        freeze(self._works, announced.frozen, self._context.run_dir)
        log.info("term %d: %s", announced.term, announced.phase)
        self._announced = announced
        self._finished.clear()
        for allotment in self._allotments.values():
            allotment.new_term()
        for work in self._at_work().values():
            work.begin(announced)
        self._publish_models()
        self._checkpoint(self._context.clock.now_secs())
        self._urgent = True

    def _at_work(self) -> dict[str, Work]:
        """The works of the blocks that the current term is about."""
        blocks = () if self._announced is None else self._announced.blocks
        return {block: work for block, work in self._works.items() if block in blocks}

    def _catch_up(self, announced: PhaseAnnounced) -> None:
        """Finish what an older checkpoint left undone; raises `CheckpointError` if that is not enough.

        The coordinator announces the versions that this learner had reported when it was last heard.
        """
        for block, floor in announced.blocks.items():
            work = self._works.get(block)
            if work is None:
                continue
            needed = getattr(floor, work.kind)
            while version_of(work) < needed and work.advance():
                pass
            if version_of(work) < needed:
                raise CheckpointError(
                    f"the run needs {work.kind} {needed} of {block}, and the checkpoints in {self._folder} "
                    f"lead only to {version_of(work)}; restore them from a backup or start a new run"
                )

    def _collect(self, now_secs: float) -> None:
        for segment in self._intake.collect():
            self._received += 1
            allotment = self._allotments.get(segment.block)
            if allotment is not None:
                upto = self._intake.ledger.upto(segment.life, segment.block)
                allotment.received(segment.life, upto, segment.columns, now_secs)
            self._use(segment)
        self._note_members(now_secs)

    def _use(self, segment: Segment) -> None:
        work = self._at_work().get(segment.block)
        current = self._announced is not None and segment.term == self._announced.term
        try:
            used = work is not None and current and work.take(segment)
        except ValueError as error:
            sentence = f"segment {segment.seq} of {segment.life} cannot be learned from: {error}"
            self._gate.refuse(Refused(Reason.BAD_ARRAY, sentence))
            used = False
        self._stale += not used

    def _note_members(self, now_secs: float) -> None:
        present = self._intake.present
        for block, allotment in self._allotments.items():
            for life in present - self._known:
                allotment.appeared(life, self._intake.ledger.upto(life, block), now_secs)
            for life in self._known - present:
                allotment.vanished(life)
        self._known = set(present)

    def _advance(self, now_secs: float) -> bool:
        """A quantum of each block's work in turn, or of some, where that takes long; True if more is to do.

        However many blocks have ended their work, one checkpoint holds it.
        """
        clock, at_work = self._context.clock, self._at_work()
        busy, ended, began_secs = False, set[str](), clock.now_secs()
        for _ in range(len(self._to_advance)):
            if clock.now_secs() - began_secs >= ADVANCE_SECS:
                busy = True
                break
            block = self._to_advance[0]
            self._to_advance.rotate(-1)
            work = at_work.get(block)
            if work is None or block in self._finished or work.progress() is None:
                continue
            busy = work.advance() or busy
            progress = work.progress()
            if progress is not None and progress.done >= progress.wanted:
                ended.add(block)
        if ended:
            self._checkpoint(now_secs)
            self._finished |= ended
            self._urgent = True
        self._publish_models()
        return busy

    def _publish_models(self) -> None:
        term = 0 if self._announced is None else self._announced.term
        for block, work in self._works.items():
            offer = work.model()
            if offer is None or offer.version <= self._published.get(block, 0):
                continue
            offer.save(self._context.run_dir, block)
            message = offer.message(
                run=self._context.run,
                term=term,
                block=block,
                life=self._context.life,
                fingerprint=self._fingerprint,
            )
            self._context.bus.publish(
                "model", keys.model(self._context.run, offer.kind, block), encode(message)
            )
            self._published[block] = offer.version

    def _answer(self, now_secs: float) -> None:
        at_work, term = self._at_work(), 0 if self._announced is None else self._announced.term
        for block, work in self._works.items():
            want, policy_floor = work.request()
            self._allotments[block].want(work.wanted_columns() if block in at_work else 0)
            self._intake.answer(
                block,
                self._allotments[block],
                term=term,
                policy_floor=policy_floor,
                want=want,
                now_secs=now_secs,
                progress=share_of(work),
            )

    def _checkpoint(self, now_secs: float) -> None:
        book = {
            "ledger": self._intake.ledger.state(),
            "announced": None if self._announced is None else self._announced.model_dump(mode="json"),
            "received": self._received,
            "stale": self._stale,
        }
        payload = {f"work/{block}": state for block, state in self._states().items()}
        self._generation += 1
        self._checkpoints.save(self._generation, {"book": json.dumps(book).encode(), **payload})
        self._spool.rotate(self._generation)
        self._checkpointed_secs = now_secs

    def _states(self) -> dict[str, bytes]:
        at_work = self._at_work()
        self._rested = {
            block: self._rested.get(block) or work.state()
            for block, work in self._works.items()
            if block not in at_work
        }
        return self._rested | {block: work.state() for block, work in at_work.items()}

    def _resume(self) -> None:
        self._checkpointed_secs = self._context.clock.now_secs()
        found = self._checkpoints.newest()
        if found is None:
            return
        self._generation, payload = found
        if isinstance(payload, bytes):
            raise CheckpointError(
                f"{self._folder} holds checkpoints of another service; give each its own folder"
            )
        try:
            self._restore(payload)
        except (KeyError, TypeError, ValueError, AttributeError, RuntimeError, UnpicklingError) as error:
            # Its bytes are those that were saved, so another program wrote them, or other settings hold now.
            raise CheckpointError(
                f"the checkpoint {self._generation} in {self._folder} was written by another version of "
                "Babble, or with other settings; go on with those, or start a new run"
            ) from error
        replayed = 0
        for segment in self._intake.replay(self._generation):
            replayed += 1
            self._received += 1
            self._use(segment)
            for work in self._at_work().values():
                while work.advance():
                    pass
        log.info("resumed checkpoint %d and %d segments from the spool", self._generation, replayed)
        self._publish_models()

    def _restore(self, payload: Mapping[str, bytes]) -> None:
        """Become what `_checkpoint` saved. Raises whatever comes of what this version never saves."""
        book = json.loads(payload["book"])
        self._intake.restore(book["ledger"])
        self._received, self._stale = book["received"], book["stale"]
        if book["announced"] is not None:
            self._announced = PhaseAnnounced.model_validate(book["announced"], strict=False)
        for block, work in self._works.items():
            if f"work/{block}" in payload:
                work.restore(payload[f"work/{block}"])

    def _report(self) -> dict[str, Any]:
        works, at_work = self._works.values(), self._at_work().values()
        announced = self._announced
        progress = [p for p in (work.progress() for work in at_work) if p is not None]
        totals = {name: count for work in works for name, count in work.totals().items()}
        totals |= {"segments": self._received, "stale": self._stale, "inbox_dropped": self._intake.dropped}
        ledger = self._intake.ledger
        return {
            "term": 0 if announced is None else announced.term,
            "phase": None if announced is None else announced.phase,
            "versions": {
                f"{o.kind}/{block}": o.version
                for block, o in ((b, w.model()) for b, w in self._works.items())
                if o is not None
            },
            "totals": totals,
            "progress": [p.model_copy(update={"finished": p.block in self._finished}) for p in progress],
            "scores": [score for work in at_work for score in work.scores()],
            "metrics": self._metrics(),
            "queue_depth": self._intake.queue_depth,
            "lost": ledger.lost,
            "duplicated": ledger.duplicated,
            "refused": self._refused(),
            "waiting_for": self._waiting(progress),
            "last_error": self._gate.last_refusal,
        }

    def _metrics(self) -> dict[str, float]:
        """What the blocks at work measure; of more than a status holds, some, and the next ones next time."""
        told: dict[str, float] = {}
        at_work = self._at_work()
        for _ in range(len(self._to_tell)):
            work = at_work.get(self._to_tell[0])
            found = {} if work is None else work.metrics()
            if len(told) + len(found) > MOST_METRICS:
                break
            told |= found
            self._to_tell.rotate(-1)
        return told

    def _refused(self) -> dict[str, int]:
        ledger = self._intake.ledger
        refused = Counter(self._gate.refused) + Counter(self._control_gate.refused)
        refused[Reason.DUPLICATE] += ledger.duplicated
        refused[Reason.OUT_OF_ORDER] += ledger.gaps
        refused[Reason.NO_ROOM] += ledger.turned_away
        refused[Reason.STALE] += self._stale + self._latest.stale
        return {str(reason): count for reason, count in refused.items() if count}

    def _waiting(self, progress: Sequence[Progress]) -> str:
        if self._announced is None:
            return "a coordinator's announcement"
        owed = [p for p in progress if p.block not in self._finished and p.unit != "updates"]
        if not owed:
            return ""
        first = owed[0]
        amount = f"{first.done:,} of {first.wanted:,} {first.unit}"
        overdue = self._allotments[first.block].overdue(self._context.clock.now_secs())
        late = f"; overdue: {', '.join(overdue)}" if overdue else ""
        return f"experience of {first.block}: {amount}; actors here: {len(self._known)}{late}"


def _allotment(settings: RunSettings) -> Allotment:
    return Allotment(
        columns_per_segment=settings.actors.envs_per_actor,
        window=settings.actors.window,
        patience_secs=settings.wire.grant_secs,
    )
