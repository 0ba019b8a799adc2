"""What the coordinator's machine hears (events, past tense) and what it wants done (orders, imperative).

Pure data: frozen, standard library only. `journal.py` writes and reads the events.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from services.coordinator.table import Phase


@dataclass(frozen=True, kw_only=True)
class BlockProgress:
    """How far a learner is with one block in its term."""

    block: str
    done: int
    wanted: int
    unit: str
    finished: bool = False


@dataclass(frozen=True, kw_only=True)
class ScoreRow:
    """What one evaluation of one block found; the fields of `protocol.messages.Score` without the run."""

    block: str
    iteration: int
    phase: Phase
    separation: float
    separation_worst: float
    z_min: float
    z_goal: float
    switch_success: float
    crossing: float | None
    landmarks: Mapping[str, float] = field(default_factory=dict)
    landmark_vertices: Mapping[str, int] = field(default_factory=dict)
    external_reward: float | None = None
    external_reward_by_vertex: tuple[float | None, ...] | None = None
    policy: str
    steps: int
    encoder_version: int
    policy_version: int

    @property
    def key(self) -> tuple[str, int, Phase, str]:
        """What makes two rows the same row."""
        return self.block, self.iteration, self.phase, self.policy


@dataclass(frozen=True, kw_only=True)
class Started:
    """A coordinator process began, for the first time or again."""

    now: float


@dataclass(frozen=True, kw_only=True)
class Ticked:
    """Time went on."""

    now: float


@dataclass(frozen=True, kw_only=True)
class StatusReported:
    """A process said how it is; of a whole `Status` only what the machine needs."""

    now: float
    service: str
    life: str
    term: int
    versions: Mapping[str, int]
    """By "encoder/<block>" and "policy/<block>"."""
    progress: tuple[BlockProgress, ...] = ()
    scores: tuple[ScoreRow, ...] = ()
    waiting_for: str = ""


@dataclass(frozen=True, kw_only=True)
class MemberAppeared:
    """A process's liveliness token is there."""

    now: float
    service: str
    life: str


@dataclass(frozen=True, kw_only=True)
class MemberVanished:
    """A process's liveliness token is gone."""

    now: float
    service: str
    life: str


@dataclass(frozen=True, kw_only=True)
class LinkChanged:
    """The coordinator's own link to the router went up or down."""

    now: float
    up: bool


@dataclass(frozen=True, kw_only=True)
class StopRequested:
    """A person or the operating system asked the coordinator to stop; the run may go on later."""

    now: float


Event = Started | Ticked | StatusReported | MemberAppeared | MemberVanished | LinkChanged | StopRequested


@dataclass(frozen=True, kw_only=True)
class Frozen:
    """The versions with which a block that is done acts, and the versions whose work these are.

    They differ where the best iteration was not the last: it is published once more, as a newer version.
    """

    encoder: int
    policy: int
    of_encoder: int
    of_policy: int


@dataclass(frozen=True, kw_only=True)
class Announce:
    """Tell all what they do now."""

    term: int
    phase: Phase
    level: int
    iteration: int
    evaluates: Phase | None
    floors: Mapping[str, tuple[int, int]]
    """The blocks at work -> the least (encoder, policy) versions to work with."""
    frozen: Mapping[str, Frozen]
    """The blocks of the levels below."""


@dataclass(frozen=True, kw_only=True)
class RecordScores:
    """Write down scores that are new."""

    rows: tuple[ScoreRow, ...]


@dataclass(frozen=True, kw_only=True)
class KeepBest:
    """From now on this iteration is the block's best."""

    block: str
    iteration: int
    encoder_version: int
    policy_version: int
    reason: str


@dataclass(frozen=True, kw_only=True)
class SayStalled:
    """Tell people that nothing goes on, and who waits for whom."""

    sentence: str


@dataclass(frozen=True, kw_only=True)
class End:
    """End the coordinator: the run is completed, or it stops and may be resumed."""

    completed: bool


Order = Announce | RecordScores | KeepBest | SayStalled | End
