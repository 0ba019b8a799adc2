"""The recorder as a process: takes every actor's states, acknowledges them, and ends an open loop.

What is acknowledged is in the spool; how it becomes files is in store.py.
"""

import logging
from collections import Counter
from typing import Any

from babble.bodies import make_body
from protocol import keys
from protocol.gate import Gate
from protocol.latest import LatestPhase
from protocol.messages import ALL_BLOCKS, RECORDER, Phase, PhaseAnnounced, Progress, Segment
from protocol.refusal import Reason, Refused
from services.recorder.columns import check
from services.recorder.config import RecorderConfig, recorder_config
from services.recorder.grants import Unbounded
from services.recorder.store import Store
from services.recorder.tally import Tally
from services.runtime.allotment import Allotment
from services.runtime.bus import Frame, Inbox
from services.runtime.intake import Intake
from services.runtime.interface import interface_of
from services.runtime.process import Context, Service
from services.runtime.settings import SettingsError
from services.runtime.status import Heart

log = logging.getLogger(__name__)

SERVICE = RECORDER
IDLE_SECS = 0.1
SETTLE_SECS = 0.3
"""After the end of the run so long at least it listens: who is there, and what is under way."""
FAREWELL_SECS = 8.0
"""And so long at most, for actors that are there and have not been acknowledged everything."""


class Recorder:
    """The recorder service of a run that records; see `poll`.

    Raises `CheckpointError` for a folder that is damaged, of another run, or held by another recorder, and
    `StorageError` if the disk refuses.
    """

    def __init__(self, context: Context, config: RecorderConfig, fingerprint: str) -> None:
        self._context, self._config = context, config
        self._store = Store(context.run_dir, config)
        self._control = Inbox(context.wakeup, max_frames=keys.DELIVERY["phase"].keep)
        self._control_gate = Gate(context.run, {"phase"})
        self._gate = Gate(context.run, {"segment"}, fingerprint=fingerprint)
        self._latest = LatestPhase()
        self._announced: PhaseAnnounced | None = None
        self._exact, self._unbounded = _allotment(context), Unbounded()
        self._tally = Tally(config.every_steps)
        self._received = 0
        self._known: set[str] = set()
        self._finished = self._stopping = self._urgent = False
        self._done_secs: float | None = None
        self._intake = Intake(
            context.bus,
            self._gate,
            consumer=SERVICE,
            blocks=[ALL_BLOCKS],
            run=context.run,
            life=context.life,
            spool=self._store.spool,
            wakeup=context.wakeup,
        )
        self._heart = Heart(
            context.bus,
            run=context.run,
            service=SERVICE,
            life=context.life,
            interval_secs=context.settings.wire.status_secs,
        )
        self._resume()
        context.bus.subscribe("phase", keys.phase(context.run), self._control)

    def stop(self) -> None:
        """Write what is held and end at the next poll."""
        self._stopping = True

    def poll(self, now_secs: float) -> float | None:
        """Hear, take, acknowledge, write when enough is held; None once the run is done or stopped."""
        self._hear_phase(now_secs)
        took = self._collect(now_secs)
        self._answer(now_secs)
        over = self._stopping or self._over(now_secs)
        completed = self._complete() and not self._finished
        if self._store.full or (self._store.held_rows and (over or completed)):
            self._write()
        if completed:
            self._finished = self._urgent = True
        if over:
            self._heart.poll(now_secs, self._report, urgent=True)
            return None
        self._heart.poll(now_secs, self._report, urgent=self._urgent)
        self._urgent = False
        return 0.0 if took else IDLE_SECS

    def _hear_phase(self, now_secs: float) -> None:
        for arrival in self._control.take_all():
            if not isinstance(arrival, Frame):
                continue
            message = self._control_gate.admit(arrival.key, arrival.data)
            if isinstance(message, PhaseAnnounced) and self._latest.admit(message):
                self._begin(message, now_secs)

    def _begin(self, announced: PhaseAnnounced, now_secs: float) -> None:
        if self._announced is not None and announced.term <= self._announced.term:
            return
        log.info("term %d: %s", announced.term, announced.phase)
        self._announced = announced
        self._finished, self._urgent = False, True
        self._tally.forget_before(announced.term)
        self._exact.new_term()
        if announced.phase is Phase.DONE:
            self._done_secs = now_secs

    def _over(self, now_secs: float) -> bool:
        """True once the run is done and nobody has anything more to say, or for too long.

        While the own link is down, nobody knows who is still there.
        """
        if self._done_secs is None:
            return False
        waited_secs = now_secs - self._done_secs
        gone = not self._intake.present and self._context.bus.linked()
        silent = gone and not self._intake.queue_depth and waited_secs >= SETTLE_SECS
        return silent or waited_secs >= FAREWELL_SECS

    def _collect(self, now_secs: float) -> bool:
        """Take what has come; True if there was something."""
        segments = self._intake.collect()
        for segment in segments:
            upto = self._intake.ledger.upto(segment.life, ALL_BLOCKS)
            self._exact.received(segment.life, upto, segment.columns, now_secs)
            self._take(segment)
        present = self._intake.present
        for allotment in (self._exact, self._unbounded):
            for life in present - self._known:
                allotment.appeared(life, self._intake.ledger.upto(life, ALL_BLOCKS), now_secs)
            for life in self._known - present:
                allotment.vanished(life)
        self._known = set(present)
        return bool(segments)

    def _take(self, segment: Segment) -> None:
        """Hold the rows of a segment that is in the spool; one that cannot be recorded is counted."""
        self._received += 1
        try:
            check(segment, self._config)
            self._tally.take(segment)
        except ValueError as error:
            self._tally.unusable += 1
            sentence = f"segment {segment.seq} of {segment.life} cannot be recorded: {error}"
            self._gate.refuse(Refused(Reason.BAD_ARRAY, sentence))
            return
        self._store.hold(segment)

    def _answer(self, now_secs: float) -> None:
        progress = self._progress()
        allotment: Allotment = self._unbounded
        share = 0.0
        if progress is not None:
            missing = max(0, progress.wanted - progress.done)
            self._exact.want(-(-missing // self._config.segment_steps))
            allotment = self._exact
            share = min(1.0, progress.done / progress.wanted)
        self._intake.answer(
            ALL_BLOCKS,
            allotment,
            term=0 if self._announced is None else self._announced.term,
            policy_floor=0,
            want="random",
            now_secs=now_secs,
            progress=share,
        )

    def _progress(self) -> Progress | None:
        """Of an open loop's BABBLE, which the recorder ends; None in all other terms."""
        announced, wanted = self._announced, self._config.wanted_steps
        if wanted is None or announced is None or announced.phase is not Phase.BABBLE:
            return None
        done = self._tally.steps(announced.term)
        return Progress(block=ALL_BLOCKS, done=done, wanted=wanted, unit="steps", finished=self._finished)

    def _complete(self) -> bool:
        progress = self._progress()
        return progress is not None and progress.done >= progress.wanted

    def _write(self) -> None:
        """Make files of all that is held, and a checkpoint."""
        ledger = self._intake.ledger
        tally = self._tally.state(ledger.lives())
        self._store.write({"ledger": ledger.state(), "tally": tally, "received": self._received})

    def _resume(self) -> None:
        book = self._store.resume()
        if book is None:
            self._write()
            return
        try:
            self._intake.restore(book["ledger"])
            self._tally.restore(book["tally"])
            self._received = int(book["received"])
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise self._store.unreadable() from error
        for segment in self._intake.replay(self._store.generation):
            self._take(segment)
        log.info("resumed: %d files, and %d rows from the spool", self._store.files, self._store.held_rows)

    def _report(self) -> dict[str, Any]:
        announced, ledger, progress = self._announced, self._intake.ledger, self._progress()
        return {
            "term": 0 if announced is None else announced.term,
            "phase": None if announced is None else announced.phase,
            "totals": {
                "rows": self._tally.rows,
                "files": self._store.files,
                "bytes": self._store.size_bytes,
                "gaps": self._tally.gaps,
                "unusable": self._tally.unusable,
                "segments": self._received,
                "inbox_dropped": self._intake.dropped,
            },
            "progress": []
            if progress is None
            else [progress.model_copy(update={"block": block}) for block in self._config.acting],
            "queue_depth": self._intake.queue_depth,
            "lost": ledger.lost,
            "duplicated": ledger.duplicated,
            "refused": self._refused(),
            "waiting_for": self._waiting(progress),
            "last_error": self._gate.last_refusal,
        }

    def _refused(self) -> dict[str, int]:
        ledger = self._intake.ledger
        refused = Counter(self._gate.refused) + Counter(self._control_gate.refused)
        refused[Reason.DUPLICATE] += ledger.duplicated
        refused[Reason.OUT_OF_ORDER] += ledger.gaps
        refused[Reason.NO_ROOM] += ledger.turned_away
        refused[Reason.STALE] += self._latest.stale
        return {str(reason): count for reason, count in refused.items() if count}

    def _waiting(self, progress: Progress | None) -> str:
        if self._announced is None:
            return "a coordinator's announcement"
        if progress is None or progress.finished:
            return ""
        overdue = self._exact.overdue(self._context.clock.now_secs())
        late = f"; overdue: {', '.join(overdue)}" if overdue else ""
        return (
            f"states: {progress.done:,} of {progress.wanted:,} steps; actors here: {len(self._known)}{late}"
        )


class Unrecorded:
    """The service of a run that does not record: it says so and ends."""

    def __init__(self, run: str) -> None:
        self._run = run

    def poll(self, now_secs: float) -> float | None:
        """Finished at once."""
        log.warning(
            "run %s does not record its states (recording.every_steps is 0): nothing to do", self._run
        )
        return None

    def stop(self) -> None:
        """It ends anyway."""


def build(context: Context) -> Service:
    """The recorder of a run, resumed from its checkpoint; see `Recorder` for what it raises.

    Raises `SettingsError` for a world or blocks that cannot be.
    """
    settings = context.settings
    if not settings.recording.every_steps:
        return Unrecorded(context.run)
    wanted = settings.world
    try:
        world, tree = make_body(wanted.id, wanted.parameters, settings.block, columns=1, seed=0)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    interface = interface_of(
        settings, senses=world.senses, action_size=world.action_size, blocks=tree.specs.values()
    )
    config = recorder_config(settings, context.run, tree, world)
    return Recorder(context, config, interface.fingerprint())


def _allotment(context: Context) -> Allotment:
    actors = context.settings.actors
    return Allotment(
        columns_per_segment=actors.envs_per_actor,
        window=actors.window,
        patience_secs=context.settings.wire.grant_secs,
    )
