"""What the coordinator tells a person who asks, and whom it calls as witnesses of a stall (pure)."""

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from protocol.messages import MAX_REPLY_CHARS, Status
from services.coordinator.machine import best_of
from services.coordinator.state import Plan, State, iterations_now, present
from services.coordinator.waiting import waiting

Row = Mapping[str, Any]
LIST_CHARS = MAX_REPLY_CHARS // 4
"""Members, scores and best of an answer may each take so much."""
FROZEN_CHARS = MAX_REPLY_CHARS // 8
"""The list of frozen blocks may take so much, and what else is told far less."""
MOST_WITNESSES = 4


def describe(run: str, plan: Plan, state: State, heard: Mapping[str, Status]) -> str:
    """The answer to a describe command, as JSON that fits into a reply.

    Of lists that are too long it has the first members and blocks, and the newest scores: all of them are in
    `scores.jsonl`. `unlisted` says how many members are left out.
    """
    present_ones = sorted(present(state).items())
    members = _fitting(_member(life, service, heard.get(life)) for life, service in present_ones)
    newest = _fitting({"run": run, **asdict(row)} for row in reversed(state.scores))
    frozen = ({"block": block, **asdict(at)} for block, at in state.frozen.items())
    best = (best_of(state, block) for level in plan.levels for block in level)
    return json.dumps(
        {
            "run": run,
            "phase": state.phase.value,
            "evaluates": None if state.evaluates is None else state.evaluates.value,
            "level": state.level,
            "iteration": state.iteration,
            "iterations": iterations_now(plan, state),
            "term": state.term,
            "waiting": waiting(plan, state),
            "stalled": state.stalled,
            "members": members,
            "unlisted": len(present_ones) - len(members),
            "scores": newest[::-1],
            "best": _fitting(asdict(kept) for kept in best if kept is not None),
            "frozen": _fitting(frozen, FROZEN_CHARS),
        }
    )


def witnesses(state: State, heard: Iterable[Status]) -> list[str]:
    """What members say about a stall: those ahead of this coordinator, and what actors wait for."""
    said = []
    for status in sorted(heard, key=lambda status: status.life):
        if status.term > state.term:
            said.append(
                f"{status.life} is already in term {status.term}, so this journal is older than its "
                "checkpoints: put back the newest journal.jsonl or start a new run"
            )
        elif status.waiting_for and status.service == "actor":
            said.append(f"{status.life}: {status.waiting_for}")
    return said[:MOST_WITNESSES]


def _fitting(rows: Iterable[Row], most_chars: int = LIST_CHARS) -> Sequence[Row]:
    """As many of the first rows as there is room for."""
    fitting: list[Row] = []
    chars = 0
    for row in rows:
        chars += len(json.dumps(row)) + len(", ")
        if chars > most_chars:
            break
        fitting.append(row)
    return fitting


def _member(life: str, service: str, status: Status | None) -> Row:
    member: dict[str, Any] = {"life": life, "service": service}
    if status is not None:
        member |= {
            "term": status.term,
            "versions": dict(status.versions),
            "totals": dict(status.totals),
            "waiting_for": status.waiting_for,
            "last_error": status.last_error,
        }
    return member
