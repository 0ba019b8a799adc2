"""How much actors may send: exactly what an open loop wants, and without bound where others decide."""

from protocol.messages import MAX_COUNT
from services.runtime.allotment import Allotment


class Unbounded(Allotment):
    """Grants every actor that is there all that it may ever send."""

    def __init__(self) -> None:
        super().__init__(columns_per_segment=1, window=1, patience_secs=float("inf"))
        self._present: set[str] = set()

    def appeared(self, life: str, upto: int, now_secs: float) -> None:
        """A sender is there."""
        self._present.add(life)

    def vanished(self, life: str) -> None:
        """A sender is gone."""
        self._present.discard(life)

    def grant(self, now_secs: float) -> dict[str, int]:
        """{life: `MAX_COUNT`} for all present: only the sender's window bounds what is under way."""
        return dict.fromkeys(sorted(self._present), MAX_COUNT)
