"""The loop's rules that need no process: when it polls, sleeps, stops and gives up."""

import re

import pytest
from pydantic import TypeAdapter

from protocol.messages import Name
from services.runtime.bus import Wakeup
from services.runtime.clock import HandClock
from services.runtime.process import STOP_SECS, loop, new_life
from services.runtime.settings import SettingsError, parse


class Sleepless(Wakeup):
    """A wakeup whose sleep turns the clock."""

    def __init__(self, clock: HandClock) -> None:
        super().__init__()
        self.slept_secs: list[float] = []
        self._clock = clock

    def wait(self, timeout_secs: float) -> bool:
        self.slept_secs.append(timeout_secs)
        self._clock.advance(timeout_secs)
        return False


class Scripted:
    """Returns the delays given, and stops `after_stop` polls after being told to."""

    def __init__(self, delays: list[float | None], after_stop: int | None = None) -> None:
        self.polled_secs: list[float] = []
        self.stops = 0
        self._delays = delays
        self._after_stop = after_stop
        self._since_stop = 0

    def poll(self, now_secs: float) -> float | None:
        self.polled_secs.append(now_secs)
        if self.stops:
            self._since_stop += 1
            if self._since_stop == self._after_stop:
                return None
        return self._delays.pop(0) if self._delays else 0.1

    def stop(self) -> None:
        self.stops += 1


def test_it_sleeps_as_long_as_asked_but_not_over_a_quarter_of_a_second() -> None:
    clock = HandClock()
    wakeup = Sleepless(clock)
    loop(Scripted([0.0, 0.1, 5.0, None]), clock, wakeup, lambda: False)
    assert wakeup.slept_secs == [0.1, 0.25]


def test_a_stop_is_said_once_and_polling_goes_on_until_the_service_is_done() -> None:
    clock = HandClock()
    service = Scripted([], after_stop=7)
    loop(service, clock, Sleepless(clock), lambda: clock.now_secs() >= 1.0)
    assert service.stops == 1
    assert clock.now_secs() < 1.0 + 0.1 * 8


def test_a_service_that_does_not_stop_is_left_at_the_deadline() -> None:
    clock = HandClock()
    service = Scripted([])
    loop(service, clock, Sleepless(clock), lambda: clock.now_secs() >= 1.0)
    assert service.stops == 1
    assert STOP_SECS < clock.now_secs() < 1.0 + STOP_SECS + 0.5


def test_life_names_are_new_each_time_and_fit_into_keys() -> None:
    lives = {new_life("encoder_learner") for _ in range(50)}
    assert len(lives) == 50
    for life in lives:
        assert re.fullmatch(r"encoder_learner-[0-9a-f]{8}", life)
        TypeAdapter(Name).validate_python(life)


def test_a_settings_error_is_one_for_people_and_still_a_value_error() -> None:
    with pytest.raises(ValueError, match="x: scenario") as failure:
        parse({}, origin="x")
    assert isinstance(failure.value, SettingsError)
