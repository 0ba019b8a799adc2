"""The loop of `babble study`: trains and measures what the queue says, until all is done or it is stopped."""

import signal
import time
from collections.abc import Sequence
from dataclasses import dataclass

from services.launcher.interrupts import Interrupts
from services.launcher.lines import clock_words
from services.launcher.study_display import StudyDisplay
from services.launcher.study_plan import Run
from services.launcher.study_queue import Queue, Stage, Task
from services.launcher.study_runs import Workshop
from services.launcher.supervisor import USER_ERROR, Child, Exit, how_it_ended

POLL_SECS = 0.2
LOOK_SECS = 3.0
"""So often it is looked how far the runs are."""
STALL_SECS = 1800.0
"""A run without a step forward for so long is stopped, and gone on with."""
STOP_SECS = 20.0
"""Runs that are told to stop have so long."""
IN_USE_SECS = 2.0
"""A run that another process trains is asked for again so often."""
MOST_IN_USE_SECS = 60.0


@dataclass
class _Work:
    """A process at a run."""

    task: Task
    child: Child
    signs: object = None
    moved_secs: float = 0.0
    """when it last made a step forward"""


class StudyService:
    """Works at the runs of a study, one loop."""

    def __init__(self, runs: Sequence[Run], workshop: Workshop, *, jobs: int, display: StudyDisplay) -> None:
        self.queue = Queue([_task(run) for run in runs], jobs)
        self._runs = {run.name: run for run in runs}
        self._workshop, self._display = workshop, display
        self._works: list[_Work] = []
        self._in_use_since: dict[str, float] = {}
        self._looked_secs = float("-inf")

    def run(self, interrupts: Interrupts) -> int:
        """Until all runs are done or left, or a signal comes; returns the exit code.

        0 all done, 1 some failed, 128 and its number after a signal. Raises `UserError` for what is damaged.
        """
        self._survey()
        try:
            while not self.queue.over():
                if interrupts.numbers:
                    return self._stop(interrupts)
                self._step(time.monotonic())
                time.sleep(POLL_SECS)
        finally:
            for work in self._works:
                work.child.send(signal.SIGKILL)
        return 1 if self.queue.of(Stage.FAILED) else 0

    def know(self, secs: dict[str, float]) -> None:
        """How long runs of a condition took, of those that were done before."""
        self.queue.known_secs |= secs

    def _survey(self) -> None:
        """What earlier starts left."""
        for task in self.queue.tasks:
            run = self._runs[task.name]
            task.stage = self._workshop.stage(run)
            task.share = 0.0 if task.stage is Stage.WAITING else 1.0
            if task.stage is Stage.WAITING:
                task.share = self._share(task)
            elif task.stage is Stage.DONE:
                self._workshop.put_away(run)

    def _step(self, now_secs: float) -> None:
        for work in list(self._works):
            if (end := work.child.poll()) is not None:
                self._works.remove(work)
                self._ended(work.task, end, now_secs)
        while (task := self.queue.next_training(now_secs)) is not None:
            self._train(task, now_secs)
        while (task := self.queue.next_measuring(now_secs)) is not None:
            self._begin(task, self._workshop.measure(self._runs[task.name]), now_secs)
        if now_secs - self._looked_secs >= LOOK_SECS:
            self._looked_secs = now_secs
            for work in self._works:
                self._look(work, now_secs)
        self._display.show(self.queue, now_secs)

    def _train(self, task: Task, now_secs: float) -> None:
        run = self._runs[task.name]
        if self._workshop.in_use(run):
            since_secs = self._in_use_since.setdefault(task.name, now_secs)
            if now_secs - since_secs > MOST_IN_USE_SECS:
                self._fail(task, "it is going on in another process", now_secs, for_good=True)
            else:
                self.queue.postpone(task, now_secs + IN_USE_SECS)
            return
        task.share = self._share(task)
        self._begin(task, self._workshop.train(run), now_secs)
        goes_on = f" (goes on at {task.share:.0%})" if task.share else ""
        self._display.say(f"{task.name} begins{goes_on}", now_secs)

    def _begin(self, task: Task, child: Child, now_secs: float) -> None:
        self.queue.begin(task, now_secs)
        self._works.append(_Work(task, child, moved_secs=now_secs))

    def _ended(self, task: Task, end: Exit, now_secs: float) -> None:
        run, was = self._runs[task.name], task.stage
        wanted = (Stage.TRAINED, Stage.DONE) if was is Stage.TRAINING else (Stage.DONE,)
        if end.code == 0 and self._workshop.stage(run) in wanted:
            secs = now_secs - task.since_secs
            self.queue.succeed(task, now_secs)
            words = "is trained" if was is Stage.TRAINING else "is measured"
            self._display.say(f"{task.name} {words} ({clock_words(secs)})", now_secs)
            if task.stage is Stage.DONE:
                self._workshop.put_away(run)
                self._display.say(_counted(self.queue, now_secs), now_secs)
            return
        reason = self._workshop.last_words(run) or f"it {how_it_ended(end.code)}"
        # A measurement says with this code what another try would not change.
        self._fail(task, reason, now_secs, for_good=was is Stage.MEASURING and end.code == USER_ERROR)

    def _fail(self, task: Task, reason: str, now_secs: float, *, for_good: bool = False) -> None:
        pause_secs = self.queue.fail(task, reason, now_secs, for_good=for_good)
        what = "it is left" if pause_secs is None else f"tried again in {pause_secs:.0f} s"
        self._display.say(f"{task.name} failed ({reason}); {what}", now_secs)

    def _look(self, work: _Work, now_secs: float) -> None:
        task = work.task
        if task.stage is not Stage.TRAINING:
            return
        task.share = self._share(task)
        signs = self._workshop.signs(self._runs[task.name])
        if signs != work.signs:
            work.signs, work.moved_secs = signs, now_secs
        elif now_secs - work.moved_secs > STALL_SECS:
            self._display.say(
                f"{task.name} made no step for {clock_words(STALL_SECS)}; it is stopped", now_secs
            )
            work.moved_secs = now_secs
            work.child.send(signal.SIGTERM)

    def _share(self, task: Task) -> float:
        run = self._runs[task.name]
        return min(1.0, self._workshop.rows(run) / run.rows)

    def _stop(self, interrupts: Interrupts) -> int:
        """End all in order; at the second signal, or when it takes too long, at once."""
        number = interrupts.numbers[0]
        self._display.say("stopping the runs (again to kill them)", time.monotonic())
        deadline_secs = time.monotonic() + STOP_SECS
        for work in self._works:
            work.child.send(signal.SIGTERM)
        while self._works and len(interrupts.numbers) == 1 and time.monotonic() < deadline_secs:
            time.sleep(POLL_SECS / 4)
            self._works = [work for work in self._works if work.child.poll() is None]
        return 128 + number


def _task(run: Run) -> Task:
    return Task(name=run.name, kind=run.condition, like="learns" if run.learns else "open loop")


def _counted(queue: Queue, now_secs: float) -> str:
    left_secs = queue.left_secs(now_secs)
    words = "" if left_secs is None else f", about {clock_words(left_secs)} left"
    return f"{len(queue.of(Stage.DONE))} of {len(queue.tasks)} runs done{words}"
