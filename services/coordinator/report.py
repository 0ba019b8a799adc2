"""What the coordinator tells a person who asks, and whom it calls as witnesses of a stall (pure)."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

from protocol.messages import MAX_REPLY_CHARS, Status
from services.coordinator.machine import best_of
from services.coordinator.state import Plan, State, present
from services.coordinator.waiting import waiting
from services.runtime.settings import RunSettings

MOST_SCORE_CHARS = MAX_REPLY_CHARS // 2
"""The newest scores in one answer; all of them are in `scores.jsonl`."""
MOST_WITNESSES = 4


def describe(run: str, settings: RunSettings, plan: Plan, state: State, heard: Mapping[str, Status]) -> str:
    """The answer to a describe command, as JSON."""
    best = (best_of(state, block) for level in plan.levels for block in level)
    members = sorted(present(state).items())
    return json.dumps(
        {
            "run": run,
            "phase": state.phase.value,
            "evaluates": None if state.evaluates is None else state.evaluates.value,
            "level": state.level,
            "levels": plan.levels,
            "iteration": state.iteration,
            "iterations": plan.iterations,
            "term": state.term,
            "waiting": waiting(plan, state),
            "stalled": state.stalled,
            "members": [_member(life, service, heard.get(life)) for life, service in members],
            "scores": _newest_scores(run, state),
            "best": [asdict(kept) for kept in best if kept is not None],
            "settings": settings.model_dump(mode="json"),
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


def _newest_scores(run: str, state: State) -> list[dict[str, Any]]:
    """As many of the newest rows as there is room for, in their order."""
    rows: list[dict[str, Any]] = []
    chars = 0
    for row in reversed(state.scores):
        rows.insert(0, {"run": run, **asdict(row)})
        chars += len(json.dumps(rows[0]))
        if chars > MOST_SCORE_CHARS:
            return rows[1:]
    return rows


def _member(life: str, service: str, status: Status | None) -> dict[str, Any]:
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
