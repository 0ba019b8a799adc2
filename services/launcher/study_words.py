"""What people read of a study that goes on (pure)."""

from services.launcher.lines import clock_words
from services.launcher.study_queue import Queue, Stage, Task

MOST_NAMED = 8


def progress_words(queue: Queue, now_secs: float) -> str:
    """How far all of it is, in one line."""
    done, failed = len(queue.of(Stage.DONE)), len(queue.of(Stage.FAILED))
    parts = [f"{done} of {len(queue.tasks)} runs done"]
    parts += [f"{failed} failed"] if failed else []
    if worked_at := queue.worked_at():
        parts.append(", ".join(task_words(task) for task in worked_at[:MOST_NAMED]))
    parts.append(left_words(queue.left_secs(now_secs)))
    return "; ".join(parts)


def task_words(task: Task) -> str:
    """A run that is worked at."""
    if task.stage is Stage.MEASURING:
        return f"{task.name} is measured"
    return f"{task.name} {task.share:.0%}"


def left_words(secs: float | None) -> str:
    """The remaining time."""
    return "remaining time not known yet" if secs is None else f"about {clock_words(secs)} left"


def ended_words(queue: Queue) -> list[str]:
    """What became of the study: a line for all, and one for each run that was left."""
    failed = queue.of(Stage.FAILED)
    lines = [f"{len(queue.of(Stage.DONE))} of {len(queue.tasks)} runs are done"]
    lines += [f"{task.name} failed {task.failures} times and was left: {task.reason}" for task in failed]
    return lines
