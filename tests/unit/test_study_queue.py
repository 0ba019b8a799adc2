"""What of a study comes next, and how long it takes."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from services.launcher.study_queue import MEASURE_SECS, PAUSES_SECS, TRIES_AGAIN, Queue, Stage, Task
from services.launcher.study_words import ended_words, progress_words


def queue(*kinds: str, jobs: int = 1, **known: float) -> Queue:
    """Runs of some kinds; capital ones are alike, and so are the others."""
    tasks = [Task(f"{kind}{place}", kind, str(kind.isupper())) for place, kind in enumerate(kinds)]
    return Queue(tasks, jobs, dict(known))


def train(line: Queue, began_secs: float, ended_secs: float) -> Task:
    """The next one, from beginning to end."""
    task = line.next_training(began_secs)
    assert task is not None
    line.begin(task, began_secs)
    line.succeed(task, ended_secs)
    return task


def test_runs_are_begun_in_their_order_and_only_as_many_as_there_is_room_for() -> None:
    line = queue("a", "b", "c", jobs=2)
    for expected in ("a0", "b1"):
        task = line.next_training(0.0)
        assert task is not None
        assert task.name == expected
        line.begin(task, 0.0)
    assert line.next_training(0.0) is None
    line.succeed(line.tasks[1], 5.0)
    following = line.next_training(5.0)
    assert following is not None
    assert following.name == "c2"


def test_measuring_holds_up_no_training_and_is_done_one_at_a_time() -> None:
    line = queue("a", "b", "c")
    train(line, 0, 1)
    train(line, 1, 2)
    measuring = line.next_measuring(2)
    assert measuring is line.tasks[0]
    line.begin(measuring, 2)
    assert line.next_measuring(2) is None
    assert line.next_training(2) is line.tasks[2]


def test_a_failed_run_waits_for_its_turn_while_others_go_on_and_is_left_in_the_end() -> None:
    line = queue("a", "b")
    first = line.tasks[0]
    for pause in PAUSES_SECS:
        line.begin(first, 0.0)
        assert line.fail(first, "it broke", 0.0) == pause
        assert line.next_training(0.0) is line.tasks[1]
        assert line.next_training(pause) is first
    line.begin(first, 100.0)
    assert line.fail(first, "it broke", 100.0) is None
    assert first.stage is Stage.FAILED
    assert not line.over()
    train(line, 100, 101)
    line.begin(line.tasks[1], 101)
    line.succeed(line.tasks[1], 102)
    assert line.over()
    assert ended_words(line) == [
        "1 of 2 runs are done",
        f"a0 failed {TRIES_AGAIN + 1} times and was left: it broke",
    ]


def test_remaining_time_comes_from_the_runs_own_speeds() -> None:
    line = queue("a", "B", "a", "B", jobs=2, a=100.0, B=300.0)
    # a0 and B1 go first; a2 follows a0, and B3 follows whichever ends first, a2 after 200 s.
    assert line.left_secs(0.0) == pytest.approx(500.0 + MEASURE_SECS)
    task = line.tasks[0]
    line.begin(task, 0.0)
    task.share = 0.5
    assert line.left_secs(0.0) == pytest.approx(450.0 + MEASURE_SECS)


def test_remaining_time_of_a_kind_that_nobody_knows_is_that_of_those_alike() -> None:
    line = queue("a", "b")
    assert line.left_secs(0.0) is None
    assert "not known yet" in progress_words(line, 0.0)
    train(line, 0.0, 50.0)
    # Two are to be measured, which takes longer than the training.
    assert line.left_secs(50.0) == pytest.approx(2 * MEASURE_SECS)
    line.begin(line.tasks[1], 50.0)
    line.tasks[1].share = 0.25
    # A quarter took 25 s, so that the rest takes 75 s.
    line.measure_secs = 5.0
    assert line.left_secs(75.0) == pytest.approx(75.0 + 5.0)


def test_a_run_that_was_gone_on_with_tells_its_speed_by_what_was_left() -> None:
    line = queue("a", "a")
    line.tasks[0].share = 0.4
    train(line, 0.0, 60.0)
    assert line.known_secs["a"] == pytest.approx(100.0)


@given(st.lists(st.sampled_from("aB"), min_size=1, max_size=12), st.integers(1, 5), st.data())
def test_whatever_fails_each_run_ends_done_or_left(kinds: list[str], jobs: int, data: st.DataObject) -> None:
    line, now = queue(*kinds, jobs=jobs), 0.0
    for _ in range(len(kinds) * 2 * (TRIES_AGAIN + 2) + 1):
        now += 100.0
        while (task := line.next_training(now) or line.next_measuring(now)) is not None:
            line.begin(task, now)
        assert len(line.of(Stage.TRAINING)) <= jobs
        assert len(line.of(Stage.MEASURING)) <= 1
        for task in line.worked_at():
            if data.draw(st.booleans()):
                line.succeed(task, now + 1)
            else:
                line.fail(task, "why", now + 1)
        if line.over():
            break
    assert line.over()
    assert all(task.failures <= TRIES_AGAIN + 1 for task in line.tasks)
