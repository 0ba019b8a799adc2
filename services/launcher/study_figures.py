"""The figures of a study: coverage over steps, spectra of variance, neighbour ratios."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from services.launcher.figures import COLOURS, GREY, MARKERS, save
from services.launcher.study_measurement import Measurement
from services.launcher.study_plan import Condition, Plan
from services.launcher.study_table import BY_NAME, Measurements, thesis_of, value_of

OVER_STEPS = ("diameter", "bulk_diameter", "bulk_participation_ratio", "twonn")
PANELS_ACROSS = 4
KEPT_SHARE = 0.9
"""TwoNN's line is fitted to so much of the ratios, the smallest."""
TIES = 1.04
"""Thesis's points are drawn a little beyond the last step."""


def draw_over_steps(path: Path, plan: Plan, measurements: Measurements) -> None:
    """How coverage grows: a thin line per seed, a strong one for their mean, at the end the thesis's."""
    figure = Figure(figsize=(11.0, 7.6), layout="constrained")
    panels = figure.subplots(2, 2, sharex=True).ravel()
    for axes, name in zip(panels, OVER_STEPS, strict=True):
        metric = BY_NAME[name]
        for place, condition, by_seed in _present(plan, measurements):
            _growth(axes, name, place, condition, list(by_seed.values()))
        axes.set(xscale="log", title=metric.words)
        if name == "diameter":
            # A flung limb makes it many times as large as it was, in one step.
            axes.set(yscale="log")
        else:
            axes.set(ylim=(0, None))
        axes.title.set_fontsize(9)
        axes.grid(alpha=0.3)
        axes.set_ylabel(metric.head)
    for axes in panels[2:]:
        axes.set_xlabel("states")
    lines, labels = panels[0].get_legend_handles_labels()
    figure.legend(lines, labels, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    figure.suptitle("Coverage over time; open marks at the right edge: the thesis")
    save(figure, path)


def draw_spectra(path: Path, plan: Plan, measurements: Measurements) -> None:
    """The variances along the principal axes, falling: a flat spectrum is a ball, a steep one a pancake."""
    figure = Figure(figsize=(9.0, 5.4), layout="constrained")
    axes: Any = figure.subplots()
    for place, condition, by_seed in _present(plan, measurements):
        spectra = [np.array(each.coverage.variances) for each in by_seed.values()]
        style = {**_style(place, condition), "marker": ""}
        for spectrum in spectra:
            axes.plot(np.arange(1, len(spectrum) + 1), _positive(spectrum), linewidth=0.6, alpha=0.5, **style)
        mean = _positive(np.mean(spectra, axis=0))
        axes.plot(np.arange(1, len(mean) + 1), mean, linewidth=1.8, label=_label(condition), **style)
    axes.set(yscale="log", xlabel="principal axis", ylabel="variance (raw units: rad², (rad/s)²)")
    axes.grid(alpha=0.3)
    axes.legend(frameon=False, fontsize=9, ncols=2)
    figure.suptitle("Spectra of variance")
    save(figure, path)


def draw_ratios(path: Path, plan: Plan, measurements: Measurements) -> None:
    """-log(1 - F) against log mu (eq. 29): TwoNN holds as far as the points lie on a line through 0."""
    present = _present(plan, measurements)
    rows = -(-len(present) // PANELS_ACROSS)
    across = min(PANELS_ACROSS, len(present))
    figure = Figure(figsize=(3.1 * across + 0.6, 2.9 * rows + 0.8), layout="constrained")
    panels = figure.subplots(rows, across, sharey=True, squeeze=False).ravel()
    for axes in panels[len(present) :]:
        axes.set_axis_off()
    for axes, (place, condition, by_seed) in zip(panels, present, strict=False):
        _ratios(axes, place, condition, by_seed)
    for axes in panels[::across]:
        axes.set_ylabel("$-\\log(1 - F_i)$")
    figure.suptitle(
        "Neighbour ratios: points, and the line through 0 of the smallest 90 % (solid) and of all (dotted)",
        fontsize=11,
    )
    save(figure, path)


def _growth(axes: Any, name: str, place: int, condition: Condition, measured: Sequence[Measurement]) -> None:
    metric, style = BY_NAME[name], _style(place, condition)
    curves = [[value_of(each, metric) for each in one.curve] for one in measured]
    rows = [each.rows for each in measured[0].curve]
    alike = [
        curve
        for curve, one in zip(curves, measured, strict=True)
        if [each.rows for each in one.curve] == rows
    ]
    for curve in alike:
        axes.plot(rows, curve, linewidth=0.6, alpha=0.5, **{**style, "marker": ""})
    axes.plot(rows, np.mean(alike, axis=0), linewidth=1.8, label=_label(condition), markersize=4, **style)
    if (printed := thesis_of(condition, metric)) is not None and name != "bulk_diameter":
        marks = {**style, "markerfacecolor": "none", "linestyle": ""}
        axes.plot(rows[-1] * TIES ** (2 + place), printed[0], markersize=7, **marks)


def _ratios(axes: Any, place: int, condition: Condition, by_seed: Any) -> None:
    style = _style(place, condition)
    seed, one = min(by_seed.items())
    x, y = np.array(one.log_ratios), -np.log(1 - np.array(one.ranks))
    axes.plot(x, y, ".", color=style["color"], markersize=3)
    kept = x[np.array(one.ranks) <= KEPT_SHARE]
    edge = float(kept[-1]) if len(kept) else float(x[-1])
    top = float(y.max())
    for slope, line in ((one.coverage.twonn, "-"), (one.coverage.twonn_all, ":")):
        end = min(float(x[-1]), top / slope)
        axes.plot([0, end], [0, slope * end], line, color="black", linewidth=1.0)
    axes.axvline(edge, color=GREY, linewidth=0.8, linestyle="--")
    axes.set(xlim=(0, float(np.quantile(x, 0.99)) * 1.15), ylim=(0, top))
    axes.set_xlabel("$\\log\\ \\mu_i$")
    dimensions = f"{one.coverage.twonn:.1f}, all {one.coverage.twonn_all:.1f}"
    axes.set_title(f"{condition.id} {condition.title}, seed {seed}\n{dimensions}", fontsize=8)
    axes.grid(alpha=0.3)


def _present(plan: Plan, measurements: Measurements) -> list[tuple[int, Condition, Any]]:
    """The conditions that have a run: place in the plan, itself, its measurements by seed."""
    return [
        (place, condition, measurements[condition.id])
        for place, condition in enumerate(plan.condition)
        if measurements.get(condition.id)
    ]


def _style(place: int, condition: Condition) -> dict[str, Any]:
    is_open_loop = bool(condition.change.get("phases", {}).get("open_loop"))
    return {
        "color": COLOURS[place % len(COLOURS)],
        "marker": MARKERS[place % len(MARKERS)],
        "linestyle": "--" if is_open_loop else "-",
    }


def _label(condition: Condition) -> str:
    return f"{condition.id} {condition.title}"


def _positive(spectrum: Any) -> Any:
    """What a logarithm has no place for is left out."""
    return np.where(spectrum > 0, spectrum, np.nan)
