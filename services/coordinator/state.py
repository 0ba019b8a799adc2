"""The plan of a run and the state of its coordinator: pure data, and the questions one asks of it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from services.coordinator.table import DUTY, OPEN_LOOP, RECORDER, Duty, Phase, Worker
from services.coordinator.words import BlockProgress, Frozen, ScoreRow

ONLOOKERS = frozenset({"dashboard", RECORDER, "router"})
"""Services that only watch or carry a run: it goes on without them and waits for none of them.

The recorder is none in a run that records.
"""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run does: the block names of each level, bottom-up, and how often each level iterates.

    Raises ValueError if a level is empty or without its number of iterations, a block is named twice, or
    nothing is learned and nothing recorded.
    """

    levels: tuple[tuple[str, ...], ...]
    iterations: tuple[int, ...]
    """of each level"""
    stall_secs: float
    """no progress for so long is a stall"""
    link_grace_secs: float = 3.0
    """members have so long to be seen again once the own link is up; longer than a reconnect takes"""
    open_loop: bool = False
    """nothing is learned: actors babble, the recorder writes it down, and the run is done"""
    records: bool = False
    """the recorder writes down what actors do: they do nothing without it, and at the end it is waited for"""
    processes: Mapping[Worker, int] = field(default_factory=dict)
    """how many of each learner share the blocks; 1 where it is not said"""
    shares: Mapping[tuple[Worker, str], int] = field(default_factory=dict)
    """(learner, block) -> the index of the process that learns it; 0 where it is not said"""

    def __post_init__(self) -> None:
        names = [block for level in self.levels for block in level]
        if not self.levels or not all(self.levels) or len(set(names)) != len(names):
            raise ValueError(f"each level needs blocks and each block one level; got {self.levels}")
        if len(self.iterations) != len(self.levels):
            raise ValueError(f"{len(self.levels)} levels cannot have the iterations {self.iterations}")
        if self.open_loop and not self.records:
            raise ValueError("an open loop of which nothing is recorded has nobody to end it")


class OwnLink(StrEnum):
    """The coordinator's own link to the router; only while it is UP does a lost token mean a lost member."""

    UP = "up"
    DOWN = "down"
    SETTLING = "settling"
    """Up again, but the members may still be on their way back."""


@dataclass(frozen=True, kw_only=True)
class Member:
    """A process of the run; `lost_at_secs` once its token is gone."""

    service: str
    lost_at_secs: float | None = None


@dataclass(frozen=True, kw_only=True)
class State:
    """All that the coordinator knows; what is heard in a term is forgotten with the term."""

    term: int = 0
    """0 before the first start, then it grows by one at each phase change."""
    phase: Phase = Phase.BABBLE
    level: int = 0
    iteration: int = 0
    evaluates: Phase | None = None
    floors: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    frozen: Mapping[str, Frozen] = field(default_factory=dict)
    """The blocks of the levels that are done, as each was frozen when its level was left."""
    versions: Mapping[str, int] = field(default_factory=dict)
    """The newest versions that the learners reported, by "encoder/<block>" and "policy/<block>"."""
    progress: Mapping[tuple[str, str], BlockProgress] = field(default_factory=dict)
    """By (block, life), because a learner that starts again counts again."""
    finished: frozenset[str] = frozenset()
    workers_wait_for: Mapping[str, str] = field(default_factory=dict)
    """By life, what each of those responsible says in this term."""
    scores: tuple[ScoreRow, ...] = ()
    members: Mapping[str, Member] = field(default_factory=dict)
    link: OwnLink = OwnLink.UP
    link_at_secs: float = 0.0
    progress_at_secs: float = 0.0
    stalled: bool = False
    stopping: bool = False

    @property
    def working(self) -> bool:
        """True while there is a phase that somebody works on."""
        return self.term > 0 and self.phase is not Phase.DONE and not self.stopping


def blocks_at_work(plan: Plan, state: State) -> tuple[str, ...]:
    """The blocks of the current level; none before the first start and after the last phase."""
    if state.term == 0 or state.phase is Phase.DONE or state.level >= len(plan.levels):
        return ()
    return plan.levels[state.level]


def duty_now(plan: Plan, state: State) -> Duty:
    """What is done in the current phase, and who ends it."""
    return OPEN_LOOP.get(state.phase, DUTY[state.phase]) if plan.open_loop else DUTY[state.phase]


def iterations_now(plan: Plan, state: State) -> int:
    """How often the current level iterates; after the last phase, the last level."""
    return plan.iterations[min(state.level, len(plan.iterations) - 1)]


def present(state: State) -> dict[str, str]:
    """Life -> service of those taken to be alive: while the own link is not up, all that were before."""
    return {
        life: member.service
        for life, member in state.members.items()
        if member.lost_at_secs is None or state.link is not OwnLink.UP
    }


def awaited(plan: Plan, state: State) -> dict[str, str]:
    """Those present whom the run waits for: all but onlookers."""
    onlookers = ONLOOKERS - {RECORDER} if plan.records else ONLOOKERS
    return {life: service for life, service in present(state).items() if service not in onlookers}
