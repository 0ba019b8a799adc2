"""Playing the learners to the coordinator's machine, for its tests."""

from collections.abc import Sequence
from dataclasses import replace

from services.coordinator.machine import decide
from services.coordinator.state import Plan, State, duty_now
from services.coordinator.table import Phase
from services.coordinator.words import (
    Announce,
    BlockProgress,
    Event,
    Order,
    ScoreRow,
    Started,
    StatusReported,
)

FLAT = Plan(levels=(("body",),), iterations=(2,), stall_secs=60.0)
OPEN = Plan(levels=(("body",),), iterations=(2,), stall_secs=60.0, open_loop=True, records=True)
HAND = Plan(levels=(("thumb", "index"), ("hand",)), iterations=(1, 1), stall_secs=60.0)


def play(plan: Plan, events: Sequence[Event], state: State | None = None) -> tuple[State, list[Order]]:
    state, orders = state or State(), []
    for event in events:
        state, more = decide(plan, state, event)
        orders += more
    return state, orders


def score(state: State, block: str, **changes: object) -> ScoreRow:
    row = ScoreRow(
        block=block,
        iteration=state.iteration,
        phase=state.evaluates or Phase.GROUND,
        separation=0.95,
        separation_worst=0.9,
        z_min=0.92,
        z_goal=0.97,
        switch_success=1.0,
        crossing=None,
        policy="mean",
        steps=100 * state.term,
        encoder_version=1 + state.iteration,
        policy_version=10 + state.iteration,
    )
    return replace(row, **changes)  # type: ignore[arg-type]


def finishing(plan: Plan, state: State, life: str = "a", now: float = 1.0) -> StatusReported:
    """The responsible learner's word that all blocks are finished."""
    learner = duty_now(plan, state).worker or "policy_learner"
    model = "encoder" if learner == "encoder_learner" else "policy"
    blocks = plan.levels[state.level]
    versions = {} if learner == "recorder" else {f"{model}/{block}": 100 + state.term for block in blocks}
    return StatusReported(
        now=now,
        service=learner,
        life=life,
        term=state.term,
        versions=versions,
        progress=tuple(
            BlockProgress(block=block, done=5, wanted=5, unit="steps", finished=True) for block in blocks
        ),
        scores=tuple(score(state, block) for block in blocks) if state.phase is Phase.EVALUATE else (),
    )


def walk_to(plan: Plan, phase: Phase, iteration: int = 0) -> State:
    state, _ = play(plan, [Started(now=0.0)])
    while (state.phase, state.iteration) != (phase, iteration):
        state, _ = decide(plan, state, finishing(plan, state))
    return state


def run_through(plan: Plan) -> list[Announce]:
    state, orders = play(plan, [Started(now=0.0)])
    while state.phase is not Phase.DONE:
        state, more = decide(plan, state, finishing(plan, state))
        orders += more
    return [order for order in orders if isinstance(order, Announce)]
