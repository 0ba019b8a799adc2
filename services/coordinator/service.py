"""The coordinator as a process: hears the bus, lets the machine decide, and carries out its orders.

The only room with a loop. Each event that changes the state is in the journal before its orders are
carried out, so that a kill at any point loses nothing.
"""

import logging
from collections import Counter
from typing import Any, assert_never

from protocol import keys
from protocol.codec import encode
from protocol.gate import Gate
from protocol.messages import ALL_BLOCKS, Command, Phase, Reply, Status
from services.coordinator.config import plan_of
from services.coordinator.journal import Journal, replay
from services.coordinator.machine import announcement, best_of, decide
from services.coordinator.report import describe, witnesses
from services.coordinator.run_files import RunFiles
from services.coordinator.state import State, awaited, iterations_now, present
from services.coordinator.table import LEARNERS, RECORDER
from services.coordinator.table import Phase as MachinePhase
from services.coordinator.translate import announced, settings_announced, status_reported
from services.coordinator.waiting import frozen_name, phase_name, waiting
from services.coordinator.words import (
    Announce,
    End,
    Event,
    KeepBest,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    Order,
    RecordScores,
    SayStalled,
    Started,
    StopRequested,
    Ticked,
)
from services.runtime.bus import Frame, Inbox, Link, Membership, Question
from services.runtime.process import Context
from services.runtime.settings import announced_text
from services.runtime.status import Heart

log = logging.getLogger(__name__)

SERVICE = "coordinator"
ANNOUNCE_SECS = 1.0
FAREWELL_SECS = 5.0
"""DONE is announced for so long at most, while the own link is up."""
RECORDER_SECS = 30.0
"""The recorder, which writes down what was still under way, has so long instead."""
LATECOMERS_SECS = 20.0
"""A run that was done before is announced for so long: whoever was started with it hears it and ends."""
QUANTUM = 256
"""Arrivals of each kind that one poll takes."""


def build(context: Context) -> "CoordinatorService":
    """The coordinator of a run. Raises what `CoordinatorService` raises."""
    return CoordinatorService(context)


class CoordinatorService:
    """Drives one run through its phases (see README.md).

    Raises `SettingsError` for a tree of blocks without a plan, or settings too long to be announced;
    `JournalError` for a damaged journal, and `StorageError` when the disk refuses.
    """

    def __init__(self, context: Context) -> None:
        self._bus, self._run, self._life = context.bus, context.run, context.life
        self._settings = context.settings
        self._plan = plan_of(context.settings)
        self._config = announced_text(context.settings)
        context.run_dir.mkdir(parents=True, exist_ok=True)
        self._journal = Journal(context.run_dir / "journal.jsonl", context.run, self._plan)
        self._state = replay(self._plan, self._journal.events)
        self._files = RunFiles(context.run_dir, context.run)
        self._files.restore(self._state.scores, self._best())
        self._statuses = Inbox(context.wakeup, max_frames=keys.DELIVERY["status"].keep)
        self._control = Inbox(context.wakeup, max_frames=keys.DELIVERY["status"].keep)
        self._gate = Gate(context.run, {"status"})
        self._command_gate = Gate(context.run, {"command"})
        self._heart = Heart(
            self._bus,
            run=self._run,
            service=SERVICE,
            life=self._life,
            interval_secs=context.settings.wire.status_secs,
        )
        self._heard: dict[str, Status] = {}
        self._decided: dict[str, tuple[float, object]] = {}
        self._begun = self._stop_asked = self._ended = False
        self._announced_secs = float("-inf")
        self._announcements = self._replies = 0
        self._done_before = self._state.phase is MachinePhase.DONE
        self._done_secs: float | None = None
        self._unlinked_secs = float("-inf")
        self._stall = ""
        self._listen()

    def poll(self, now_secs: float) -> float | None:
        """Hear, decide, announce; seconds until the next announcement or status, None when it has ended."""
        if self._ended:
            return None
        if not self._begun:
            self._begun = True
            self._decide(Started(now=now_secs))
            self._announce_settings(now_secs)
        self._hear_link(now_secs)
        self._hear_control(now_secs)
        self._hear_statuses(now_secs)
        self._decide(Ticked(now=now_secs))
        if self._stop_asked:
            self._decide(StopRequested(now=now_secs))
        if now_secs - self._announced_secs >= ANNOUNCE_SECS:
            self._announce(announcement(self._state), now_secs)
        self._ended = self._stop_asked or self._state.stopping or self._may_leave(now_secs)
        status_secs = self._heart.poll(now_secs, self._report, urgent=self._ended)
        if self._ended:
            self._journal.close()
            return None
        if len(self._statuses) or len(self._control):
            return 0.0
        return min(status_secs, self._announced_secs + ANNOUNCE_SECS - now_secs)

    def stop(self) -> None:
        """End at the next poll; the run is not done and may be resumed."""
        self._stop_asked = True

    def _listen(self) -> None:
        self._bus.subscribe("status", keys.status(self._run, "*", "*"), self._statuses)
        self._bus.watch(keys.alive(self._run, "*", "*"), self._control)
        self._bus.watch_link(self._control)
        self._bus.answer(keys.command(self._run, SERVICE), self._control)

    def _hear_link(self, now_secs: float) -> None:
        linked = self._bus.linked()
        if not linked:
            self._unlinked_secs = now_secs
        self._decide(LinkChanged(now=now_secs, up=linked))

    def _hear_control(self, now_secs: float) -> None:
        for _ in range(QUANTUM):
            match self._control.take():
                case None:
                    return
                case Membership(key=key, present=is_present):
                    self._hear_membership(key, is_present, now_secs)
                case Link(up=up):
                    self._decide(LinkChanged(now=now_secs, up=up))
                case Question() as question:
                    self._answer(question, now_secs)
                case Frame():
                    log.error("a frame came to the inbox of memberships and commands; it was dropped")

    def _hear_membership(self, key: str, is_present: bool, now_secs: float) -> None:
        try:
            service, life = keys.member(key)
        except ValueError as error:
            log.warning("%s", error)
            return
        if life != self._life:
            happened = MemberAppeared if is_present else MemberVanished
            self._decide(happened(now=now_secs, service=service, life=life))

    def _hear_statuses(self, now_secs: float) -> None:
        for _ in range(QUANTUM):
            arrival = self._statuses.take()
            if arrival is None:
                return
            status = self._gate.admit(arrival.key, arrival.data) if isinstance(arrival, Frame) else None
            if isinstance(status, Status) and status.life != self._life:
                if status.life in self._state.members:
                    self._heard[status.life] = status
                if status.service in LEARNERS:
                    self._files.add_metrics(now_secs, status)
                if self._is_worth_deciding(status, now_secs):
                    self._decide(status_reported(now_secs, status))

    def _is_worth_deciding(self, status: Status, now_secs: float) -> bool:
        """False for mere progress said again too soon: each change of the state is written and synced."""
        gist = (status.term, tuple(p.finished for p in status.progress), len(status.scores))
        secs, last = self._decided.get(status.life, (float("-inf"), None))
        if gist == last and now_secs - secs < self._settings.wire.status_secs:
            return False
        self._decided[status.life] = (now_secs, gist)
        return True

    def _decide(self, event: Event) -> None:
        before = self._state
        after, orders = decide(self._plan, before, event)
        if after != before:
            self._journal.append(event)
            self._state = after
            if not isinstance(event, Started):
                self._note_changes(before, after, event.now)
        for order in orders:
            self._carry_out(order, event.now)

    def _carry_out(self, order: Order, now_secs: float) -> None:
        match order:
            case Announce():
                self._files.note(now_secs, "phase", phase_name(self._state))
                log.info("%s", phase_name(self._state))
                self._heart.enter(order.term, Phase(order.phase))
                self._announce(order, now_secs)
            case RecordScores(rows=rows):
                self._files.add_scores(rows)
            case KeepBest():
                self._files.write_best(self._best())
            case SayStalled(sentence=sentence):
                self._stall = "; ".join([sentence, *witnesses(self._state, self._heard.values())])
                self._files.note(now_secs, "stalled", self._stall)
                log.warning("%s", self._stall)
                self._heart.urge()
            case End(completed=completed):
                self._done_secs = now_secs if completed else None
                what = "the run is done" if completed else waiting(self._plan, self._state)
                self._files.note(now_secs, "end", what)
            case _:
                assert_never(order)

    def _announce_settings(self, now_secs: float) -> None:
        earlier = self._journal.events
        message = settings_announced(
            self._config,
            began_secs=earlier[0].now if earlier else now_secs,
            run=self._run,
            life=self._life,
            term=self._state.term,
        )
        self._bus.publish("settings", keys.settings(self._run), encode(message))

    def _announce(self, order: Announce, now_secs: float) -> None:
        message = announced(
            order,
            iterations=iterations_now(self._plan, self._state),
            run=self._run,
            life=self._life,
            seq=self._announcements,
        )
        self._bus.publish("phase", keys.phase(self._run), encode(message))
        self._announcements += 1
        self._announced_secs = now_secs

    def _note_changes(self, before: State, after: State, now_secs: float) -> None:
        if before.link is not after.link:
            self._files.note(now_secs, "link", f"the coordinator's own link is {after.link.value}")
        for block in sorted(after.frozen.keys() - before.frozen.keys()):
            self._files.note(now_secs, "frozen", frozen_name(block, after.frozen[block]))
        old, new = present(before), present(after)
        for life in sorted(new.keys() - old.keys()):
            self._files.note(now_secs, "joined", f"{life} ({new[life]}) joined")
        for life in sorted(old.keys() - new.keys()):
            self._files.note(now_secs, "lost", f"{life} ({old[life]}) is gone")
            self._heard.pop(life, None)
            self._decided.pop(life, None)

    def _answer(self, question: Question, now_secs: float) -> None:
        """A stop is in the journal before it is answered; asking it again changes nothing."""
        command = self._command_gate.admit(question.key, question.data)
        if not isinstance(command, Command):
            self._reply(question, "unread", ok=False, text=self._command_gate.last_refusal)
        elif command.name == "stop":
            self._decide(StopRequested(now=now_secs))
            self._reply(question, command.id, ok=True, text=waiting(self._plan, self._state))
        elif command.name == "describe":
            text = describe(self._run, self._plan, self._state, self._heard)
            self._reply(question, command.id, ok=True, text=text)
        else:
            assert_never(command.name)

    def _reply(self, question: Question, identity: str, *, ok: bool, text: str) -> None:
        reply = Reply(
            run=self._run,
            term=self._state.term,
            block=ALL_BLOCKS,
            life=self._life,
            seq=self._replies,
            id=identity,
            ok=ok,
            text=text,
        )
        self._replies += 1
        question.reply(encode(reply))

    def _may_leave(self, now_secs: float) -> bool:
        """After DONE: when all others but onlookers are gone or have had time to hear it, and to end."""
        if self._done_secs is None:
            return False
        since_secs = now_secs - self._done_secs
        if self._done_before and since_secs < LATECOMERS_SECS:
            return False
        others = set(awaited(self._plan, self._state).values()) - {SERVICE}
        if not others:
            return since_secs >= ANNOUNCE_SECS
        farewell_secs = RECORDER_SECS if RECORDER in others else FAREWELL_SECS
        linked_secs = now_secs - max(self._done_secs, self._unlinked_secs)
        return linked_secs >= farewell_secs or since_secs >= farewell_secs + self._settings.wire.connect_secs

    def _best(self) -> list[KeepBest]:
        kept = (best_of(self._state, block) for level in self._plan.levels for block in level)
        return [best for best in kept if best is not None]

    def _report(self) -> dict[str, Any]:
        gates = (self._gate, self._command_gate)
        stall = self._stall if self._state.stalled else ""
        refusal = self._gate.last_refusal or self._command_gate.last_refusal
        return {
            "versions": dict(self._state.versions),
            "totals": {
                "announcements": self._announcements,
                "members": len(present(self._state)),
                "scores": len(self._state.scores),
                "dropped": self._statuses.dropped + self._control.dropped,
            },
            "refused": dict(sum((Counter(gate.refused) for gate in gates), Counter[str]())),
            "queue_depth": len(self._statuses) + len(self._control),
            "waiting_for": waiting(self._plan, self._state),
            "last_error": stall or refusal,
        }
