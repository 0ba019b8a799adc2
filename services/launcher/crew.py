"""Keeps the actors of one host going (pure: time and processes are given).

An actor that dies is started again after a growing delay. One that ends with 0 has heard the end of the
run. What a person must mend (exit code 2) is the same for all of them, so the first one's word ends the
crew. Two cases are none of a person's: after the end of the run nobody is there to return to; and while
earlier ones still run, the network may be away, so whoever cannot come back tries again.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from signal import Signals
from typing import Protocol

from services.launcher.supervisor import USER_ERROR, Patience, how_it_ended


class Hand(Protocol):
    """A started actor."""

    name: str
    last_words: str
    """The sentence with which it ended; "" if it ended without one."""

    def poll(self) -> int | None:
        """Its exit code, negative for a signal; None while it runs."""
        ...

    def send(self, number: Signals) -> None:
        """Send it a signal; nothing happens if it has ended."""
        ...


@dataclass
class _Place:
    start: Callable[[], Hand]
    hand: Hand | None = None
    due_secs: float | None = float("-inf")
    """when it is to be started; None if it is running or over"""
    began_secs: float = float("-inf")
    """when it was started last"""
    deaths_secs: list[float] = field(default_factory=list)


class Crew:
    """Starts the actors at the first `poll`, and looks after them at each further one."""

    def __init__(self, starts: Sequence[Callable[[], Hand]], patience: Patience | None = None) -> None:
        """`starts` start one actor each."""
        self.fatal: str | None = None
        """Why there is no going on, in one sentence; None while there is."""
        self.fatal_code = 1
        self.parted = False
        """True once one has ended in order."""
        self._places = [_Place(start) for start in starts]
        self._patience = patience or Patience()
        self._stopping = False

    def poll(self, now_secs: float) -> list[str]:
        """Start what is due and note what ended; returns what happened, one sentence each."""
        news: list[str] = []
        for place in self._places:
            if place.hand is not None and (code := place.hand.poll()) is not None:
                hand, place.hand = place.hand, None
                news += self._ended(place, hand, code, now_secs)
            elif place.due_secs is not None and place.due_secs <= now_secs:
                place.hand, place.due_secs, place.began_secs = place.start(), None, now_secs
        return news

    def over(self) -> bool:
        """True once no actor runs, and none is to be started."""
        return all(place.hand is None and place.due_secs is None for place in self._places)

    def stop(self, number: Signals) -> None:
        """Send a signal to all; nothing is started any more."""
        self._stopping = True
        for place in self._places:
            place.due_secs = None
            if place.hand is not None:
                place.hand.send(number)

    def _ended(self, place: _Place, hand: Hand, code: int, now_secs: float) -> list[str]:
        if code == 0 or self._stopping:
            self.parted = self.parted or code == 0
            return []
        if code == USER_ERROR and (self.parted or not self._has_elder(place)):
            if not self.parted:
                self._give_up(hand.last_words or f"{hand.name} {how_it_ended(code)}", USER_ERROR)
            return []
        how = how_it_ended(code) if code != USER_ERROR else f"could not come back ({hand.last_words or code})"
        delay_secs = self._patience.note_death(place.deaths_secs, now_secs)
        if delay_secs is not None:
            place.due_secs = now_secs + delay_secs
            return [f"{hand.name} {how}; it is started again in {delay_secs:g} s"]
        often = f"{len(place.deaths_secs)} times within {self._patience.within_secs:.0f} s"
        sentence = f"{hand.name} {how}, {often}"
        if self.over():
            self._give_up(f"{sentence}; what it said is above", 1)
            return []
        return [f"{sentence}; the others go on without it"]

    def _has_elder(self, place: _Place) -> bool:
        """True while an actor runs that was started before this place's last one."""
        return any(each.hand is not None and each.began_secs < place.began_secs for each in self._places)

    def _give_up(self, sentence: str, code: int) -> None:
        if self.fatal is None:
            self.fatal, self.fatal_code = sentence, code
