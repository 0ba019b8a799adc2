"""An encoder's fits: slow ones are sliced, what they learned from is let go, and they need pairs."""

import numpy as np
import pytest

from protocol.messages import Phase
from services.encoder_learner.work import EncoderWork
from services.runtime.clock import Clock, HandClock
from services.runtime.errors import UserError
from tests.unit.test_learner_works import (
    announce,
    babbled,
    finish,
    new_encoder_work,
    segment,
    settings_of,
    walk,
)


class Slow:
    """A clock by which each look at it takes so long."""

    def __init__(self, look_secs: float) -> None:
        self._look_secs, self._now_secs = look_secs, 0.0

    def now_secs(self) -> float:
        self._now_secs += self._look_secs
        return self._now_secs


def fitted(clock: Clock) -> tuple[EncoderWork, list[int]]:
    """A work that has ended its first fit, and how many updates were done after each slice."""
    work, done = babbled(settings_of(), clock), []
    work.begin(announce(Phase.ENCODE, 2))
    while work.advance():
        progress = work.progress()
        assert progress is not None
        done.append(progress.done)
    return work, done


def test_slow_updates_come_a_few_at_a_time_and_change_nothing_but_that() -> None:
    (quick, in_large), (slow, in_small) = fitted(HandClock()), fitted(Slow(0.04))
    assert in_large == [25, 50]
    assert in_small == list(range(3, 60, 3)), "the third update ends 0.12 s after the first began"
    assert quick.model() == slow.model()
    assert quick.totals() == slow.totals() == {"body/encoder_updates": 60}
    assert quick.metrics() == slow.metrics()


def test_after_a_fit_checkpoints_are_as_small_however_much_was_collected() -> None:
    held, left = [], []
    for count in (2, 100):
        work, rng = new_encoder_work(settings_of()), np.random.default_rng(0)
        work.begin(announce(Phase.BABBLE, 1))
        for seq in range(count):
            assert work.take(segment(Phase.BABBLE, seq, rng).model_copy(update={"first_step": 8 * seq}))
        work.begin(announce(Phase.ENCODE, 2))
        held.append(len(work.state()))
        finish(work)
        left.append(len(work.state()))
    assert held[1] >= held[0] + 98 * 32 * 16
    assert left[1] == pytest.approx(left[0], rel=0.01)


def test_what_an_encoder_was_fitted_on_is_let_go_and_the_next_fit_has_its_own() -> None:
    work = babbled(settings_of())
    work.begin(announce(Phase.ENCODE, 2))
    finish(work)
    restarted = new_encoder_work(settings_of())
    restarted.restore(work.state())
    for each in (work, restarted):
        walk(each)
        each.begin(announce(Phase.REFINE, 6))
        finish(each)
    offer = work.model()
    assert offer is not None
    assert offer == restarted.model()
    assert offer.version == 2


def test_episodes_of_one_step_are_nothing_to_learn_from_and_that_is_said() -> None:
    work = new_encoder_work(settings_of())
    work.begin(announce(Phase.BABBLE, 1))
    taken = segment(Phase.BABBLE, 0, np.random.default_rng(0), policy="random")
    taken.arrays["episode"][:] = np.arange(8)[:, None]
    assert work.take(taken)
    with pytest.raises(
        UserError, match=r"block body .* no episode .* has two; give .* longer episodes"
    ) as said:
        work.begin(announce(Phase.ENCODE, 2))
    assert "\n" not in str(said.value)
