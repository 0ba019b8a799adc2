"""The figure of what a block learned: its scores, and the measures of its learners."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from babble.scores import REACHED
from protocol.messages import Phase, Score
from services.launcher.curves import Clock, Curves, Measure, Series, clock
from services.launcher.figures import COLOURS, GREY, MARKERS, save
from services.launcher.timeline import Timeline
from services.launcher.timeline_figure import PHASE_COLOURS, unit_of

Floats = NDArray[Any]

COLUMNS = 4
SHADES = {Phase.ENCODE: 0.22, Phase.REFINE: 0.38, Phase.GROUND: 0.22, Phase.PRACTISE: 0.28}
MOST_DOTS = 60
"""Points of more are only joined by a line."""
MOST_LINED = 1000
"""Of more points only a band is drawn."""
BINS = 120
INK = "#222222"


def draw_learning(
    path: Path,
    block: str,
    rows: Sequence[Score],
    best: int | None,
    curves: Curves,
    timeline: Timeline,
    title: str,
    level: int = 0,
) -> None:
    """Scores by iteration, and what the learners measured in the time in which its level learned."""
    drawn = curves.of(block)
    drawers: list[Callable[[Any], None]] = [lambda axes: _scores(axes, rows, best)] if rows else []
    drawers += [_curve_drawer(measure, series, timeline, level) for measure, series in drawn.items()]
    columns = min(COLUMNS, len(drawers))
    lines = -(-len(drawers) // columns)
    width, below = max(5.4, 3.15 * columns), 1.0 if columns > 2 else 1.6
    height = 0.45 + 2.4 * lines + below
    figure = Figure(figsize=(width, height))
    panels = figure.subplots(lines, columns, squeeze=False).ravel()
    # Constrained layout takes seconds for so many panels.
    edges = {"left": 0.7 / width, "right": 1 - 0.12 / width}
    edges |= {"bottom": (below + 0.1) / height, "top": 1 - 0.75 / height}
    figure.subplots_adjust(wspace=0.34, hspace=0.5, **edges)
    for axes, draw in zip(panels, drawers, strict=False):
        draw(axes)
    for axes in panels[len(drawers) :]:
        axes.set_axis_off()
    figure.suptitle(title)
    handles, _ = panels[0].get_legend_handles_labels() if rows else ([], [])
    used = {phase for measure in drawn for phase in measure.phases}
    spans = {span.announced.phase for span in timeline.spans} & used
    handles += [
        Patch(facecolor=colour, alpha=SHADES[phase], label=phase.value.upper())
        for phase, colour in PHASE_COLOURS.items()
        if phase in spans
    ]
    figure.legend(handles=handles, loc="lower center", ncols=min(6, 2 * columns), frameon=False, fontsize=9)
    save(figure, path)


def _curve_drawer(measure: Measure, series: Series, timeline: Timeline, level: int) -> Callable[[Any], None]:
    return lambda axes: _curve(axes, measure, series, clock(timeline, measure.phases, level))


def _curve(axes: Any, measure: Measure, series: Series, hands: Clock) -> None:
    """One measure on the clock of its phases; a new piece where the term changes."""
    place, value, term = hands.of(series.secs), np.array(series.value), np.array(series.term)
    unit_secs, unit = unit_of(max(hands.borders[-1], float(place.max(initial=0.0))))
    _shade(axes, hands, unit_secs)
    (_line if len(value) <= MOST_LINED else _band)(axes, place / unit_secs, value, term)
    axes.set_title(measure.title, fontsize=10)
    axes.set_xlabel(f"{unit} in {' and '.join(phase.value.upper() for phase in measure.phases)}", fontsize=8)
    axes.set_ylabel(measure.label, fontsize=8)
    axes.tick_params(labelsize=8)
    axes.margins(x=0.01)
    axes.locator_params(axis="y", nbins=5)
    axes.grid(alpha=0.3)


def _line(axes: Any, place: Floats, value: Floats, term: Floats) -> None:
    """A line with a gap where the term changes; dots where there are few points, and for lonely ones."""
    cuts = np.flatnonzero(np.diff(term)) + 1
    style = {"color": INK, "linewidth": 1}
    axes.plot(np.insert(place, cuts, np.nan), np.insert(value, cuts, np.nan), **style)
    lonely = np.diff(np.concatenate([[0], cuts, [len(value)]])) == 1
    dots = np.arange(len(value)) if len(value) <= MOST_DOTS else np.concatenate([[0], cuts])[lonely]
    axes.plot(place[dots], value[dots], "o", color=INK, markersize=2.2)


def _band(axes: Any, place: Floats, value: Floats, term: Floats) -> None:
    """Where there are too many points for a line: their medians, and what all but the tenths lie between."""
    groups = np.array_split(np.arange(len(value)), BINS)
    middle = [float(np.median(place[group])) for group in groups]
    low, median, high = np.array([np.quantile(value[group], [0.1, 0.5, 0.9]) for group in groups]).T
    axes.fill_between(middle, low, high, color=INK, alpha=0.25, linewidth=0)
    axes.plot(middle, median, color=INK, linewidth=1.2)


def _shade(axes: Any, hands: Clock, unit_secs: float) -> None:
    """The phases behind a curve, with white borders between them as long as there is room."""
    upright = axes.get_xaxis_transform()
    for phase, alpha in SHADES.items():
        places = [
            (begin / unit_secs, span.secs / unit_secs)
            for begin, span in zip(hands.borders, hands.spans, strict=False)
            if span.announced.phase is phase
        ]
        style = {"facecolor": PHASE_COLOURS[phase], "alpha": alpha, "linewidth": 0}
        axes.broken_barh(places, (0, 1), transform=upright, **style)
    if len(hands.spans) <= MOST_DOTS:
        borders = [border / unit_secs for border in hands.borders[1:-1]]
        axes.vlines(borders, 0, 1, transform=upright, color="white", linewidth=1)


def _scores(axes: Any, rows: Sequence[Score], best: int | None) -> None:
    lowest = 0.8
    landmarks = list(dict.fromkeys(name for row in rows for name in row.landmarks))
    crossing = ["crossing"] if any(row.crossing is not None for row in rows) else []
    measures = ["separation", "z_min", *crossing, *landmarks]
    for policy, line in (("mean", "-"), ("sampled", ":")):
        mine = sorted((row for row in rows if row.policy == policy), key=lambda row: row.iteration)
        iterations = [row.iteration for row in mine]
        for measure, colour, marker in zip(measures, COLOURS, MARKERS, strict=False):
            values = [_value(row, measure) for row in mine]
            lowest = min([lowest, *values])
            style = {"marker": marker, "markersize": 4, "color": colour, "linewidth": 1.2}
            style["markerfacecolor"] = colour if policy == "mean" else "white"
            axes.plot(iterations, values, line, label=f"{measure}, {policy}", **style)
    axes.axhline(REACHED, color=GREY, linewidth=1, linestyle="--", label=f"bar of success, {REACHED}")
    if best is not None:
        axes.axvspan(best - 0.2, best + 0.2, color=GREY, alpha=0.18, linewidth=0, label="best iteration")
    axes.set_ylim(max(0.0, lowest - 0.1), 1.03)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_title("scores from random starts", fontsize=10)
    axes.set_xlabel("iteration (0: after GROUND)", fontsize=8)
    axes.set_ylabel("score (no unit)", fontsize=8)
    axes.tick_params(labelsize=8)
    axes.grid(alpha=0.3)


def _value(row: Score, measure: str) -> float:
    value: float | None = row.landmarks[measure] if measure in row.landmarks else getattr(row, measure, None)
    return float("nan") if value is None else value
