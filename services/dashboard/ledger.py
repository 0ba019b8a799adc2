"""What the processes of a run have counted in all, those that are gone among them."""

import contextlib
import json
import logging
from pathlib import Path

from protocol.messages import Status

log = logging.getLogger(__name__)

NAMES = ("env_steps", "lost", "duplicated", "refused")
MOST_LIVES = 1024
"""Of so many lives the counts are held apart; what older ones counted stays in the sums."""
MOST_BYTES = 1 << 20
"""A larger file is none of ours."""

Counts = tuple[int, ...]
"""by `NAMES`"""
NONE: Counts = (0,) * len(NAMES)


class Ledger:
    """Sums over lives; each counts once, however often it goes and comes back."""

    def __init__(self) -> None:
        self._of_life: dict[str, Counts] = {}
        self._sums = NONE

    def __getitem__(self, name: str) -> int:
        """The sum of one of `NAMES` over all lives that were heard of."""
        return self._sums[NAMES.index(name)]

    def hear(self, status: Status) -> None:
        """Take the totals of one life."""
        refused = sum(status.refused.values())
        self._add(status.life, (status.totals.get("env_steps", 0), status.lost, status.duplicated, refused))

    def write(self, path: Path) -> None:
        """Leave it for the next dashboard of the run; a disk that refuses is no trouble here."""
        held = [sum(counts) for counts in zip(NONE, *self._of_life.values(), strict=True)]
        older = [total - part for total, part in zip(self._sums, held, strict=True)]
        text = json.dumps({"names": NAMES, "lives": self._of_life, "older": older})
        draft = path.with_suffix(".draft")
        with contextlib.suppress(OSError):
            draft.write_text(text, encoding="utf-8")
            draft.replace(path)

    def read(self, path: Path) -> None:
        """Go on from what an earlier dashboard left; from nothing if that cannot be read."""
        try:
            if path.stat().st_size > MOST_BYTES:
                raise ValueError("it is too large")
            table = json.loads(path.read_text(encoding="utf-8"))
            if table["names"] != list(NAMES):
                raise ValueError("it has other counts")
            lives = {str(life): _counts(counts) for life, counts in table["lives"].items()}
            older = _counts(table["older"])
        except FileNotFoundError:
            return
        except (OSError, ValueError, TypeError, KeyError, AttributeError) as error:
            log.warning("counts begin at 0, for %s cannot be read: %s", path, error)
            return
        self._sums = tuple(map(sum, zip(self._sums, older, strict=True)))
        for life, counts in lives.items():
            self._add(life, counts)

    def _add(self, life: str, counts: Counts) -> None:
        before = self._of_life.pop(life, NONE)
        now = tuple(map(max, before, counts))
        self._of_life[life] = now
        self._sums = tuple(map(sum, zip(self._sums, now, (-count for count in before), strict=True)))
        if len(self._of_life) > MOST_LIVES:
            del self._of_life[next(iter(self._of_life))]


def _counts(found: list[int]) -> Counts:
    counts = tuple(found)
    if len(counts) != len(NAMES) or not all(isinstance(count, int) and count >= 0 for count in counts):
        raise ValueError(f"{found!r} are no counts")
    return counts
