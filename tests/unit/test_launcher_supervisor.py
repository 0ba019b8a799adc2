"""The supervisor with processes and a clock that the test makes up."""

import signal
from pathlib import Path

import pytest

from services.launcher.supervisor import Exit, Part, Patience, Supervisor


class FakeChild:
    def __init__(self) -> None:
        self.exit: Exit | None = None
        self.signals: list[signal.Signals] = []

    def poll(self) -> Exit | None:
        return self.exit

    def send(self, number: signal.Signals) -> None:
        self.signals.append(number)


class Stage:
    """A supervisor of a router, a coordinator and actors, and what it has started."""

    def __init__(
        self, folder: Path, actors: int = 1, *, dashboard: bool = False, recorder: bool = False
    ) -> None:
        self.children: dict[str, list[FakeChild]] = {}
        self.folder = folder
        parts = [self._part("router", outlasts=True), self._part("coordinator", leads=True)]
        parts += [self._part(f"actor-{i}", expendable=True) for i in range(actors)]
        parts += [self._part("dashboard", optional=True)] if dashboard else []
        parts += [self._part("recorder", must_finish=True)] if recorder else []
        self.supervisor = Supervisor(parts, self._start)
        self.supervisor.poll(0.0, done=False)

    def end(self, name: str, code: int, now: float, *, done: bool = False) -> list[str]:
        self.children[name][-1].exit = Exit(code=code, cpu_secs=1.5)
        return self.supervisor.poll(now, done=done)

    def lives(self, name: str) -> int:
        return len(self.children[name])

    def _part(self, name: str, **flags: bool) -> Part:
        return Part(name=name, arguments=(name,), log=self.folder / f"{name}.log", **flags)

    def _start(self, part: Part) -> FakeChild:
        child = FakeChild()
        self.children.setdefault(part.name, []).append(child)
        return child


@pytest.fixture
def stage(tmp_path: Path) -> Stage:
    return Stage(tmp_path)


def test_all_parts_start_at_once(stage: Stage) -> None:
    assert {name: len(lives) for name, lives in stage.children.items()} == {
        "router": 1,
        "coordinator": 1,
        "actor-0": 1,
    }


def test_a_killed_process_is_started_again_after_its_delay_and_not_before(stage: Stage) -> None:
    assert stage.end("actor-0", -9, 10.0) == ["actor-0 was killed by SIGKILL; it is started again in 0.25 s"]
    stage.supervisor.poll(10.2, done=False)
    assert stage.lives("actor-0") == 1
    stage.supervisor.poll(10.25, done=False)
    assert stage.lives("actor-0") == 2


def test_an_end_in_order_before_the_run_is_done_is_a_death(stage: Stage) -> None:
    stage.end("actor-0", 0, 1.0)
    stage.supervisor.poll(2.0, done=False)
    assert stage.lives("actor-0") == 2


def test_the_delay_grows_up_to_a_bound() -> None:
    patience = Patience(most_deaths=9, first_delay_secs=0.5, longest_delay_secs=3.0)
    assert [patience.delay_secs(deaths) for deaths in (1, 2, 3, 4, 8, 9)] == [0.5, 1.0, 2.0, 3.0, 3.0, None]


def test_the_fifth_death_within_a_minute_ends_the_run_with_the_log_and_its_last_line(stage: Stage) -> None:
    (stage.folder / "actor-0.log").write_text("first\nKeyError: 'latent'\n\n")
    for death in range(5):
        assert stage.supervisor.fatal is None
        stage.end("actor-0", 1, 10.0 * death)
        stage.supervisor.poll(10.0 * death + 9.0, done=False)
    assert stage.supervisor.fatal is not None
    assert stage.supervisor.fatal_code == 1
    assert str(stage.folder / "actor-0.log") in stage.supervisor.fatal
    assert stage.supervisor.fatal.endswith("KeyError: 'latent'")
    assert stage.lives("actor-0") == 5


def test_deaths_that_are_far_apart_do_not_add_up(stage: Stage) -> None:
    for death in range(12):
        stage.end("actor-0", -11, 20.0 * death)
        stage.supervisor.poll(20.0 * death + 9.0, done=False)
    assert stage.supervisor.fatal is None
    assert stage.lives("actor-0") == 13


def test_the_run_goes_on_without_an_actor_that_keeps_dying_while_another_lives(tmp_path: Path) -> None:
    stage = Stage(tmp_path, actors=2)
    news: list[str] = []
    for death in range(5):
        news = stage.end("actor-0", 1, 6.0 * death)
        stage.supervisor.poll(6.0 * death + 5.0, done=False)
    assert stage.supervisor.fatal is None
    assert news[0].endswith("the run goes on without it")
    for death in range(5):
        stage.end("actor-1", 1, 40.0 + 6.0 * death)
        stage.supervisor.poll(45.0 + 6.0 * death, done=False)
    assert stage.supervisor.fatal is not None


def test_what_a_person_must_mend_is_not_tried_again(stage: Stage) -> None:
    (stage.folder / "coordinator.log").write_text("ready\ncoordinator: line 3 of the journal is damaged\n")
    assert stage.end("coordinator", 2, 1.0) == []
    stage.supervisor.poll(60.0, done=False)
    assert stage.supervisor.fatal == "coordinator: line 3 of the journal is damaged"
    assert stage.supervisor.fatal_code == 2
    assert stage.lives("coordinator") == 1


def test_it_is_finished_when_all_but_the_router_have_ended_after_the_run(stage: Stage) -> None:
    stage.end("actor-0", 0, 1.0, done=True)
    assert not stage.supervisor.finished()
    assert stage.supervisor.led()
    stage.end("coordinator", 0, 2.0, done=True)
    assert stage.supervisor.finished()
    assert not stage.supervisor.led()
    assert not stage.supervisor.ended()


def test_after_the_run_only_who_the_others_need_is_started_again(stage: Stage) -> None:
    stage.end("actor-0", -9, 1.0, done=True)
    stage.end("coordinator", -9, 1.0, done=True)
    stage.end("router", -9, 1.0, done=True)
    stage.supervisor.poll(9.0, done=True)
    assert {name: stage.lives(name) for name in stage.children} == {
        "router": 2,
        "coordinator": 2,
        "actor-0": 1,
    }


def test_nothing_is_started_again_once_it_stops_and_the_router_is_spared_at_first(stage: Stage) -> None:
    stage.end("actor-0", -9, 1.0)
    stage.supervisor.stop(signal.SIGTERM)
    stage.end("coordinator", 0, 2.0)
    stage.supervisor.poll(60.0, done=False)
    assert {name: stage.lives(name) for name in stage.children} == {
        "router": 1,
        "coordinator": 1,
        "actor-0": 1,
    }
    assert stage.supervisor.finished()
    assert stage.children["router"][0].signals == []
    stage.supervisor.stop(signal.SIGTERM, everything=True)
    assert stage.children["router"][0].signals == [signal.SIGTERM]


def test_cpu_seconds_are_those_of_all_lives(stage: Stage) -> None:
    stage.end("actor-0", -9, 1.0)
    stage.supervisor.poll(2.0, done=False)
    stage.end("actor-0", 0, 3.0, done=True)
    assert stage.supervisor.cpu_secs() == {"router": 0.0, "coordinator": 0.0, "actor-0": 3.0}


def test_a_dashboard_that_died_is_started_again(tmp_path: Path) -> None:
    stage = Stage(tmp_path, dashboard=True)
    assert stage.end("dashboard", -9, 1.0) == [
        "dashboard was killed by SIGKILL; it is started again in 0.25 s"
    ]
    stage.supervisor.poll(1.25, done=False)
    assert stage.lives("dashboard") == 2


def test_what_a_person_must_mend_of_a_dashboard_is_told_and_the_run_goes_on(tmp_path: Path) -> None:
    stage = Stage(tmp_path, dashboard=True)
    (tmp_path / "dashboard.log").write_text("dashboard: port 9090 is taken\n")
    assert stage.end("dashboard", 2, 1.0) == ["dashboard: port 9090 is taken; the run goes on without it"]
    stage.supervisor.poll(60.0, done=False)
    assert stage.supervisor.fatal is None
    assert stage.supervisor.given_up == {"dashboard"}
    assert stage.lives("dashboard") == 1


def test_a_dashboard_that_keeps_dying_is_given_up_and_the_run_goes_on(tmp_path: Path) -> None:
    stage = Stage(tmp_path, dashboard=True)
    news: list[str] = []
    for death in range(5):
        news = stage.end("dashboard", 1, 6.0 * death)
        stage.supervisor.poll(6.0 * death + 5.0, done=False)
    assert news[0].endswith("the run goes on without it")
    assert stage.supervisor.fatal is None
    assert stage.supervisor.given_up == {"dashboard"}


def test_a_dashboard_that_hangs_does_not_hold_up_the_end_and_is_killed(tmp_path: Path) -> None:
    stage = Stage(tmp_path, dashboard=True)
    stage.end("actor-0", 0, 1.0, done=True)
    stage.end("coordinator", 0, 1.0, done=True)
    assert stage.supervisor.finished()
    assert not stage.supervisor.alone()
    stage.supervisor.dismiss()
    assert stage.children["dashboard"][0].signals == [signal.SIGKILL]
    assert stage.children["router"][0].signals == []
    stage.end("dashboard", -9, 2.0, done=True)
    assert stage.supervisor.alone()


def test_a_recorder_that_died_after_the_run_finishes_its_work_and_so_does_who_tells_it_of_the_end(
    tmp_path: Path,
) -> None:
    stage = Stage(tmp_path, recorder=True)
    stage.end("actor-0", 0, 1.0, done=True)
    stage.end("coordinator", 0, 1.0, done=True)
    assert not stage.supervisor.finished()
    stage.end("recorder", -9, 2.0, done=True)
    assert not stage.supervisor.finished()
    stage.supervisor.poll(9.0, done=True)
    assert {name: stage.lives(name) for name in stage.children} == {
        "router": 1, "coordinator": 2, "actor-0": 1, "recorder": 2,
    }  # fmt: skip
    assert stage.supervisor.unfinished() == ["recorder"]
    stage.end("recorder", 0, 10.0, done=True)
    assert stage.supervisor.unfinished() == []


def test_a_recorder_that_is_stopped_after_the_run_has_not_finished(tmp_path: Path) -> None:
    stage = Stage(tmp_path, recorder=True)
    stage.supervisor.stop(signal.SIGTERM)
    stage.end("recorder", 0, 1.0, done=True)
    stage.supervisor.poll(9.0, done=True)
    assert stage.lives("recorder") == 1
    assert stage.supervisor.unfinished() == ["recorder"]


def test_the_run_does_not_go_on_without_a_recorder_that_keeps_dying(tmp_path: Path) -> None:
    stage = Stage(tmp_path, recorder=True)
    for death in range(5):
        stage.end("recorder", 1, 6.0 * death)
        stage.supervisor.poll(6.0 * death + 5.0, done=False)
    assert stage.supervisor.fatal is not None
    assert stage.supervisor.fatal.startswith("recorder failed with code 1 for the 5th time")
