"""Between the wire's messages and the machine's words (pure)."""

from dataclasses import asdict

from protocol import messages
from services.coordinator.table import Phase
from services.coordinator.words import Announce, BlockProgress, ScoreRow, StatusReported

LONGEST_REASON = 300
"""Characters kept of what a process says it waits for: it goes into the journal."""


def status_reported(now_secs: float, status: messages.Status) -> StatusReported:
    """What the machine hears of a status."""
    return StatusReported(
        now=now_secs,
        service=status.service,
        life=status.life,
        term=status.term,
        versions={name: version for name, version in status.versions.items() if version > 0},
        progress=tuple(
            BlockProgress(
                block=said.block, done=said.done, wanted=said.wanted, unit=said.unit, finished=said.finished
            )
            for said in status.progress
        ),
        scores=tuple(map(_row, status.scores)),
        waiting_for=status.waiting_for[:LONGEST_REASON],
    )


def announced(order: Announce, *, iterations: int, run: str, life: str, seq: int) -> messages.PhaseAnnounced:
    """The message of an announcement; `iterations` are those of its level."""
    return messages.PhaseAnnounced(
        run=run,
        term=order.term,
        block=messages.ALL_BLOCKS,
        life=life,
        seq=seq,
        phase=messages.Phase(order.phase),
        level=order.level,
        iteration=order.iteration,
        iterations=iterations,
        evaluates=None if order.evaluates is None else messages.Phase(order.evaluates),
        blocks={
            block: messages.ModelFloor(encoder=encoder, policy=policy)
            for block, (encoder, policy) in order.floors.items()
        },
        frozen={block: messages.Frozen(**asdict(frozen)) for block, frozen in order.frozen.items()},
    )


def settings_announced(
    config: str, *, began_secs: float, run: str, life: str, term: int
) -> messages.SettingsAnnounced:
    """The message that tells the run's settings; `began_secs` is when its first coordinator began."""
    return messages.SettingsAnnounced(
        run=run,
        term=term,
        block=messages.ALL_BLOCKS,
        life=life,
        seq=0,
        config=config,
        began_ms=round(1000 * began_secs),
    )


def _row(score: messages.Score) -> ScoreRow:
    by_vertex = score.external_reward_by_vertex
    return ScoreRow(
        block=score.block,
        iteration=score.iteration,
        phase=Phase(score.phase),
        separation=score.separation,
        separation_worst=score.separation_worst,
        z_min=score.z_min,
        z_goal=score.z_goal,
        switch_success=score.switch_success,
        crossing=score.crossing,
        landmarks=score.landmarks,
        landmark_vertices=score.landmark_vertices,
        external_reward=score.external_reward,
        external_reward_by_vertex=None if by_vertex is None else tuple(by_vertex),
        policy=score.policy,
        steps=score.steps,
        encoder_version=score.encoder_version,
        policy_version=score.policy_version,
    )
