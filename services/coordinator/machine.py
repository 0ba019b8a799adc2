"""The coordinator's mind: `decide(plan, state, event) -> (state, orders)`.

Pure: no clock, bus, disk, thread or random number; time arrives inside the events. Whatever is late,
foreign, duplicated or out of order changes nothing and raises nothing. The legal moves are in `table.NEXT`.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import assert_never

from services.coordinator.best import best, reason
from services.coordinator.state import Member, OwnLink, Plan, State, blocks_at_work, duty_now, iterations_now
from services.coordinator.table import NEXT, Learner, Phase
from services.coordinator.waiting import stalled
from services.coordinator.words import (
    Announce,
    BlockProgress,
    End,
    Event,
    Frozen,
    KeepBest,
    LinkChanged,
    MemberAppeared,
    MemberVanished,
    Order,
    RecordScores,
    SayStalled,
    ScoreRow,
    Started,
    StatusReported,
    StopRequested,
    Ticked,
)

MODEL_OF: Mapping[Learner, str] = {"encoder_learner": "encoder", "policy_learner": "policy"}
Decision = tuple[State, list[Order]]


def decide(plan: Plan, state: State, event: Event) -> Decision:
    """The state after the event and what is to be done; the same state if the event says nothing new."""
    match event:
        case Started():
            return _started(plan, state, event)
        case Ticked():
            return _ticked(plan, state, event)
        case StatusReported():
            return _status_reported(plan, state, event)
        case MemberAppeared(service=service, life=life):
            return replace(state, members={**state.members, life: Member(service=service)}), []
        case MemberVanished(now=now, life=life):
            return _member_vanished(state, life, now), []
        case LinkChanged(now=now, up=up):
            return _link_changed(state, up, now), []
        case StopRequested():
            if state.stopping or state.phase is Phase.DONE:
                return state, []
            return replace(state, stopping=True), [End(completed=False)]
        case _:
            assert_never(event)


def announcement(state: State) -> Announce:
    """What all do now, as it is repeated each second."""
    return Announce(
        term=state.term,
        phase=state.phase,
        level=state.level,
        iteration=state.iteration,
        evaluates=state.evaluates,
        floors=state.floors,
        frozen=state.frozen,
    )


def best_of(state: State, block: str) -> KeepBest | None:
    """The best iteration of a block so far."""
    row = best(row for row in state.scores if row.block == block)
    if row is None:
        return None
    return KeepBest(
        block=block,
        iteration=row.iteration,
        encoder_version=row.encoder_version,
        policy_version=row.policy_version,
        reason=reason(row),
    )


def _started(plan: Plan, state: State, event: Started) -> Decision:
    """A new process knows nobody yet, whatever its predecessor knew, and has waited for nobody yet."""
    if state.term == 0:
        floors = {block: (0, 0) for block in plan.levels[0]}
        state = replace(state, term=1, floors=floors)
    state = replace(
        state,
        members={},
        link=OwnLink.UP,
        link_at_secs=event.now,
        progress_at_secs=event.now,
        stalled=False,
        stopping=False,
    )
    ending: list[Order] = [End(completed=True)] if state.phase is Phase.DONE else []
    return state, [announcement(state), *ending]


def _ticked(plan: Plan, state: State, event: Ticked) -> Decision:
    if state.link is OwnLink.SETTLING and event.now - state.link_at_secs >= plan.link_grace_secs:
        state = replace(state, link=OwnLink.UP)
    if state.link is OwnLink.UP:
        kept = {
            life: member
            for life, member in state.members.items()
            if member.lost_at_secs is None or event.now - member.lost_at_secs < plan.link_grace_secs
        }
        if len(kept) < len(state.members):
            state = replace(state, members=kept)
    quiet_secs = event.now - state.progress_at_secs
    if not state.working or state.stalled or quiet_secs < plan.stall_secs:
        return state, []
    return replace(state, stalled=True), [SayStalled(sentence=stalled(plan, state, event.now))]


def _member_vanished(state: State, life: str, now: float) -> State:
    """The member is remembered for a while: if the own link turns out to be down, it was not the member."""
    member = state.members.get(life)
    if member is None or member.lost_at_secs is not None:
        return state
    return replace(state, members={**state.members, life: replace(member, lost_at_secs=now)})


def _link_changed(state: State, up: bool, now: float) -> State:
    if up == (state.link is not OwnLink.DOWN):
        return state
    return replace(state, link=OwnLink.SETTLING if up else OwnLink.DOWN, link_at_secs=now)


def _status_reported(plan: Plan, state: State, event: StatusReported) -> Decision:
    if not state.working or event.term != state.term:
        return state, []
    heard, orders = replace(state, versions=_newest_versions(plan, state, event)), list[Order]()
    responsible = event.service == duty_now(plan, state).worker
    if responsible:
        heard = _hear_progress(plan, heard, event)
        heard, orders = _hear_scores(plan, heard, event)
    if heard != state:
        heard = replace(heard, progress_at_secs=max(state.progress_at_secs, event.now), stalled=False)
    if responsible:
        heard = _hear_waiting(heard, event)
    if heard.finished.issuperset(blocks_at_work(plan, heard)):
        heard, more = _advance(plan, heard)
        orders += more
    return heard, orders


def _newest_versions(plan: Plan, state: State, event: StatusReported) -> dict[str, int]:
    """A learner is believed about its own models only; a lesser version is a late word."""
    known = dict(state.versions)
    for learner, model in MODEL_OF.items():
        for block in (block for level in plan.levels for block in level):
            name = f"{model}/{block}"
            if event.service == learner and event.versions.get(name, 0) > known.get(name, 0):
                known[name] = event.versions[name]
    return known


def _hear_progress(plan: Plan, state: State, event: StatusReported) -> State:
    progress, finished = dict(state.progress), set(state.finished)
    for said in event.progress:
        if said.block not in blocks_at_work(plan, state):
            continue
        before = progress.get((said.block, event.life))
        if before is None or _extent(said) > _extent(before):
            progress[said.block, event.life] = said
        if said.finished:
            finished.add(said.block)
    return replace(state, progress=progress, finished=frozenset(finished))


def _hear_waiting(state: State, event: StatusReported) -> State:
    """Waiting, or no more: that is no progress."""
    others = {life: text for life, text in state.workers_wait_for.items() if life != event.life}
    said = {event.life: event.waiting_for} if event.waiting_for else {}
    return replace(state, workers_wait_for={**others, **said})


def _extent(said: BlockProgress) -> tuple[int, int, str, bool]:
    return said.done, said.wanted, said.unit, said.finished


def _hear_scores(plan: Plan, state: State, event: StatusReported) -> Decision:
    known = {row.key for row in state.scores}
    fresh: list[ScoreRow] = []
    for row in event.scores:
        of_this_term = row.block in blocks_at_work(plan, state) and row.iteration == state.iteration
        if state.phase is Phase.EVALUATE and of_this_term and row.key not in known:
            known.add(row.key)
            fresh.append(row)
    if not fresh:
        return state, []
    scored = replace(state, scores=(*state.scores, *fresh))
    orders: list[Order] = [RecordScores(rows=tuple(fresh))]
    for block in dict.fromkeys(row.block for row in fresh):
        kept = best_of(scored, block)
        if kept is not None and kept != best_of(state, block):
            orders.append(kept)
    return scored, orders


def _advance(plan: Plan, state: State) -> Decision:
    """One move along the table; a new term in which nothing has been heard yet."""
    phase = _next_phase(plan, state)
    left = blocks_at_work(plan, state) if phase is Phase.BABBLE else ()
    state = replace(
        state,
        frozen={**state.frozen, **{block: _frozen(state, block) for block in left}},
        term=state.term + 1,
        phase=phase,
        level=state.level + (phase is Phase.BABBLE),
        iteration=0 if phase is Phase.BABBLE else state.iteration + (phase is Phase.WALK),
        evaluates=state.phase if phase is Phase.EVALUATE else None,
        progress={},
        finished=frozenset(),
        workers_wait_for={},
    )
    state = replace(state, floors={block: _floor(state, block) for block in blocks_at_work(plan, state)})
    ending: list[Order] = [End(completed=True)] if phase is Phase.DONE else []
    return state, [announcement(state), *ending]


def _next_phase(plan: Plan, state: State) -> Phase:
    moves = NEXT[state.phase]
    if len(moves) == 1:
        return next(iter(moves))
    if state.phase is Phase.BABBLE:
        return Phase.DONE if plan.open_loop else Phase.ENCODE
    if state.iteration < iterations_now(plan, state):
        return Phase.WALK
    return Phase.BABBLE if state.level + 1 < len(plan.levels) else Phase.DONE


def _floor(state: State, block: str) -> tuple[int, int]:
    return state.versions.get(f"encoder/{block}", 0), state.versions.get(f"policy/{block}", 0)


def _frozen(state: State, block: str) -> Frozen:
    """At the versions of its best iteration; without any score, at its newest ones."""
    kept = best_of(state, block)
    newest_encoder, newest_policy = _floor(state, block)
    encoder, of_encoder = _kept(newest_encoder, kept.encoder_version if kept else 0)
    policy, of_policy = _kept(newest_policy, kept.policy_version if kept else 0)
    return Frozen(encoder=encoder, policy=policy, of_encoder=of_encoder, of_policy=of_policy)


def _kept(newest: int, best_version: int) -> tuple[int, int]:
    """(the version to act with, the version whose work it is): an older one is published once more."""
    newest = max(newest, best_version)
    if best_version in (0, newest):
        return newest, newest
    return newest + 1, best_version
