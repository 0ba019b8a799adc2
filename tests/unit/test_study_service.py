"""The loop of a study with runs that are played: what is begun, tried again, measured and left."""

import io
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import pytest

from services.launcher import study_service
from services.launcher.interrupts import Interrupts
from services.launcher.study_display import PlainStudyDisplay
from services.launcher.study_plan import Plan, Run, parse_plan, runs_of
from services.launcher.study_queue import Stage
from services.launcher.study_service import StudyService
from services.launcher.supervisor import Exit
from services.runtime.settings import RunSettings, parse


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_service, "POLL_SECS", 0.001)
    monkeypatch.setattr("services.launcher.study_queue.PAUSES_SECS", (0.01,))


def plan() -> Plan:
    """Two conditions that learn and one that does not."""
    conditions = [
        {"id": "A", "title": "learns"},
        {"id": "B", "title": "learns too"},
        {"id": "N", "title": "noise", "change": {"phases": {"open_loop": True}}},
    ]
    return parse_plan(
        {"study": "play", "title": "t", "base": "b", "steps": 100, "seeds": [0, 1], "condition": conditions},
        origin="here",
    )


def base() -> RunSettings:
    """A scenario that records."""
    return parse({"scenario": "play", "recording": {"every_steps": 1}}, origin="here")


@dataclass
class PlayedChild:
    """A process that ends at the second look, or when it is told to."""

    end: Callable[[], int]
    lasts: bool = False
    looks: int = 0
    told: list[int] = field(default_factory=list)

    def poll(self) -> Exit | None:
        self.looks += 1
        if self.told:
            return Exit(code=-self.told[0], cpu_secs=0.0)
        if self.lasts or self.looks < 2:
            return None
        return Exit(code=self.end(), cpu_secs=0.0)

    def send(self, number: signal.Signals) -> None:
        self.told.append(number)


@dataclass
class PlayedWorkshop:
    """Keeps on "disk" how far runs are; says who was begun in which order, and how many at once."""

    stages: dict[str, Stage] = field(default_factory=dict)
    codes: dict[str, list[int]] = field(default_factory=dict)
    """what trainings end with, one after the other; then 0"""
    measure_codes: dict[str, list[int]] = field(default_factory=dict)
    lasting: set[str] = field(default_factory=set)
    trained: list[str] = field(default_factory=list)
    measured: list[str] = field(default_factory=list)
    away: list[str] = field(default_factory=list)
    going_on: Counter[str] = field(default_factory=Counter)
    most_at_once: Counter[str] = field(default_factory=Counter)
    children: list[PlayedChild] = field(default_factory=list)
    others: dict[str, int] = field(default_factory=dict)
    """in use by somebody else, for so many looks"""

    def stage(self, run: Run) -> Stage:
        return self.stages.get(run.name, Stage.WAITING)

    def in_use(self, run: Run) -> bool:
        left = self.others.get(run.name, 0)
        self.others[run.name] = left - 1
        return left > 0

    def train(self, run: Run) -> PlayedChild:
        self.trained.append(run.name)
        return self._start("train", run, self.codes, Stage.TRAINED)

    def measure(self, run: Run) -> PlayedChild:
        self.measured.append(run.name)
        return self._start("measure", run, self.measure_codes, Stage.DONE)

    def rows(self, run: Run) -> int:
        return 100 if self.stage(run) is not Stage.WAITING else 0

    def signs(self, run: Run) -> object:
        return None

    def last_words(self, run: Run) -> str:
        return f"what {run.name} said"

    def put_away(self, run: Run) -> None:
        self.away.append(run.name)

    def _start(self, work: str, run: Run, codes: dict[str, list[int]], then: Stage) -> PlayedChild:
        self.going_on[work] += 1
        self.most_at_once[work] = max(self.most_at_once[work], self.going_on[work])

        def end() -> int:
            self.going_on[work] -= 1
            code = codes[run.name].pop(0) if codes.get(run.name) else 0
            if code == 0:
                self.stages[run.name] = then
            return code

        child = PlayedChild(end, lasts=run.name in self.lasting)
        self.children.append(child)
        return child


@contextmanager
def study(workshop: PlayedWorkshop, *, jobs: int = 1) -> Iterator[tuple[StudyService, io.StringIO]]:
    """The service over all runs of the plan, and what it says."""
    said = io.StringIO()
    runs = runs_of(plan(), base(), steps=100, seeds=[0, 1])
    with PlainStudyDisplay(said, time.monotonic()) as display:
        yield StudyService(runs, workshop, jobs=jobs, display=display), said


def test_all_conditions_have_the_first_seed_before_any_has_the_second_and_noises_come_first() -> None:
    workshop = PlayedWorkshop()
    with study(workshop) as (service, _), Interrupts() as interrupts:
        assert service.run(interrupts) == 0
    assert workshop.trained == ["N-seed0", "A-seed0", "B-seed0", "N-seed1", "A-seed1", "B-seed1"]
    assert sorted(workshop.measured) == sorted(workshop.trained)
    assert sorted(workshop.away) == sorted(workshop.trained)


def test_so_many_train_at_once_and_one_is_measured_at_a_time() -> None:
    workshop = PlayedWorkshop()
    with study(workshop, jobs=3) as (service, _), Interrupts() as interrupts:
        assert service.run(interrupts) == 0
    assert workshop.most_at_once == {"train": 3, "measure": 1}


def test_what_is_done_is_not_done_again_and_what_is_trained_is_only_measured() -> None:
    workshop = PlayedWorkshop(stages={"N-seed0": Stage.DONE, "A-seed0": Stage.TRAINED})
    with study(workshop) as (service, _), Interrupts() as interrupts:
        assert service.run(interrupts) == 0
    assert not {"N-seed0", "A-seed0"} & set(workshop.trained)
    assert "N-seed0" not in workshop.measured
    assert "A-seed0" in workshop.measured


def test_what_fails_is_tried_again_three_times_then_left_and_the_others_go_on() -> None:
    workshop = PlayedWorkshop(codes={"A-seed0": [1] * 9, "B-seed0": [1, -9]})
    with study(workshop) as (service, said), Interrupts() as interrupts:
        assert service.run(interrupts) == 1
    assert Counter(workshop.trained)["A-seed0"] == 4
    assert Counter(workshop.trained)["B-seed0"] == 3
    assert [task.name for task in service.queue.of(Stage.FAILED)] == ["A-seed0"]
    assert len(service.queue.of(Stage.DONE)) == 5
    assert "what A-seed0 said" in said.getvalue()


def test_a_run_that_cannot_be_measured_is_not_measured_again() -> None:
    workshop = PlayedWorkshop(measure_codes={"A-seed0": [2] * 9, "B-seed0": [-9]})
    with study(workshop) as (service, _), Interrupts() as interrupts:
        assert service.run(interrupts) == 1
    assert Counter(workshop.measured)["A-seed0"] == 1
    assert Counter(workshop.measured)["B-seed0"] == 2
    assert Counter(workshop.trained)["A-seed0"] == 1


def test_a_training_that_ends_well_but_left_no_result_has_failed() -> None:
    workshop = PlayedWorkshop()
    with study(workshop) as (service, _), Interrupts() as interrupts:
        workshop.stage = lambda run: Stage.WAITING  # type: ignore[method-assign]
        assert service.run(interrupts) == 1
    assert len(service.queue.of(Stage.FAILED)) == 6


def test_a_run_that_another_process_still_has_is_begun_once_it_is_free(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(study_service, "IN_USE_SECS", 0.01)
    workshop = PlayedWorkshop(others={"N-seed0": 3})
    with study(workshop) as (service, _), Interrupts() as interrupts:
        assert service.run(interrupts) == 0
    assert Counter(workshop.trained)["N-seed0"] == 1


def test_a_signal_ends_all_runs_in_order() -> None:
    workshop = PlayedWorkshop(lasting={"N-seed0", "A-seed0"})
    with study(workshop, jobs=2) as (service, _), Interrupts() as interrupts:
        signal.raise_signal(signal.SIGTERM)
        assert service.run(interrupts) == 128 + signal.SIGTERM
        assert not workshop.children
    with study(workshop, jobs=2) as (service, _), Interrupts() as interrupts:

        def signs(run: Run) -> object:
            return None if interrupts.numbers else signal.raise_signal(signal.SIGINT)

        workshop.signs = signs  # type: ignore[method-assign]
        assert service.run(interrupts) == 128 + signal.SIGINT
    assert [child.told for child in workshop.children] == [[signal.SIGTERM]] * 2


def test_a_run_that_makes_no_step_is_stopped_and_gone_on_with(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(study_service, "STALL_SECS", 0.02)
    monkeypatch.setattr(study_service, "LOOK_SECS", 0.0)
    workshop = PlayedWorkshop(lasting={"N-seed0"})
    original = workshop.train

    def train(run: Run) -> PlayedChild:
        child = original(run)
        workshop.lasting.discard(run.name)
        return child

    workshop.train = train  # type: ignore[method-assign]
    with study(workshop) as (service, said), Interrupts() as interrupts:
        assert service.run(interrupts) == 0
    assert workshop.children[0].told == [signal.SIGTERM]
    assert "made no step" in said.getvalue()
