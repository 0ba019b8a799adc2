"""The sequence book of a consumer: what it took from each sender, so that nothing counts twice.

Pure: no clock, no wire, no disk. A stream is (life, block); its segments are taken in the order
0, 1, 2, ... and in no other (go-back-N), so one number per stream says all that is held.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import Any

from protocol.messages import MAX_COUNT, MAX_ENTRIES
from protocol.refusal import Reason, Refused


class Verdict(StrEnum):
    """What a sequence number means; all but NEW are also a `Reason`, by the same text."""

    NEW = "new"
    """Exactly the expected one: take it."""
    DUPLICATE = Reason.DUPLICATE
    """Below the expected one: held already."""
    GAP = Reason.OUT_OF_ORDER
    """Above the expected one: not taken, the sender sends it again after the missing ones."""
    NO_ROOM = Reason.NO_ROOM
    """Of a life or block beyond the ledger's bound: not taken until `forget` makes room."""


@dataclass(slots=True)
class _Stream:
    upto: int = 0
    heard: int = 0
    """One more than the highest seq ever heard."""

    @property
    def missing(self) -> int:
        return max(0, self.heard - self.upto)


class Ledger:
    """Judges and remembers the segments of all senders at one consumer.

    Remembers at most `max_lives` lives of at most 256 blocks each. A life is dropped from memory
    only if it was declared gone by `forget` and its room is needed, the longest gone first; were it
    to come back after that, it would be taken for a new one.
    """

    def __init__(self, *, max_lives: int = 1024) -> None:
        if max_lives < 1:
            raise ValueError(f"a ledger must remember at least 1 life, not {max_lives}")
        self._max_lives = max_lives
        self._lives: dict[str, dict[str, _Stream]] = {}
        self._gone: dict[str, None] = {}
        self._lost_before = 0
        self.new = 0
        """Segments taken."""
        self.duplicated = 0
        """Segments heard again after they were taken."""
        self.gaps = 0
        """Segments heard before their turn, and not taken."""
        self.turned_away = 0
        """Segments of lives or blocks for which there was no room."""
        self.forgotten = 0
        """Lives dropped from memory."""

    @property
    def lost(self) -> int:
        """Segments known to exist of lives that are gone, never taken; falls if such a life comes back.

        At most `MAX_COUNT`, whatever numbers a sender made up.
        """
        return min(MAX_COUNT, self._lost_before + sum(self._missing(life) for life in self._gone))

    def upto(self, life: str, block: str) -> int:
        """All segments of the stream below this number were taken; 0 for an unknown stream."""
        stream = self._stream(life, block)
        return 0 if stream is None else stream.upto

    def judge(self, life: str, block: str, seq: int) -> Verdict:
        """What the number means; changes nothing."""
        stream = self._stream(life, block)
        if stream is None and not self._has_room(life):
            return Verdict.NO_ROOM
        expected = 0 if stream is None else stream.upto
        if seq == expected:
            return Verdict.NEW
        return Verdict.DUPLICATE if seq < expected else Verdict.GAP

    def accept(self, life: str, block: str, seq: int) -> None:
        """Take the segment, once it is kept safely.

        Raises ValueError if its verdict is not NEW.
        """
        verdict = self.judge(life, block, seq)
        if verdict is not Verdict.NEW:
            raise ValueError(f"segment {seq} of {life}/{block} is {verdict}, only a new one can be accepted")
        stream = self._open(life, block)
        stream.upto = seq + 1
        stream.heard = max(stream.heard, stream.upto)
        self.new += 1

    def refuse(self, life: str, block: str, seq: int) -> Refused:
        """Count a segment that is not taken, and say why; call it for every verdict but NEW.

        Raises ValueError for a NEW one, which must be accepted.
        """
        verdict = self.judge(life, block, seq)
        expected = self.upto(life, block)
        match verdict:
            case Verdict.NEW:
                raise ValueError(f"segment {seq} of {life}/{block} is new and may not be refused")
            case Verdict.DUPLICATE:
                self.duplicated += 1
            case Verdict.GAP:
                self.gaps += 1
                self._note(life, block, seq)
            case Verdict.NO_ROOM:
                self.turned_away += 1
        return Refused(Reason(verdict), f"segment {seq} of {life}/{block} came where {expected} is expected")

    def forget(self, life: str) -> None:
        """The life is gone: its missing segments count as lost, and its memory may be reused."""
        if life in self._lives:
            self._gone.setdefault(life)

    def remember(self, life: str) -> None:
        """The life is there after all: what it misses is not lost, and its memory is kept."""
        self._gone.pop(life, None)

    def lives(self) -> list[str]:
        """All lives remembered, the gone ones too."""
        return list(self._lives)

    def state(self) -> dict[str, Any]:
        """The whole book as plain JSON-able data, for `restore`."""
        return {
            "streams": [
                [life, block, stream.upto, stream.heard]
                for life, blocks in self._lives.items()
                for block, stream in blocks.items()
            ],
            "gone": list(self._gone),
            "counts": {name: getattr(self, name) for name in _COUNTS} | {"lost": self._lost_before},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become the ledger that `state` was taken from, whatever this one held."""
        self._lives = {}
        for life, block, upto, heard in state["streams"]:
            self._lives.setdefault(life, {})[block] = _Stream(upto, heard)
        self._gone = dict.fromkeys(state["gone"])
        for name in _COUNTS:
            setattr(self, name, state["counts"][name])
        self._lost_before = state["counts"]["lost"]

    def _stream(self, life: str, block: str) -> _Stream | None:
        blocks = self._lives.get(life)
        return None if blocks is None else blocks.get(block)

    def _has_room(self, life: str) -> bool:
        blocks = self._lives.get(life)
        if blocks is not None:
            return len(blocks) < MAX_ENTRIES
        return len(self._lives) < self._max_lives or bool(self._gone)

    def _open(self, life: str, block: str) -> _Stream:
        if life not in self._lives and len(self._lives) >= self._max_lives:
            oldest = next(iter(self._gone))
            self._lost_before += self._missing(oldest)
            del self._gone[oldest], self._lives[oldest]
            self.forgotten += 1
        self._gone.pop(life, None)
        return self._lives.setdefault(life, {}).setdefault(block, _Stream())

    def _note(self, life: str, block: str, seq: int) -> None:
        stream = self._stream(life, block)
        if stream is None and (life in self._lives or len(self._lives) < self._max_lives):
            stream = self._lives.setdefault(life, {}).setdefault(block, _Stream())
        if stream is not None:
            stream.heard = max(stream.heard, seq + 1)

    def _missing(self, life: str) -> int:
        return sum(stream.missing for stream in self._lives[life].values())


_COUNTS = ("new", "duplicated", "gaps", "turned_away", "forgotten")
