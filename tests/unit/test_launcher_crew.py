"""The actors of a further host: started again when they die, ended when that is of no use."""

from functools import partial
from signal import Signals

import pytest

from services.launcher.crew import Crew
from services.launcher.supervisor import Patience

PATIENCE = Patience(most_deaths=3, within_secs=60.0, first_delay_secs=1.0, longest_delay_secs=2.0)
SENTENCE = "no run 'x' is announced at tls/far:7447"


class Played:
    """An actor whose end the test decides."""

    def __init__(self, name: str, started: list["Played"]) -> None:
        self.name, self.last_words = name, ""
        self.code: int | None = None
        self.signals: list[Signals] = []
        started.append(self)

    def poll(self) -> int | None:
        return self.code

    def send(self, number: Signals) -> None:
        self.signals.append(number)

    def end(self, code: int, words: str = "") -> None:
        self.code, self.last_words = code, words


@pytest.fixture
def started() -> list[Played]:
    """All that were started, in order."""
    return []


@pytest.fixture
def crew(started: list[Played]) -> Crew:
    """Two actors, just started."""
    crew = Crew([partial(Played, f"actor {number}", started) for number in (1, 2)], PATIENCE)
    assert crew.poll(0.0) == []
    assert len(started) == 2
    return crew


def test_an_actor_that_dies_is_started_again_after_a_growing_delay(crew: Crew, started: list[Played]) -> None:
    started[0].end(-9)
    assert crew.poll(10.0) == ["actor 1 was killed by SIGKILL; it is started again in 1 s"]
    crew.poll(10.9)
    assert len(started) == 2
    crew.poll(11.0)
    assert len(started) == 3
    started[2].end(1)
    assert crew.poll(12.0) == ["actor 1 failed with code 1; it is started again in 2 s"]


def test_one_that_dies_too_often_is_left_out_and_the_last_one_ends_the_crew(
    crew: Crew, started: list[Played]
) -> None:
    def dies_as_often_as_it_may(name: str, secs: float) -> list[str]:
        news: list[str] = []
        for death in range(PATIENCE.most_deaths):
            next(actor for actor in reversed(started) if actor.name == name).end(1)
            news += crew.poll(secs + 10 * death)
            crew.poll(secs + 10 * death + 5)
        return news

    assert dies_as_often_as_it_may("actor 1", 1.0)[-1] == (
        "actor 1 failed with code 1, 3 times within 60 s; the others go on without it"
    )
    assert not crew.over()
    assert crew.fatal is None
    dies_as_often_as_it_may("actor 2", 101.0)
    assert crew.over()
    assert crew.fatal == "actor 2 failed with code 1, 3 times within 60 s; what it said is above"
    assert crew.fatal_code == 1


def test_deaths_far_apart_are_forgiven(crew: Crew, started: list[Played]) -> None:
    for minute in range(1, 8):
        started[-1].end(1)
        assert "started again in 1 s" in crew.poll(100.0 * minute)[0]
        crew.poll(100.0 * minute + 1.0)


def test_what_a_person_must_mend_ends_all_with_the_first_ones_sentence(
    crew: Crew, started: list[Played]
) -> None:
    started[1].end(2, SENTENCE)
    started[0].end(2, SENTENCE)
    assert crew.poll(1.0) == []
    assert (crew.fatal, crew.fatal_code) == (SENTENCE, 2)


def test_the_end_of_the_run_is_the_end_of_all(crew: Crew, started: list[Played]) -> None:
    started[0].end(0)
    assert crew.poll(1.0) == []
    assert not crew.over()
    started[1].end(0)
    crew.poll(1.1)
    assert crew.over()
    assert crew.fatal is None


def test_one_that_comes_back_after_the_end_of_the_run_finds_nobody_and_that_is_no_fault(
    crew: Crew, started: list[Played]
) -> None:
    started[0].end(1)
    crew.poll(1.0)
    started[1].end(0)
    crew.poll(2.0)
    assert not crew.over()
    started[2].end(2, SENTENCE)
    crew.poll(22.0)
    assert crew.over()
    assert crew.fatal is None


def test_one_that_cannot_come_back_while_another_holds_out_tries_again(
    crew: Crew, started: list[Played]
) -> None:
    started[0].end(-9)
    crew.poll(10.0)
    crew.poll(11.0)
    started[2].end(2, "no router answered")
    assert crew.poll(31.0) == ["actor 1 could not come back (no router answered); it is started again in 2 s"]
    assert crew.fatal is None
    crew.poll(33.0)
    started[1].end(1)
    crew.poll(34.0)
    started[3].end(2, "no router answered")
    crew.poll(34.5)
    assert (crew.fatal, crew.fatal_code) == ("no router answered", 2), "nobody is left who is at work"


def test_a_stop_reaches_those_that_run_and_nobody_is_started_any_more(
    crew: Crew, started: list[Played]
) -> None:
    started[0].end(1)
    crew.poll(1.0)
    crew.stop(Signals.SIGTERM)
    assert started[1].signals == [Signals.SIGTERM]
    started[1].end(-15)
    assert crew.poll(50.0) == []
    assert crew.over()
    assert crew.fatal is None
    assert len(started) == 2
