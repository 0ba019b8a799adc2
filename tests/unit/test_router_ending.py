"""When a router ends by itself: after its run, and not while one of its clients is only starting again."""

from services.router.ending import FAREWELL_SECS, LEFT_SECS, NOBODY_SECS, Ending


def ends_after_secs(ending: Ending, since_secs: float, *, done: bool, connections: int) -> float | None:
    """After how many seconds of this it ends; None if it does not within 20 minutes."""
    for after_secs in range(1200):
        if ending.may_end(since_secs + after_secs, done=done, connections=connections):
            return float(after_secs)
    return None


def test_a_run_that_is_done_is_left_at_once_by_the_last_and_soon_by_those_who_stay() -> None:
    assert ends_after_secs(Ending(), 5.0, done=True, connections=0) == 0
    assert ends_after_secs(Ending(), 5.0, done=True, connections=2) == FAREWELL_SECS


def test_somebody_who_is_connected_and_not_done_is_waited_for() -> None:
    assert ends_after_secs(Ending(), 0.0, done=False, connections=1) is None


def test_a_router_that_never_hears_of_the_end_does_not_stay_for_ever() -> None:
    """It was started again after all had left."""
    assert ends_after_secs(Ending(), 0.0, done=False, connections=0) == NOBODY_SECS


def test_who_crashed_may_take_a_minute_to_come_back() -> None:
    ending = Ending()
    for crash in range(5):
        now_secs = crash * 1000.0
        assert not ending.may_end(now_secs, done=False, connections=4)
        for after_secs in range(1, 61):
            assert not ending.may_end(now_secs + after_secs, done=False, connections=0)
    assert not ending.may_end(6000.0, done=False, connections=2)
    assert ends_after_secs(ending, 6001.0, done=False, connections=0) == LEFT_SECS


def test_a_run_that_begins_again_after_another_is_not_cut_short() -> None:
    ending = Ending()
    assert not ending.may_end(0.0, done=True, connections=2)
    assert not ending.may_end(20.0, done=False, connections=2)
    assert ends_after_secs(ending, 40.0, done=True, connections=2) == FAREWELL_SECS
