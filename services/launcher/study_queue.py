"""What of a study is done, goes on, failed and waits, and how long it still takes (pure: time is given).

A run is worked at twice: it is *trained* (`babble up`), then *measured*. So many are trained at once, one is
measured at a time. What fails is tried again after a pause, a few times, and then left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from enum import Enum

TRIES_AGAIN = 3
"""So often is a run tried again before it is left."""
PAUSES_SECS = (2.0, 10.0, 30.0)
"""Before each further try."""
MEASURE_SECS = 60.0
"""What measuring takes, where nothing is known of it."""


class Stage(Enum):
    """How far a run is."""

    WAITING = "waiting"
    """to be trained, or trained on"""
    TRAINING = "training"
    TRAINED = "trained"
    """to be measured"""
    MEASURING = "measuring"
    DONE = "done"
    FAILED = "failed"


WORKED_AT = (Stage.TRAINING, Stage.MEASURING)


@dataclass
class Task:
    """One run in the queue."""

    name: str
    kind: str
    """runs of one kind take about as long (its condition)"""
    like: str
    """kinds that are alike take about as long, where nothing is known of the kind itself"""
    stage: Stage = Stage.WAITING
    failures: int = 0
    due_secs: float = float("-inf")
    """not to be begun before"""
    since_secs: float = 0.0
    """when the work at it began"""
    share_then: float = 0.0
    """of its steps that were there when the work at it began"""
    share: float = 0.0
    """of its steps that are there"""
    reason: str = ""
    """why it failed last"""


@dataclass
class Queue:
    """All runs of a study, the most wanted first."""

    tasks: Sequence[Task]
    jobs: int
    """so many are trained at once"""
    known_secs: dict[str, float] = field(default_factory=dict)
    """by kind: what a whole training took"""
    measure_secs: float = MEASURE_SECS
    """what the last measuring took"""

    def next_training(self, now_secs: float) -> Task | None:
        """What to train now; None if there is nothing, or no room."""
        return self._next(Stage.WAITING, Stage.TRAINING, self.jobs, now_secs)

    def next_measuring(self, now_secs: float) -> Task | None:
        """What to measure now; None if there is nothing, or something is being measured."""
        return self._next(Stage.TRAINED, Stage.MEASURING, 1, now_secs)

    def begin(self, task: Task, now_secs: float) -> None:
        """The work at it has begun."""
        task.stage = Stage.TRAINING if task.stage is Stage.WAITING else Stage.MEASURING
        task.since_secs, task.share_then = now_secs, task.share

    def succeed(self, task: Task, now_secs: float) -> None:
        """The work at it is done."""
        secs = now_secs - task.since_secs
        if task.stage is Stage.TRAINING:
            if (done := 1.0 - task.share_then) > 0.5:
                self.known_secs[task.kind] = secs / done
            task.stage, task.share, task.failures = Stage.TRAINED, 1.0, 0
        else:
            task.stage, self.measure_secs = Stage.DONE, secs

    def fail(self, task: Task, reason: str, now_secs: float, *, for_good: bool = False) -> float | None:
        """The work at it failed; seconds until it is tried again, None if it is left."""
        task.failures, task.reason = task.failures + 1, reason
        if for_good or task.failures > TRIES_AGAIN:
            task.stage = Stage.FAILED
            return None
        pause_secs = PAUSES_SECS[min(task.failures, len(PAUSES_SECS)) - 1]
        task.stage = Stage.WAITING if task.stage is Stage.TRAINING else Stage.TRAINED
        task.due_secs = now_secs + pause_secs
        return pause_secs

    def postpone(self, task: Task, until_secs: float) -> None:
        """It cannot be begun yet, which is no failure."""
        task.due_secs = until_secs

    def worked_at(self) -> list[Task]:
        """What is being trained or measured."""
        return [task for task in self.tasks if task.stage in WORKED_AT]

    def of(self, stage: Stage) -> list[Task]:
        """The runs that are so far."""
        return [task for task in self.tasks if task.stage is stage]

    def over(self) -> bool:
        """True once every run is done or left."""
        return all(task.stage in (Stage.DONE, Stage.FAILED) for task in self.tasks)

    def left_secs(self, now_secs: float) -> float | None:
        """How long all of it still takes, from the runs' own speeds; None while none is known.

        Runs are dealt to the jobs in their order, each to the one that is free first; beside them one is
        measured at a time, and none before it is trained.
        """
        lasting = self._lasting(now_secs)
        left: list[float] = []
        for task in (*self.of(Stage.TRAINING), *self.of(Stage.WAITING)):
            secs = lasting.get(task.kind, lasting.get(task.like, lasting.get("")))
            if secs is None:
                return None
            left.append(secs * (1.0 - task.share))
        free_secs = [0.0] * self.jobs
        for secs in left:
            first = free_secs.index(min(free_secs))
            free_secs[first] += secs
        measured = self.of(Stage.TRAINED) + self.of(Stage.MEASURING)
        measuring_secs = self.measure_secs * (len(left) + len(measured))
        return max(max(free_secs) + self.measure_secs * bool(left), measuring_secs)

    def _next(self, stage: Stage, busy: Stage, most: int, now_secs: float) -> Task | None:
        if len(self.of(busy)) >= most:
            return None
        return next((task for task in self.of(stage) if task.due_secs <= now_secs), None)

    def _lasting(self, now_secs: float) -> Mapping[str, float]:
        """By kind, by those alike, and by "" for any: seconds of one whole training."""
        by_kind = dict(self.known_secs)
        for task in self.of(Stage.TRAINING):
            gained = task.share - task.share_then
            if gained > 0 and task.kind not in by_kind:
                by_kind[task.kind] = (now_secs - task.since_secs) / gained
        likes = {task.kind: task.like for task in self.tasks}
        groups: dict[str, list[float]] = {}
        for kind, secs in by_kind.items():
            groups.setdefault(likes.get(kind, ""), []).append(secs)
            groups.setdefault("", []).append(secs)
        return {**{group: sum(all_) / len(all_) for group, all_ in groups.items()}, **by_kind}
