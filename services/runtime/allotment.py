"""Who may send how many more segments: demand shared among the actors that are there (pure).

A learner wants a number of columns (one column = one world's segment). It grants segments one by
one to the actor that should deliver it first, by what each took for its last ones, counts what is
under way, and grants anew what a lost or stuck actor owes. So actors produce what is wanted and
nothing else, whatever their number and speed, and a rollout does not wait for the slowest of them.
"""

from dataclasses import dataclass

NEWEST_SHARE = 0.3
"""Of the newest measurement in an actor's mean time per segment."""
FORGET_SECS = 5.0
"""How slow an actor was that was asked for nothing so long is forgotten, since it may not be so any more."""
SHORTEST_SECS = 1e-3
"""Of a segment; below it actors count as equally fast."""


@dataclass
class _Sender:
    columns: int
    upto: int = 0
    granted: int = 0
    granted_in_term: int = 0
    since_secs: float = 0.0
    """When it last delivered or was granted something after owing nothing."""
    segment_secs: float | None = None
    """Mean time of a segment in this term; None while that is not known."""
    tried_anew: bool = False
    """Its next delivery alone says how fast it is."""

    def note_delivery(self, segments: int, now_secs: float) -> None:
        """It has delivered so many more."""
        newest_secs = max(SHORTEST_SECS, (now_secs - self.since_secs) / segments)
        before_secs = None if self.tried_anew else self.segment_secs
        share = 1.0 if before_secs is None else NEWEST_SHARE
        self.segment_secs = share * newest_secs + (1 - share) * (before_secs or 0.0)
        self.tried_anew = False

    @property
    def owed(self) -> int:
        return max(0, self.granted - self.upto)

    def idle(self, now_secs: float) -> bool:
        """True if it was asked for nothing for a while."""
        return self.owed == 0 and now_secs - self.since_secs > FORGET_SECS


class Allotment:
    """The grants of one block's experience at one learner.

    `granted` and `upto` are absolute sequence numbers of a sender's stream, so that a grant may
    be heard twice or late without harm.
    """

    def __init__(self, *, columns_per_segment: int, window: int, patience_secs: float) -> None:
        """`columns_per_segment` is the guess for senders not heard yet; `window` bounds what one owes."""
        self._guess = columns_per_segment
        self._window = window
        self._patience_secs = patience_secs
        self._senders: dict[str, _Sender] = {}
        self.missing_columns = 0
        """Columns still wanted, those under way not subtracted."""

    def want(self, columns: int) -> None:
        """Set what is still wanted, in columns."""
        self.missing_columns = max(0, columns)

    def new_term(self) -> None:
        """Take back all grants: a new term wants other experience."""
        for sender in self._senders.values():
            sender.granted = sender.upto
            sender.granted_in_term = 0
            sender.segment_secs = None

    def appeared(self, life: str, upto: int, now_secs: float) -> None:
        """A sender is there (again), of whom all segments below `upto` are held."""
        if life not in self._senders:
            self._senders[life] = _Sender(columns=self._guess, upto=upto, granted=upto, since_secs=now_secs)

    def vanished(self, life: str) -> None:
        """A sender is gone; what it owes is granted to others."""
        self._senders.pop(life, None)

    def received(self, life: str, upto: int, columns: int, now_secs: float) -> None:
        """All segments of `life` below `upto` are held; its segments have `columns` columns.

        The last segment of a sender that is gone may come after the news of it: it stays gone.
        """
        if (sender := self._senders.get(life)) is not None:
            if upto > sender.upto and sender.owed:
                sender.note_delivery(upto - sender.upto, now_secs)
            sender.upto = max(sender.upto, upto)
            sender.columns = columns
            sender.since_secs = now_secs

    def grant(self, now_secs: float) -> dict[str, int]:
        """Share out what is wanted and not under way; returns {life: granted} for all present."""
        uncovered = self.missing_columns - sum(
            s.owed * s.columns for s in self._senders.values() if self._trusted(s, now_secs)
        )
        while uncovered > 0 and (life := self._soonest(now_secs)) is not None:
            sender = self._senders[life]
            if sender.owed == 0:
                sender.tried_anew = sender.idle(now_secs)
                sender.since_secs = now_secs
            sender.granted = max(sender.granted, sender.upto) + 1
            sender.granted_in_term += 1
            uncovered -= sender.columns
        return {life: s.granted for life, s in sorted(self._senders.items())}

    def overdue(self, now_secs: float) -> list[str]:
        """Present senders that owe a segment for longer than the patience."""
        return [x for x, s in sorted(self._senders.items()) if not self._trusted(s, now_secs)]

    def _trusted(self, sender: _Sender, now_secs: float) -> bool:
        return sender.owed == 0 or now_secs - sender.since_secs <= self._patience_secs

    def _soonest(self, now_secs: float) -> str | None:
        """Who should deliver one more segment first; who is not known to be slow counts as the fastest."""
        known = [s.segment_secs for s in self._senders.values() if s.segment_secs is not None]
        fastest_secs = min(known, default=SHORTEST_SECS)
        able = []
        for life, sender in self._senders.items():
            if sender.owed >= self._window or not self._trusted(sender, now_secs):
                continue
            known_secs = None if sender.idle(now_secs) else sender.segment_secs
            each_secs = fastest_secs if known_secs is None else known_secs
            able.append(((sender.owed + 1) * each_secs, sender.owed, sender.granted_in_term, life))
        return min(able)[3] if able else None
