"""What numbers over conditions can be asked; each answer is whether it is so, and in which words (pure)."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from services.launcher.study_table import Estimate

Of = Mapping[str, Estimate]
"""One metric by condition."""


@dataclass(frozen=True)
class Finding:
    """What one estimator says."""

    holds: bool
    words: str
    clear: bool = True
    """the seeds do not overlap"""


Ask = Callable[[Of], Finding]


def _number(value: float) -> str:
    return f"{value:,.0f}" if abs(value) >= 1000 else f"{value:.1f}" if abs(value) >= 100 else f"{value:.2f}"


def _ranges(of: Of, ids: Sequence[str]) -> str:
    return ", ".join(f"{each} {_number(of[each].mean)}" for each in ids)


def above(one: str, other: str) -> Ask:
    """Its mean is above the other's."""

    def ask(of: Of) -> Finding:
        ours, theirs = of[one], of[other]
        clear = ours.least > theirs.most or theirs.least > ours.most
        words = f"{_ranges(of, (one, other))}: {ours.mean / theirs.mean - 1:+.0%}"
        return Finding(ours.mean > theirs.mean, words, clear)

    return ask


def below(one: str, other: str) -> Ask:
    """Its mean is below the other's."""

    def ask(of: Of) -> Finding:
        ours, theirs = of[one], of[other]
        clear = ours.least > theirs.most or theirs.least > ours.most
        words = f"{_ranges(of, (one, other))}: {ours.mean - theirs.mean:+.2f}"
        return Finding(ours.mean < theirs.mean, words, clear)

    return ask


def every_run_above(ones: Sequence[str], other: str) -> Ask:
    """The least run of some is above the most of another."""

    def ask(of: Of) -> Finding:
        least, most = min(of[each].least for each in ones), of[other].most
        words = f"least of {', '.join(ones)} {_number(least)}, most of {other} {_number(most)}"
        return Finding(least > most, words)

    return ask


def highest(one: str, among: Sequence[str]) -> Ask:
    """Its mean is the highest."""

    def ask(of: Of) -> Finding:
        others = [each for each in among if each != one]
        top = max(others, key=lambda each: of[each].mean)
        clear = of[one].least > of[top].most or of[top].least > of[one].most
        return Finding(
            of[one].mean > of[top].mean, f"{_ranges(of, (one,))}; of the others {_ranges(of, (top,))}", clear
        )

    return ask


def lowest(one: str, among: Sequence[str]) -> Ask:
    """Its mean is the lowest."""

    def ask(of: Of) -> Finding:
        others = [each for each in among if each != one]
        bottom = min(others, key=lambda each: of[each].mean)
        clear = of[one].most < of[bottom].least or of[bottom].most < of[one].least
        words = f"{_ranges(of, (one,))}; of the others {_ranges(of, (bottom,))}"
        return Finding(of[one].mean < of[bottom].mean, words, clear)

    return ask


def both(one: Ask, other: Ask) -> Ask:
    """Two things at once."""

    def ask(of: Of) -> Finding:
        first, second = one(of), other(of)
        words = f"{first.words}; {second.words}"
        return Finding(first.holds and second.holds, words, first.clear and second.clear)

    return ask


def more_by(one: str, other: str, least: float, most: float) -> Ask:
    """Its mean is so much above the other's."""

    def ask(of: Of) -> Finding:
        ours, theirs = of[one], of[other]
        by = ours.mean - theirs.mean
        clear = ours.least > theirs.most or theirs.least > ours.most
        return Finding(least <= by <= most, f"{_ranges(of, (one, other))}: {by:+.2f}", clear)

    return ask


def falling(ids: Sequence[str]) -> Ask:
    """Each mean is above the next."""

    def ask(of: Of) -> Finding:
        holds = all(of[one].mean > of[other].mean for one, other in itertools.pairwise(ids))
        ordered = sorted(ids, key=lambda each: -of[each].mean)
        clear = all(of[one].least > of[other].most for one, other in itertools.pairwise(ordered))
        return Finding(holds, " > ".join(f"{each} {_number(of[each].mean)}" for each in ordered), clear)

    return ask


def within(ids: Sequence[str], of_what: str, share: float) -> Ask:
    """No mean is further than a share from another's."""

    def ask(of: Of) -> Finding:
        away = {each: of[each].mean / of[of_what].mean - 1 for each in ids}
        words = ", ".join(f"{each} {value:+.0%}" for each, value in away.items())
        return Finding(all(abs(value) <= share for value in away.values()), f"{words} of {of_what}")

    return ask
