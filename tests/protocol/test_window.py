"""The sender's window by itself; test_link.py has it together with the ledger."""

import pytest

from protocol.window import SendWindow


def filled(frames: int, *, size: int = 4, resend_secs: float = 1.0) -> SendWindow:
    """A window that sent frames 0, 1... at 0 s, 0.1 s..."""
    window = SendWindow(size, resend_secs)
    for seq in range(frames):
        window.sent(seq, b"%d" % seq, seq / 10)
    return window


def test_the_grant_is_an_absolute_limit():
    window = filled(2)
    assert [window.may_send(granted) for granted in (0, 1, 2, 3)] == [False, False, False, True]


def test_a_full_window_waits_for_an_acknowledgement():
    window = filled(4)
    assert not window.may_send(100)
    with pytest.raises(ValueError, match="full with 4 frames"):
        window.sent(4, b"4", 0.0)
    assert window.acked(1) == 1
    assert window.may_send(100)
    window.sent(4, b"4", 0.0)
    assert not window.may_send(100)
    assert (window.sent_total, window.acked_total, window.unacknowledged) == (5, 1, 4)


def test_numbers_have_no_gaps():
    with pytest.raises(ValueError, match="next segment to send is 2, not 3"):
        filled(2).sent(3, b"", 0.0)


def test_all_unacknowledged_frames_are_sent_again_in_order_once_the_oldest_is_too_old():
    window = filled(3)
    assert window.due(0.99) == []
    assert window.due(1.0) == [(0, b"0"), (1, b"1"), (2, b"2")]
    assert window.due(1.99) == []
    window.acked(1)
    assert window.due(2.0) == [(1, b"1"), (2, b"2")]
    assert window.resent == 5
    assert window.sent_total == 3


def test_the_age_is_that_of_the_oldest_frame_still_held():
    window = filled(3)
    window.acked(2)
    assert window.due(1.1) == []
    assert window.secs_until_due(1.1) == pytest.approx(0.1)
    assert window.due(1.2) == [(2, b"2")]
    window.acked(3)
    assert window.secs_until_due(9.0) is None
    assert window.due(9.0) == []


@pytest.mark.parametrize("upto", [0, 1, 4, 5, 2**53])
def test_acknowledgements_that_go_back_or_too_far_are_counted_and_ignored(upto):
    window = filled(3)
    window.acked(2)
    assert window.acked(upto) == 0
    assert (window.acked_total, window.unacknowledged, window.ignored_acks) == (2, 1, 1)


def test_hearing_an_acknowledgement_again_is_nothing_special():
    window = filled(3)
    assert (window.acked(3), window.acked(3), window.ignored_acks) == (3, 0, 0)


def test_bytes_are_bounded():
    window = SendWindow(100, 1.0, max_bytes=10)
    window.sent(0, b"123456789", 0.0)
    assert window.may_send(100)
    window.sent(1, b"12", 0.0)
    assert not window.may_send(100)
    assert window.held_bytes == 11
    window.acked(1)
    assert window.held_bytes == 2
    assert window.may_send(100)


@pytest.mark.parametrize("arguments", [(0, 1.0), (1, 0.0), (1, float("nan"))])
def test_a_window_that_could_never_work_is_refused(arguments):
    with pytest.raises(ValueError, match="a window must have"):
        SendWindow(*arguments)
