"""The claims of thesis 4.5, each with the rule by which the study's numbers decide it (pure).

A claim about width or dimension is asked of several estimators, since the thesis does not give its own: where
they disagree the verdict is that it depends on them. The same rule is asked of the thesis's printed means.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import Enum

from services.launcher.study_plan import Plan
from services.launcher.study_rules import (
    Ask,
    Finding,
    Of,
    above,
    below,
    both,
    every_run_above,
    falling,
    highest,
    lowest,
    more_by,
    within,
)
from services.launcher.study_table import BY_NAME, Estimate, Estimates

WIDTH = ("diameter", "bulk_diameter", "box_diagonal", "centre_sum")
DIMENSION = ("twonn", "twonn_all", "intrinsic_check")
SPREAD = ("participation_ratio", "bulk_participation_ratio")
COLUMNS = {WIDTH: "diameter", DIMENSION: "intrinsic_dimension", SPREAD: "participation_ratio"}
"""The thesis's column of each."""
COMPOSERS = ("C1", "C2", "C3", "C4")
NOISES = ("C5", "C6", "C7", "C8")
ALL = (*COMPOSERS, *NOISES)
ROBUST = 0.15
"""About the deviation between C1's seeds in the thesis, 46.43 of 326.86."""


class Judgement(Enum):
    """What became of a claim."""

    HOLDS = "holds"
    FAILS = "does not hold"
    DEPENDS = "depends on the estimator"
    UNKNOWN = "not measured"


@dataclass(frozen=True, kw_only=True)
class Claim:
    """A sentence of 4.5 that numbers can decide."""

    words: str
    rule: str
    metrics: tuple[str, ...]
    needs: tuple[str, ...]
    """conditions"""
    ask: Ask
    by_runs: bool = False
    """it is about single runs, of which the thesis prints nothing"""


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """A claim and what was found."""

    claim: Claim
    judgement: Judgement
    findings: Mapping[str, Finding]
    """by metric"""
    of_thesis: Finding | None
    """what the same rule says of the thesis's printed means"""
    missing: tuple[str, ...]

    @property
    def clear(self) -> bool:
        """No estimator's seeds overlap."""
        return all(finding.clear for finding in self.findings.values())


def verdicts_of(plan: Plan, estimates: Estimates) -> list[Verdict]:
    """A verdict per claim."""
    return [verdict_of(claim, plan, estimates) for claim in CLAIMS]


def verdict_of(claim: Claim, plan: Plan, estimates: Estimates) -> Verdict:
    """What the numbers say of a claim."""
    missing = tuple(each for each in claim.needs if each not in estimates)
    findings = {}
    if not missing:
        for name in claim.metrics:
            findings[name] = claim.ask({each: estimates[each][name] for each in claim.needs})
    said = {finding.holds for finding in findings.values()}
    judgement = Judgement.UNKNOWN
    if said:
        judgement = (
            Judgement.DEPENDS if len(said) > 1 else Judgement.HOLDS if True in said else Judgement.FAILS
        )
    printed = None if claim.by_runs else _printed(plan, claim)
    return Verdict(
        claim=claim,
        judgement=judgement,
        findings=findings,
        of_thesis=None if printed is None else claim.ask(printed),
        missing=missing,
    )


def _printed(plan: Plan, claim: Claim) -> Of | None:
    """The thesis's numbers as if they were ours, with a seed at each end of the deviation."""
    found = {}
    column = COLUMNS[claim.metrics]
    for condition in plan.condition:
        numbers = getattr(condition.thesis, column)
        if condition.id in claim.needs and numbers is not None:
            mean, deviation = numbers
            found[condition.id] = Estimate(
                values={-1: mean - deviation, 1: mean + deviation},
                mean=mean,
                deviation=deviation,
                low=mean,
                high=mean,
            )
    return found if len(found) == len(claim.needs) else None


CLAIMS = (
    Claim(
        words="Composer explores a wider space than white noise (thesis: +134 %)",
        rule="mean of C1 above mean of C5",
        metrics=WIDTH,
        needs=("C1", "C5"),
        ask=above("C1", "C5"),
    ),
    Claim(
        words="every run of the Composer reaches further than every run of white noise",
        rule="least run of C1 above the most of C5",
        metrics=WIDTH,
        needs=("C1", "C5"),
        ask=every_run_above(("C1",), "C5"),
        by_runs=True,
    ),
    Claim(
        words="so does every run of its variants C1 to C4",
        rule="least run of C1 to C4 above the most of C5",
        metrics=WIDTH,
        needs=(*COMPOSERS, "C5"),
        ask=every_run_above(COMPOSERS, "C5"),
        by_runs=True,
    ),
    Claim(
        words="Composer's movements have a lower intrinsic dimension than white noise's (thesis: by about 4)",
        rule="mean of C1 below mean of C5",
        metrics=DIMENSION,
        needs=("C1", "C5"),
        ask=below("C1", "C5"),
    ),
    Claim(
        words="Composer spreads over more directions than white noise",
        rule="mean of C1 above mean of C5",
        metrics=SPREAD,
        needs=("C1", "C5"),
        ask=above("C1", "C5"),
    ),
    Claim(
        words="the goals are the most critical piece for structure: without them the dimension is highest",
        rule="mean of C4 the highest of C1 to C4",
        metrics=DIMENSION,
        needs=COMPOSERS,
        ask=highest("C4", COMPOSERS),
    ),
    Claim(
        words="without the simplex the dimension is higher by nearly 4",
        rule="mean of C3 above mean of C1 by 2 to 6",
        metrics=DIMENSION,
        needs=("C1", "C3"),
        ask=more_by("C3", "C1", 2.0, 6.0),
    ),
    Claim(
        words="without contrastive learning the dimension is higher by 2",
        rule="mean of C2 above mean of C1 by 1 to 3",
        metrics=DIMENSION,
        needs=("C1", "C2"),
        ask=more_by("C2", "C1", 1.0, 3.0),
    ),
    Claim(
        words="the pieces matter in the order goals, simplex, contrastive learning",
        rule="means of the dimension fall from C4 over C3 and C2 to C1",
        metrics=DIMENSION,
        needs=COMPOSERS,
        ask=falling(("C4", "C3", "C2", "C1")),
    ),
    Claim(
        words="the diameter is robust to taking pieces away",
        rule=f"means of C2, C3 and C4 within {ROBUST:.0%} of C1's",
        metrics=WIDTH,
        needs=COMPOSERS,
        ask=within(("C2", "C3", "C4"), "C1", ROBUST),
    ),
    Claim(
        words="without the simplex the diameter is the largest of all Composers",
        rule="mean of C3 the highest of C1 to C4",
        metrics=WIDTH,
        needs=COMPOSERS,
        ask=highest("C3", COMPOSERS),
    ),
    Claim(
        words="without the simplex the diameter is the largest of all",
        rule="mean of C3 the highest of C1 to C8",
        metrics=WIDTH,
        needs=ALL,
        ask=highest("C3", ALL),
    ),
    Claim(
        words="pink noise makes the widest pancake of all conditions",
        rule="mean of C6 the highest of C1 to C8",
        metrics=WIDTH,
        needs=ALL,
        ask=highest("C6", ALL),
    ),
    Claim(
        words="pink noise makes the thinnest pancake of all conditions",
        rule="mean dimension of C6 the lowest of C1 to C8",
        metrics=DIMENSION,
        needs=ALL,
        ask=lowest("C6", ALL),
    ),
    Claim(
        words="pink noise spreads over most directions, white noise over fewest",
        rule="mean of C6 the highest and of C5 the lowest of C1 to C8",
        metrics=SPREAD,
        needs=ALL,
        ask=both(highest("C6", ALL), lowest("C5", ALL)),
    ),
)


def heads(verdict: Verdict) -> list[str]:
    """What each estimator said, by the head of its column."""
    return [f"{BY_NAME[name].head}: {finding.words}" for name, finding in verdict.findings.items()]
