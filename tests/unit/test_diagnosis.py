"""Telling a router that turns a process away from one that starts again; see test_closed_door.py too."""

import pytest

from services.runtime import diagnosis
from services.runtime.diagnosis import ShortVisits, let_in


@pytest.fixture(autouse=True)
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """A router that does nothing for 0.3 s does nothing."""
    monkeypatch.setattr(diagnosis, "QUIET_SECS", 0.3)


def test_who_is_answered_at_the_door_is_in() -> None:
    assert let_in(lambda: True, lambda: 0)


def test_a_router_without_a_door_that_lets_the_connection_be_lets_in() -> None:
    assert let_in(lambda: False, lambda: 7)


def test_connections_that_are_cut_again_and_again_mean_turned_away() -> None:
    cuts = iter(range(100))
    assert not let_in(lambda: False, lambda: next(cuts))


def test_a_router_that_is_started_again_meanwhile_turns_nobody_away() -> None:
    asked: list[bool] = []

    def ask() -> bool:
        asked.append(True)
        return len(asked) == 4

    assert let_in(ask, lambda: min(2, len(asked)))
    assert len(asked) == 4


def visits(*stays_secs: float) -> list[bool]:
    """Whether each end of a visit was told, one visit right after the other."""
    noted, now_secs, told = ShortVisits(), 0.0, []
    for stay_secs in stays_secs:
        assert not noted.note(True, now_secs)
        now_secs += stay_secs
        told.append(noted.note(False, now_secs))
    return told


def test_three_short_visits_in_a_row_are_told_once_a_minute() -> None:
    assert visits(1, 1, 1, 1, 1) == [False, False, True, False, False]
    assert visits(*[1.0] * 70).count(True) == 2


def test_a_long_visit_between_short_ones_is_a_router_that_stumbles() -> None:
    assert not any(visits(1, 1, 100, 1, 1, 100, 1, 1))
