"""Sentences on who waits for whom (pure): what people read when nothing seems to happen."""

from services.coordinator.state import OwnLink, Plan, State, awaited, blocks_at_work, duty_now, present
from services.coordinator.table import RECORDER, Phase, Worker
from services.coordinator.words import BlockProgress, Frozen

MOST_BLOCKS = 4
"""Blocks that one sentence names; the others are counted."""


def waiting(plan: Plan, state: State) -> str:
    """What the current phase still waits for; empty if for nothing."""
    others = {life: service for life, service in awaited(plan, state).items() if service != "coordinator"}
    if state.stopping:
        return "stopped before the end; start it again with --resume to go on"
    if state.term == 0:
        return "waiting to be started"
    if state.phase is Phase.DONE:
        return f"waiting for {_count(len(others), 'member')} to leave" if others else ""
    if state.link is OwnLink.DOWN:
        return "waiting for this process's own link to the router"
    duty = duty_now(plan, state)
    assert duty.worker is not None
    if duty.worker not in others.values():
        return f"waiting for {_article(duty.worker)} to appear"
    left = [block for block in blocks_at_work(plan, state) if block not in state.finished]
    missing = _missing(plan, state, duty.worker, left)
    if missing:
        there = [block for block in left if block not in missing]
        rest = f"; {duty.worker} has {_progress(state, there, duty.worker)}" if there else ""
        return f"waiting for {_processes(plan, duty.worker, missing)} to appear{rest}"
    progress = _progress(state, left, duty.worker)
    needed = [service for service in _needed(plan) if duty.needs_actors and service not in others.values()]
    if needed:
        return f"waiting for {_article(needed[0])} to appear; {duty.worker} has {progress}"
    return f"waiting for {duty.worker}: {progress}"


def stalled(plan: Plan, state: State, now: float) -> str:
    """That nothing has gone on for a while, and who waits for whom."""
    quiet = f"no progress for {now - state.progress_at_secs:,.0f} s in {phase_name(state)}"
    parts = [f"{quiet}: the coordinator is {waiting(plan, state)}"]
    worker = duty_now(plan, state).worker
    says = {life: text for life, text in state.workers_wait_for.items() if life in present(state)}
    for life, text in sorted(says.items()):
        parts.append(f"{worker if len(says) == 1 else life} says it is {_is_waiting(text)}")
    actors = list(present(state).values()).count("actor")
    parts.append("no actor is alive" if actors == 0 else f"{_count(actors, 'actor')} alive")
    return "; ".join(parts)


def phase_name(state: State) -> str:
    """The phase for a person, for example "evaluate of practise (level 0, iteration 2, term 12)"."""
    what = state.phase.value if state.evaluates is None else f"{state.phase.value} of {state.evaluates.value}"
    return f"{what} (level {state.level}, iteration {state.iteration}, term {state.term})"


def frozen_name(block: str, at: Frozen) -> str:
    """How a block was frozen, for a person."""
    encoder = f"encoder {at.encoder}{_old(at.encoder, at.of_encoder)}"
    return f"{block} is frozen at {encoder} and policy {at.policy}{_old(at.policy, at.of_policy)}"


def _old(version: int, of_version: int) -> str:
    return "" if version == of_version else f" (that is {of_version} again)"


def _needed(plan: Plan) -> list[str]:
    """Without whom actors do nothing, besides who asks them to."""
    return ["actor", *([RECORDER] if plan.records else [])]


def _missing(plan: Plan, state: State, worker: Worker, left: list[str]) -> list[str]:
    """The unfinished blocks whose worker is not there: no life that is alive can be that process.

    One that is alive and has said nothing in this term yet may be any of them.
    """
    lives = {life for life, service in present(state).items() if service == worker}
    said = [(block, life) for block, life in state.progress if life in lives]
    heard = {_share(plan, worker, block) for block, _ in said}
    silent = [block for block in left if _share(plan, worker, block) not in heard]
    wanted = {_share(plan, worker, block) for block in silent}
    unheard = lives - {life for _, life in said}
    are_enough = len(lives) >= plan.processes.get(worker, 1) and len(wanted) <= len(unheard)
    return [] if are_enough else silent


def _processes(plan: Plan, worker: Worker, blocks: list[str]) -> str:
    """Which processes the blocks wait for, and which blocks each."""
    shares: dict[int, list[str]] = {}
    for block in blocks:
        shares.setdefault(_share(plan, worker, block), []).append(block)
    return " and ".join(f"{worker} {index} of {_names(mine)}" for index, mine in sorted(shares.items()))


def _share(plan: Plan, worker: Worker, block: str) -> int:
    return plan.shares.get((worker, block), 0)


def _names(blocks: list[str]) -> str:
    more = len(blocks) - MOST_BLOCKS
    return ", ".join([*blocks[:MOST_BLOCKS], *([_count(more, "more block")] if more > 0 else [])])


def _progress(state: State, left: list[str], worker: Worker) -> str:
    named = [_block_progress(state, block, worker) for block in left[:MOST_BLOCKS]]
    if len(left) > MOST_BLOCKS:
        named.append(f"and {_count(len(left) - MOST_BLOCKS, 'more block')}")
    return ", ".join(named)


def _block_progress(state: State, block: str, worker: Worker) -> str:
    newest = _newest(state, block, worker)
    if newest is None:
        return f"no word yet of {block}"
    return f"{newest.done:,} of {newest.wanted:,} {newest.unit} of {block}"


def _newest(state: State, block: str, worker: Worker) -> BlockProgress | None:
    """What the worker alive now says; the furthest, if there are several or none."""
    alive = {life for life, service in present(state).items() if service == worker}
    said = {life: progress for (name, life), progress in state.progress.items() if name == block}
    of_alive = [progress for life, progress in said.items() if life in alive]
    return max(of_alive or said.values(), key=lambda progress: progress.done, default=None)


def _is_waiting(text: str) -> str:
    return text if text.startswith("waiting") else f"waiting for {text}"


def _article(service: str) -> str:
    return f"{'an' if service[0] in 'aeiou' else 'a'} {service}"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
