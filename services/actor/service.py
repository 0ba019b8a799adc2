"""The actor: steps its worlds as the phase says, sends what is granted, runs the newest models."""

import logging
from typing import Any

import numpy as np

from babble.breakdowns import Breakdowns, UnstableError
from babble.legs import Witness
from protocol import keys
from protocol.gate import Gate
from protocol.latest import LatestPhase
from protocol.messages import RECORDER, Ack, Model, ModelFloor, Phase, PhaseAnnounced
from services.actor.collect import Collector, Finished, SegmentCollector, collector_of
from services.actor.config import Body, body_of, first_observation, seeds_of
from services.actor.evaluation import EvaluationCollector
from services.actor.frames import check_frames
from services.actor.models import ModelShelf
from services.actor.outbox import CONSUMER_OF, Outbox
from services.actor.recording import Recording, Tee
from services.actor.stages import Term
from services.actor.views import Views
from services.runtime.bus import Frame, Inbox
from services.runtime.errors import UserError
from services.runtime.interface import interface_of
from services.runtime.process import Context
from services.runtime.settings import RunSettings
from services.runtime.status import Heart

log = logging.getLogger(__name__)

SERVICE = "actor"
QUANTUM_STEPS = 64
"""Steps of the worlds between two looks at the inbox, at most."""
QUANTUM_SECS = 0.1
"""No step is begun so long after the first one: with slow worlds too, acks and heartbeats keep flowing."""
IDLE_SECS = 0.05
FLUSH_SECS = 5.0
"""So long does a run that is done wait for the recorder's word that it has the last rows."""


class Actor:
    """The actor service; see `poll`.

    Raises `SettingsError` for a world or blocks that cannot be, segments that fit into no frame, or a reward
    that there is not.
    """

    def __init__(self, context: Context) -> None:
        self._context = context
        settings = context.settings
        acting, evaluating, worlds, fresh = seeds_of(settings, context.index, context.life).spawn(4)
        self._rng = np.random.default_rng(acting)
        self._evaluation_rng = np.random.default_rng(evaluating)
        self._body = body_of(settings, worlds)
        self._fresh_body = body_of(settings, fresh)
        check_frames(settings, self._body)
        world = self._body.world
        settings.check_rewarded(world.rewarded)
        self._breakdowns = Breakdowns(world.id)
        fingerprint = _fingerprint(settings, self._body)
        self._observation = first_observation(self._body)
        self._shelf = ModelShelf(self._body.tree)
        self._outbox = _outbox_of(context, fingerprint)
        self._views = Views(context, world)
        self._recording = _recording_of(settings)
        self._witness: Witness = self._views if not self._recording else Tee(self._recording, self._views)
        self._flush_until_secs: float | None = None
        self._gate = Gate(context.run, {"phase", "ack", "model"}, fingerprint=fingerprint)
        self._latest = LatestPhase()
        self._announced: PhaseAnnounced | None = None
        self._collector: Collector | None = None
        self._earlier_steps = 0
        self._stopping = False
        self._waiting_for = ""
        self._urgent = True
        self._inbox = _listening(context)
        self._heart = Heart(
            context.bus,
            run=context.run,
            service=SERVICE,
            life=context.life,
            interval_secs=settings.wire.status_secs,
        )

    def stop(self) -> None:
        """End at the next poll; what is unfinished was wanted by nobody yet."""
        self._stopping = True

    def poll(self, now_secs: float) -> float | None:
        """Hear, act a little if something is wanted, send; None once the run is done or stopped."""
        self._hear()
        over = self._announced is not None and self._announced.phase is Phase.DONE
        if (over or self._stopping) and self._flushed(now_secs):
            self._heart.poll(now_secs, self._report, urgent=True)
            return None
        self._views.turn(now_secs, self._env_steps)
        acted = self._act(now_secs)
        self._outbox.resend(now_secs)
        self._heart.poll(now_secs, self._report, urgent=self._urgent)
        self._urgent = False
        return 0.0 if acted else IDLE_SECS

    def _hear(self) -> None:
        for arrival in self._inbox.take_all():
            if not isinstance(arrival, Frame):
                continue
            match self._gate.admit(arrival.key, arrival.data):
                case PhaseAnnounced() as announced if self._latest.admit(announced):
                    self._begin(announced)
                case Ack(to=to) as ack if to == self._context.life:
                    self._outbox.hear(ack)
                case Model() as model:
                    self._urgent = self._shelf.admit(model) or self._urgent

    def _begin(self, announced: PhaseAnnounced) -> None:
        if self._announced is not None and announced.term <= self._announced.term:
            return
        log.info("term %d: %s", announced.term, announced.phase)
        if isinstance(self._collector, SegmentCollector):
            self._observation = self._collector.body_observation
        if self._collector is not None:
            self._earlier_steps += self._collector.env_steps
        self._announced, self._collector = announced, None
        self._waiting_for = ""
        evaluating = announced.phase is Phase.EVALUATE
        world = (self._fresh_body if evaluating else self._body).world
        self._views.enter(announced.term, world, announced.frozen)
        if self._recording is not None:
            self._recording.enter(announced, world)
        self._urgent = True

    def _new_collector(self, announced: PhaseAnnounced) -> Collector:
        """For a phase in which actors act; the models of all blocks below the level are held."""
        term = Term.of(announced.phase, announced.blocks, self._context.settings)
        if announced.phase is Phase.EVALUATE:
            return EvaluationCollector(
                term,
                self._fresh_body,
                self._shelf,
                self._evaluation_rng,
                breakdowns=self._breakdowns,
                witness=self._witness,
            )
        return collector_of(
            term,
            self._body,
            self._shelf,
            self._rng,
            observation=self._observation,
            breakdowns=self._breakdowns,
            witness=self._witness,
            open_loop=self._recording if self._context.settings.phases.open_loop else None,
        )

    @property
    def _env_steps(self) -> int:
        """Environment steps of this life, summed over the columns."""
        return self._earlier_steps + (0 if self._collector is None else self._collector.env_steps)

    def _act(self, now_secs: float) -> bool:
        """Work on the current segment; False if nothing is wanted or the models are not here yet."""
        collector, announced = self._collector, self._announced
        if announced is None or not self._rows_are_sent(now_secs) or announced.phase not in CONSUMER_OF:
            return False
        if (collector is None or collector.at_border()) and not self._may_begin(announced):
            return False
        if collector is None:
            collector = self._collector = self._new_collector(announced)
        self._choose_mode(announced, collector)
        collector.note_progress(self._outbox.progress(announced.term))
        clock = self._context.clock
        began_secs = clock.now_secs()
        for _ in range(QUANTUM_STEPS):
            for finished in _stepped(collector):
                self._outbox.send(finished, announced, now_secs)
            sent = self._rows_are_sent(now_secs)
            turned_secs = clock.now_secs()
            if turned_secs >= self._views.quiet_secs:
                self._views.turn(turned_secs, self._env_steps)
            if not sent or collector.at_border() or turned_secs - began_secs >= QUANTUM_SECS:
                break
        return True

    def _rows_are_sent(self, now_secs: float) -> bool:
        """False while the recorder has no room for what is full: no further step is made before it has."""
        return self._recording is None or self._outbox.record(self._recording, now_secs)

    def _flushed(self, now_secs: float) -> bool:
        """At the end of a life: send the rows that are open; true once the recorder has them, or time is up.

        One that is told to stop sends what it can and goes, for the recorder may be gone too.
        """
        if self._recording is None:
            return True
        self._recording.close()
        sent = self._rows_are_sent(now_secs)
        if self._flush_until_secs is None:
            self._flush_until_secs = now_secs + FLUSH_SECS
        if (sent and not self._outbox.unrecorded) or self._stopping:
            return True
        late = now_secs >= self._flush_until_secs
        if late:
            log.warning(
                "no recorder has acknowledged the last rows within %.0f s; they may be missing", FLUSH_SECS
            )
        return late

    def _may_begin(self, announced: PhaseAnnounced) -> bool:
        """True if some block's next segment is granted and the models of all that act are recent enough.

        The blocks act in the same worlds, so all of them need their models, granted or not, and so do the
        frozen blocks below them.
        """
        grants = self._grants(announced)
        least = 0 if announced.phase is Phase.BABBLE else 1
        floors: dict[str, ModelFloor] = {**announced.frozen}
        for block, floor in announced.blocks.items():
            ack = grants.get(block)
            wanted = max(floor.policy, ack.policy_floor if ack else 0, least)
            floors[block] = ModelFloor(encoder=max(floor.encoder, least), policy=wanted)
        for block, needed in floors.items():
            held = self._shelf.of(block)
            if not held.meets(needed):
                self._waiting_for = (
                    f"encoder {needed.encoder} and policy {needed.policy} of {block}; "
                    f"it has {held.encoder_version} and {held.policy_version}"
                )
                return False
        if self._recording is not None and not self._outbox.may_record(announced.term):
            self._waiting_for = f"a grant of {RECORDER}"
            return False
        granted = bool(grants) or self._context.settings.phases.open_loop
        self._waiting_for = "" if granted else f"a grant of {CONSUMER_OF[announced.phase]}"
        return granted

    def _grants(self, announced: PhaseAnnounced) -> dict[str, Ack]:
        acks = {
            block: self._outbox.grant(announced.phase, announced.term, block) for block in announced.blocks
        }
        return {block: ack for block, ack in acks.items() if ack is not None}

    def _choose_mode(self, announced: PhaseAnnounced, collector: Collector) -> None:
        """How the next legs are walked: blocks may be at different halves of their evaluation."""
        if isinstance(collector, EvaluationCollector) and collector.at_border():
            # The mean actions come first.
            wants = {ack.want for ack in self._grants(announced).values()}
            collector.mode = "mean" if "mean" in wants else "sampled"

    def _report(self) -> dict[str, Any]:
        announced, views = self._announced, self._views
        return {
            "term": 0 if announced is None else announced.term,
            "phase": None if announced is None else announced.phase,
            "versions": self._shelf.versions(),
            "totals": {
                "env_steps": self._env_steps,
                "segments": self._outbox.segments,
                "resent": self._outbox.resent,
                "unwanted": self._outbox.unwanted,
                "stale_models": self._shelf.stale,
                "unusable_models": self._shelf.unusable,
                "failed_episodes": self._breakdowns.episodes,
                "dropped_segments": self._breakdowns.segments,
                "ignored_acks": self._outbox.ignored_acks,
                "inbox_dropped": self._inbox.dropped,
                "recorded_rows": self._outbox.recorded_rows,
                "dropped_rows": 0 if self._recording is None else self._recording.dropped_rows,
                "views": views.sent,
                "unshown": views.unshown,
            },
            "queue_depth": self._outbox.unacknowledged,
            "refused": dict(self._gate.refused),
            "waiting_for": self._waits,
            "last_error": self._last_error,
        }

    @property
    def _waits(self) -> str:
        if self._announced is None:
            return "a coordinator's announcement"
        unsent = self._recording is not None and self._recording.full
        return f"a grant of {RECORDER}" if unsent else self._waiting_for

    @property
    def _last_error(self) -> str:
        errors = self._shelf.last_error, self._gate.last_refusal, self._breakdowns.sentence
        return next(filter(None, errors), self._views.last_error)


def _fingerprint(settings: RunSettings, body: Body) -> str:
    interface = interface_of(
        settings,
        senses=body.world.senses,
        action_size=body.world.action_size,
        blocks=body.tree.specs.values(),
    )
    return interface.fingerprint()


def _outbox_of(context: Context, fingerprint: str) -> Outbox:
    actors = context.settings.actors
    return Outbox(
        context.bus,
        run=context.run,
        life=context.life,
        fingerprint=fingerprint,
        window=actors.window,
        resend_secs=actors.resend_secs,
    )


def _recording_of(settings: RunSettings) -> Recording | None:
    """None for a run that does not record."""
    if not settings.recording.every_steps:
        return None
    return Recording(
        every_steps=settings.recording.every_steps,
        chunk_steps=settings.actors.segment_steps,
        columns=settings.actors.envs_per_actor,
    )


def _stepped(collector: Collector) -> list[Finished]:
    try:
        return collector.advance(1)
    except UnstableError as error:
        raise UserError(str(error)) from None


def _listening(context: Context) -> Inbox:
    inbox = Inbox(context.wakeup, max_frames=keys.DELIVERY["ack"].keep)
    context.bus.subscribe("phase", keys.phase(context.run), inbox)
    context.bus.subscribe("ack", keys.ack(context.run, context.life, "*"), inbox)
    context.bus.subscribe("model", keys.model(context.run, "*", "*"), inbox)
    return inbox


def build(context: Context) -> Actor:
    """The actor of a run."""
    return Actor(context)
