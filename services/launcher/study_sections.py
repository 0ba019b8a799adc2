"""The tables of a study's report, in Markdown."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from services.launcher.lines import clock_words
from services.launcher.report_tables import table_head, table_row
from services.launcher.study_claims import Verdict, heads, verdicts_of
from services.launcher.study_plan import Condition, Plan
from services.launcher.study_table import (
    BY_NAME,
    METRICS,
    NEAR,
    Estimates,
    Measurements,
    Nearness,
    is_near,
    nearness_of,
    plus_minus,
    short_cells,
    short_heads,
    thesis_of,
    value_of,
)

NEAREST = {
    "diameter": "Diameter: which definition comes how near",
    "intrinsic_dimension": "Intrinsic dimension: which estimator comes how near",
}


def verdict_section(plan: Plan, estimates: Estimates) -> list[str]:
    """Each claim of 4.5 with its verdict; nothing where the plan has no claims."""
    if plan.claims is None:
        return []
    verdicts = verdicts_of(plan, estimates)
    lines = [
        "## What of section 4.5 holds",
        "",
        "Each claim is decided by its rule on the means over the seeds. Width is asked of the diameter, also "
        "without outliers, the box's diagonal and the k-centre sum; dimension of TwoNN without and with the "
        "largest 10 % of the ratios, and of a maximum-likelihood estimator. Where they disagree, the claim "
        'depends on the estimator. "Seeds overlap": for some estimator the runs of both sides do. "Thesis" '
        "is the same rule on the means that Table 1 prints.",
        "",
        *table_head(["claim", "verdict", "thesis", "rule", "found"]),
    ]
    return [*lines, *(table_row(_verdict_cells(verdict)) for verdict in verdicts), ""]


def main_section(plan: Plan, estimates: Estimates) -> list[str]:
    """The table beside the thesis's."""
    lines = ["## The table", "", "Mean ± standard deviation over the seeds (n - 1).", ""]
    lines += table_head(["", "seeds", *short_heads()])
    for condition in plan.condition:
        found = estimates.get(condition.id)
        count = 0 if found is None else len(found["diameter"].values)
        name = f"**{condition.id}** {condition.title}"
        lines.append(table_row([name, str(count), *short_cells(condition, found)]))
    return [*lines, ""]


def nearness_section(plan: Plan, estimates: Estimates) -> list[str]:
    """Which definitions come how near to the thesis's columns, and which participation ratios are near."""
    lines: list[str] = []
    for column, title in NEAREST.items():
        if found := nearness_of(plan, estimates, column):
            lines += [f"## {title}", "", *_nearness_table(plan, found), ""]
    return [*lines, *_participation(plan, estimates)]


def seeds_section(plan: Plan, measurements: Measurements, estimates: Estimates) -> list[str]:
    """Every metric of every condition: mean, deviation, interval, and every seed."""
    lines = ["## Every metric, every seed", ""]
    for metric in METRICS:
        seeds = sorted({seed for by_seed in measurements.values() for seed in by_seed})
        lines += [f"**{metric.head}**: {metric.words}.", ""]
        lines += table_head(["", "mean ± sd", "95 % of the mean", *(f"seed {seed}" for seed in seeds)])
        for condition in plan.condition:
            if condition.id not in estimates:
                continue
            one = estimates[condition.id][metric.name]
            interval = f"{one.low:,.{metric.digits}f} to {one.high:,.{metric.digits}f}"
            values = [
                f"{one.values[seed]:,.{metric.digits}f}" if seed in one.values else "-" for seed in seeds
            ]
            mean = plus_minus(one.mean, one.deviation, metric.digits)
            lines.append(table_row([condition.id, mean, interval, *values]))
        lines.append("")
    return lines


def growth_section(plan: Plan, measurements: Measurements) -> list[str]:
    """Diameter and PR of the bulk, and TwoNN, of the first so many states, means over the seeds."""
    shown = [BY_NAME[name] for name in ("bulk_diameter", "bulk_participation_ratio", "twonn")]
    rows = max(([each.rows for each in one.curve] for _, one in _each(measurements)), key=len, default=[])
    lines = ["## Coverage over steps", "", "Means over the seeds after so many states.", ""]
    lines += table_head(["", *(f"{metric.head} {count:,}" for metric in shown for count in rows)])
    for condition in plan.condition:
        if not (by_seed := measurements.get(condition.id)):
            continue
        cells = [condition.id]
        for metric in shown:
            for count in rows:
                values = [
                    value_of(each, metric)
                    for one in by_seed.values()
                    for each in one.curve
                    if each.rows == count
                ]
                cells.append(f"{np.mean(values):,.{metric.digits}f}" if values else "-")
        lines.append(table_row(cells))
    return [*lines, ""]


def conditions_section(plan: Plan) -> list[str]:
    """What each condition changes."""
    lines = [
        "## The conditions",
        "",
        f"Each is the base scenario `{plan.base}` with one thing otherwise.",
        "",
    ]
    lines += table_head(["", "what", "otherwise"])
    for condition in plan.condition:
        changes = ", ".join(f"`{key} = {value}`" for key, value in _flat(condition.change).items())
        lines.append(table_row([condition.id, condition.title, changes or "nothing"]))
    return [*lines, ""]


def cost_section(plan: Plan, measurements: Measurements) -> list[str]:
    """Time, processor, disk, and what the data sets hold."""
    lines = [
        "## Cost",
        "",
        "Means over the runs of a condition; CPU of all processes of a run's last launch.",
        "",
    ]
    lines += table_head(["", "runs", "running", "CPU s", "steps/s", "data set MB", "measuring s"])
    for condition in plan.condition:
        if not (ones := list(measurements.get(condition.id, {}).values())):
            continue
        secs = [one.trained_secs for one in ones]
        speeds = [one.recorded_rows / one.trained_secs for one in ones if one.trained_secs]
        cells = [condition.id, str(len(ones)), clock_words(float(np.mean(secs)))]
        cells += [f"{np.mean([one.cpu_secs for one in ones]):,.0f}"]
        cells += [f"{np.mean(speeds):,.0f}" if speeds else "-"]
        cells += [f"{np.mean([one.states_bytes for one in ones]) / 1e6:,.1f}"]
        cells += [f"{np.mean([one.measured_secs for one in ones]):,.0f}"]
        lines.append(table_row(cells))
    total = sum(one.cpu_secs for _, one in _each(measurements)) / 3600
    return [*lines, "", f"All runs together: {total:,.1f} CPU hours.", ""]


def data_section(measurements: Measurements) -> list[str]:
    """Of each run what was recorded, and that nothing is there twice."""
    lines = [
        "## The data",
        "",
        "Rows of each run's recording; the first of them outside evaluate are measured.",
        "",
    ]
    lines += table_head(["run", "recorded", "measured", "twice", "missing", "by phase"])
    for name, one in sorted(_each(measurements)):
        phases = ", ".join(f"{phase} {count:,}" for phase, count in one.rows_by_phase.items())
        cells = [name, f"{one.recorded_rows:,}", f"{one.rows:,}", f"{one.duplicates:,}", f"{one.gaps:,}"]
        lines.append(table_row([*cells, phases]))
    return [*lines, ""]


def _verdict_cells(verdict: Verdict) -> list[str]:
    words = f"**{verdict.judgement.value}**"
    if verdict.missing:
        words += f" (no run of {', '.join(verdict.missing)})"
    elif not verdict.clear:
        words += ", seeds overlap"
    of_thesis = "-"
    if verdict.of_thesis is not None:
        of_thesis = f"{'yes' if verdict.of_thesis.holds else 'no'}: {verdict.of_thesis.words}"
    found = "<br>".join(heads(verdict)) or "-"
    return [verdict.claim.words, words, of_thesis, verdict.claim.rule, found]


def _nearness_table(plan: Plan, found: Sequence[Nearness]) -> list[str]:
    ids = [condition.id for condition in plan.condition if condition.id in found[0].errors]
    lines = [
        "Error against the thesis's mean, by condition, and the mean of their sizes; the rank correlation of "
        "the conditions (1: the thesis's order); the one factor that would bring all nearest, and the mean "
        "size of the errors that it leaves.",
        "",
        *table_head(["definition", *ids, "mean size", "order", "factor", "left"]),
    ]
    for each in found:
        errors = [f"{each.errors[one]:+.0%}" for one in ids]
        order = "-" if each.order is None else f"{each.order:+.2f}"
        factor = (f"{each.factor:.3g}", f"{each.left_error:.0%}")
        lines.append(table_row([each.metric.head, *errors, f"{each.mean_error:.0%}", order, *factor]))
    return lines


def _participation(plan: Plan, estimates: Estimates) -> list[str]:
    metrics = [BY_NAME[name] for name in ("participation_ratio", "bulk_participation_ratio")]
    rows = []
    for condition in plan.condition:
        printed, found = thesis_of(condition, metrics[0]), estimates.get(condition.id)
        if printed is None or found is None:
            continue
        kind = "open loop" if is_open_loop(condition) else "learns"
        cells = [condition.id, kind, f"{printed[0]:.2f}"]
        for metric in metrics:
            ours = found[metric.name].mean
            near = "yes" if is_near(ours, printed[0]) else "**no**"
            cells += [f"{ours:.2f}", f"{ours / printed[0] - 1:+.0%}", near]
        rows.append(table_row(cells))
    if not rows:
        return []
    heads = [part for metric in metrics for part in (metric.head, "error", f"within {NEAR:.0%}")]
    return ["## Participation ratio", "", *table_head(["", "", "thesis", *heads]), *rows, ""]


def is_open_loop(condition: Condition) -> bool:
    """Nothing is learned."""
    return bool(condition.change.get("phases", {}).get("open_loop"))


def _each(measurements: Measurements) -> list[tuple[str, Any]]:
    return [
        (f"{condition}-seed{seed}", one)
        for condition, by_seed in measurements.items()
        for seed, one in by_seed.items()
    ]


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{before}{key}.") if isinstance(value, Mapping) else {f"{before}{key}": value}
    return flat
