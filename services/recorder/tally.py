"""What was taken: rows, what is missing between them, and how much of a term is held (pure)."""

from collections import Counter
from collections.abc import Collection, Mapping
from typing import Any

from protocol.messages import MAX_COUNT, Segment


class Tally:
    """Counts of one run's recording; restored from a checkpoint and the segments since, it is the same."""

    def __init__(self, every_steps: int) -> None:
        self._every_steps = every_steps
        self._next_step: dict[str, int] = {}
        """By life: the environment step per column that should come next."""
        self._steps: Counter[int] = Counter()
        """By term: environment steps of all columns together."""
        self.rows = 0
        self.gaps = 0
        """Rows that were never sent, by the steps of their neighbours; at most `MAX_COUNT`."""
        self.unusable = 0
        """Segments that could not be recorded."""

    def take(self, segment: Segment) -> None:
        """Count a segment. Raises ValueError for one that goes back to steps that are recorded already."""
        expected = self._next_step.get(segment.life, 0)
        if segment.first_step < expected:
            raise ValueError(f"it begins at step {segment.first_step}, and {expected} is the next one")
        missing = (segment.first_step - expected) // self._every_steps
        self._next_step[segment.life] = segment.first_step + segment.steps * self._every_steps
        self.gaps = min(MAX_COUNT, self.gaps + missing * segment.columns)
        self.rows += segment.steps * segment.columns
        self._steps[segment.term] += segment.steps * segment.columns * self._every_steps

    def steps(self, term: int) -> int:
        """Environment steps of a term, of all columns of all actors."""
        return self._steps[term]

    def forget_before(self, term: int) -> None:
        """Nobody asks for older terms any more."""
        self._steps = Counter({of: steps for of, steps in self._steps.items() if of >= term})

    def state(self, lives: Collection[str]) -> dict[str, Any]:
        """All as plain JSON-able data, for `restore`; of lives only these."""
        return {
            "next_step": {life: step for life, step in self._next_step.items() if life in lives},
            "steps": sorted(self._steps.items()),
            "counts": {name: getattr(self, name) for name in _COUNTS},
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """Become the tally that `state` was taken from."""
        self._next_step = {str(life): int(step) for life, step in state["next_step"].items()}
        self._steps = Counter({int(term): int(steps) for term, steps in state["steps"]})
        for name in _COUNTS:
            setattr(self, name, int(state["counts"][name]))


_COUNTS = ("rows", "gaps", "unusable")
