"""Sentences on who waits for whom (pure): what people read when nothing seems to happen."""

from services.coordinator.state import OwnLink, Plan, State, awaited, blocks_at_work, present
from services.coordinator.table import DUTY, Learner, Phase
from services.coordinator.words import BlockProgress

MOST_BLOCKS = 4
"""Blocks that one sentence names; the others are counted."""


def waiting(plan: Plan, state: State) -> str:
    """What the current phase still waits for; empty if for nothing."""
    others = {life: service for life, service in awaited(state).items() if service != "coordinator"}
    if state.stopping:
        return "stopped before the end; start it again with --resume to go on"
    if state.term == 0:
        return "waiting to be started"
    if state.phase is Phase.DONE:
        return f"waiting for {_count(len(others), 'member')} to leave" if others else ""
    if state.link is OwnLink.DOWN:
        return "waiting for this process's own link to the router"
    duty = DUTY[state.phase]
    assert duty.learner is not None
    if duty.learner not in others.values():
        return f"waiting for {_article(duty.learner)} to appear"
    progress = _progress(plan, state, duty.learner)
    if duty.needs_actors and "actor" not in others.values():
        return f"waiting for an actor to appear; {duty.learner} has {progress}"
    return f"waiting for {duty.learner}: {progress}"


def stalled(plan: Plan, state: State, now: float) -> str:
    """That nothing has gone on for a while, and who waits for whom."""
    quiet = f"no progress for {now - state.progress_at_secs:,.0f} s in {phase_name(state)}"
    parts = [f"{quiet}: the coordinator is {waiting(plan, state)}"]
    learner = DUTY[state.phase].learner
    if state.learner_waits_for:
        parts.append(f"{learner} says it is {_is_waiting(state.learner_waits_for)}")
    actors = list(present(state).values()).count("actor")
    parts.append("no actor is alive" if actors == 0 else f"{_count(actors, 'actor')} alive")
    return "; ".join(parts)


def phase_name(state: State) -> str:
    """The phase for a person, for example "evaluate of practise (level 0, iteration 2, term 12)"."""
    what = state.phase.value if state.evaluates is None else f"{state.phase.value} of {state.evaluates.value}"
    return f"{what} (level {state.level}, iteration {state.iteration}, term {state.term})"


def _progress(plan: Plan, state: State, learner: Learner) -> str:
    left = [block for block in blocks_at_work(plan, state) if block not in state.finished]
    named = [_block_progress(state, block, learner) for block in left[:MOST_BLOCKS]]
    if len(left) > MOST_BLOCKS:
        named.append(f"and {_count(len(left) - MOST_BLOCKS, 'more block')}")
    return ", ".join(named)


def _block_progress(state: State, block: str, learner: Learner) -> str:
    newest = _newest(state, block, learner)
    if newest is None:
        return f"no word yet of {block}"
    return f"{newest.done:,} of {newest.wanted:,} {newest.unit} of {block}"


def _newest(state: State, block: str, learner: Learner) -> BlockProgress | None:
    """What the learner alive now says; the furthest, if there are several or none."""
    alive = {life for life, service in present(state).items() if service == learner}
    said = {life: progress for (name, life), progress in state.progress.items() if name == block}
    of_alive = [progress for life, progress in said.items() if life in alive]
    return max(of_alive or said.values(), key=lambda progress: progress.done, default=None)


def _is_waiting(text: str) -> str:
    return text if text.startswith("waiting") else f"waiting for {text}"


def _article(service: str) -> str:
    return f"{'an' if service[0] in 'aeiou' else 'a'} {service}"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
