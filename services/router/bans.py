"""Who is kept out, and for how long (pure: time is given)."""

from dataclasses import dataclass

FIRST_SECS = 60.0
LONGEST_SECS = 3600.0
FORGET_SECS = 3600.0
"""So long after a ban the next one is a first one again."""


@dataclass(frozen=True)
class _Ban:
    until_secs: float
    secs: float


class Bans:
    """Each ban of one identity is twice as long as the one before."""

    def __init__(self) -> None:
        self._bans: dict[str, _Ban] = {}

    def ban(self, identity: str, now_secs: float) -> float:
        """Keep it out from now on; returns for how many seconds."""
        last = self._bans.get(identity)
        recent = last is not None and now_secs - last.until_secs < FORGET_SECS
        secs = min(2 * last.secs, LONGEST_SECS) if last is not None and recent else FIRST_SECS
        self._bans[identity] = _Ban(now_secs + secs, secs)
        return secs

    def pardon(self, identity: str) -> None:
        """Forget what it did."""
        self._bans.pop(identity, None)

    def left_secs(self, identity: str, now_secs: float) -> float:
        """For how long it is still kept out; 0 if it is not."""
        last = self._bans.get(identity)
        return 0.0 if last is None else max(0.0, last.until_secs - now_secs)

    def banned(self, now_secs: float) -> frozenset[str]:
        """All who are kept out now."""
        return frozenset(identity for identity in self._bans if self.left_secs(identity, now_secs) > 0)
