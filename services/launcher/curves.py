"""What the learners measured, over the time in which they learned: read from `metrics.jsonl`."""

from array import array
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from protocol.messages import Phase
from services.launcher.records import Record, count, moment, number
from services.launcher.timeline import Span, Timeline

MOST_POINTS = 4000
"""A series that grows longer keeps every other of its points, again and again."""
ENCODER_PHASES = (Phase.ENCODE, Phase.REFINE)
POLICY_PHASES = (Phase.GROUND, Phase.PRACTISE)


@dataclass(frozen=True)
class Measure:
    """Something that a learner says of a block."""

    name: str
    """in `metrics.jsonl`, after the block"""
    title: str
    label: str

    @property
    def phases(self) -> tuple[Phase, ...]:
        """Where it is measured anew; elsewhere the last value is repeated."""
        return ENCODER_PHASES if self.name.startswith("encoder/") else POLICY_PHASES


MEASURES = (
    Measure("encoder/loss", "encoder: InfoNCE", "loss (nats)"),
    Measure("encoder/accuracy", "encoder: accuracy", "share of pairs"),
    Measure("encoder/alignment", "encoder: alignment", "distance of pairs"),
    Measure("encoder/uniformity", "encoder: uniformity", "log mean kernel"),
    Measure("policy/reward_mean", "policy: reward", "mean per step"),
    Measure("policy/policy_loss", "policy: clipped loss", "loss"),
    Measure("policy/value_loss", "policy: value loss", "loss"),
    Measure("policy/explained_variance", "policy: value fit", "explained variance"),
    Measure("policy/approx_kl", "policy: KL to the old", "nats"),
    Measure("policy/clip_fraction", "policy: clipped", "share of samples"),
    Measure("policy/entropy", "policy: entropy", "nats"),
    Measure("policy/external_reward_mean", "the task's own reward", "mean per step"),
)

FRESH = {
    phase.value: frozenset(measure.name for measure in MEASURES if phase in measure.phases)
    for phase in (*ENCODER_PHASES, *POLICY_PHASES)
}
"""Phase -> the measures that are new in it."""


@dataclass
class Series:
    """One measure of one block: seconds since 1970, its value, and the term it is of."""

    secs: "array[float]" = field(default_factory=lambda: array("d"))
    value: "array[float]" = field(default_factory=lambda: array("d"))
    term: "array[int]" = field(default_factory=lambda: array("q"))
    _stride: int = 1
    _heard: int = 0
    _last: tuple[int, float] | None = None

    def add(self, secs: float, value: float, term: int) -> None:
        """Take a point. What a new term begins with is left out if it is the old term's last word."""
        stale = self._last is not None and self._last[1] == value and self._last[0] != term
        if stale or not isfinite(value):
            return
        self._last = (term, value)
        self._heard += 1
        if self._heard % self._stride:
            return
        self.secs.append(secs)
        self.value.append(value)
        self.term.append(term)
        if len(self.secs) > MOST_POINTS:
            self._stride *= 2
            self.secs, self.value, self.term = self.secs[1::2], self.value[1::2], self.term[1::2]


@dataclass
class Curves:
    """Block -> measure -> its series."""

    blocks: dict[str, dict[str, Series]] = field(default_factory=dict)
    alive_secs: "array[float]" = field(default_factory=lambda: array("d"))
    """when a learner said something, ascending"""

    def of(self, block: str) -> dict[Measure, Series]:
        """The measures of a block that were recorded, in their order."""
        found = self.blocks.get(block, {})
        return {measure: found[measure.name] for measure in MEASURES if measure.name in found}


@dataclass(frozen=True)
class Clock:
    """Counts only the time in some phases, one stay after the other."""

    spans: Sequence[Span]
    timeline: Timeline

    @property
    def borders(self) -> list[float]:
        """Where each of the spans begins on this clock, and the end of the last."""
        return [0.0, *np.cumsum([span.secs for span in self.spans]).tolist()]

    def of(self, secs: Sequence[float]) -> NDArray[np.float64]:
        """Seconds since 1970 -> seconds in these phases until then."""
        running = np.array([self.timeline.running(each) for each in secs])
        knots = np.array([border for span in self.spans for border in (span.begin_secs, span.end_secs)])
        told = np.repeat(self.borders, 2)[1:-1]
        return np.interp(running, knots, told) if len(knots) else running


def read_curves(metrics: Iterable[Record]) -> Curves:
    """The series in the records of `metrics.jsonl`; memory is bounded however long that is."""
    curves = Curves()
    for line in metrics:
        secs, term, measured = moment(line, "now_secs"), count(line, "term"), line.get("metrics")
        if secs is None or term is None:
            continue
        if not curves.alive_secs or secs > curves.alive_secs[-1]:
            curves.alive_secs.append(secs)
        wanted = FRESH.get(str(line.get("phase")), frozenset())
        if not wanted or not isinstance(measured, Mapping):
            continue
        for name in measured:
            block, _, measure = name.partition("/")
            if measure in wanted and (value := number(measured, name)) is not None:
                series = curves.blocks.setdefault(block, {}).setdefault(measure, Series())
                series.add(secs, value, term)
    return curves


def clock(timeline: Timeline, phases: Sequence[Phase], level: int | None = None) -> Clock:
    """The time in these phases, of one level or of all."""
    announced = [(span, span.announced) for span in timeline.spans]
    of_level = [span for span, term in announced if term.phase in phases and level in (None, term.level)]
    return Clock(of_level, timeline)
