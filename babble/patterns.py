"""Choosing parts of a body by patterns over their names: joints, actuators, sensors, cameras."""

import difflib
from collections.abc import Iterable, Sequence
from fnmatch import fnmatchcase

import numpy as np
from numpy.typing import NDArray

Indices = NDArray[np.intp]
MAX_NAMED = 5


class PatternError(ValueError):
    """A pattern that matches nothing; the text is one sentence for a person."""


def matching(names: Sequence[str], patterns: Sequence[str], kind: str) -> Indices:
    """The indices of the names that match any of the patterns, in the order of the names.

    A pattern is a name with `*`, `?` and `[...]` as in shells; one that begins with `!` takes out what
    it matches. Names that are empty match nothing. Raises `PatternError` for a pattern that matches
    nothing, with the nearest names, and when nothing is left.
    """
    listed = isinstance(patterns, Sequence) and not isinstance(patterns, str)
    if not listed or not all(isinstance(pattern, str) for pattern in patterns):
        raise PatternError(f"{kind}s are chosen by a list of patterns, got {patterns!r}")
    chosen: set[int] = set()
    for pattern in patterns:
        wanted = pattern.removeprefix("!")
        found = {index for index, name in enumerate(names) if name and fnmatchcase(name, wanted)}
        if not found:
            raise PatternError(f"no {kind} matches {wanted!r}; {nearest(names, wanted, kind)}")
        chosen = chosen - found if pattern.startswith("!") else chosen | found
    if not chosen:
        raise PatternError(f"the patterns {list(patterns)} leave no {kind} of the model's {len(names)}")
    return np.array(sorted(chosen), dtype=np.intp)


def nearest(names: Iterable[str], wanted: str, kind: str) -> str:
    """Half a sentence that names what is like the wanted name, or what there is."""
    known = list(dict.fromkeys(name for name in names if name))
    if not known:
        return f"the model has no {kind} with a name"
    near = difflib.get_close_matches(wanted, known, n=MAX_NAMED, cutoff=0.4)
    return f"the nearest are {', '.join(near)}" if near else f"there are {', '.join(known[:MAX_NAMED])}, ..."
