"""The figure of a run's phases over its time."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from protocol.messages import Phase
from services.launcher.figures import GREY, save
from services.launcher.timeline import Span, Timeline

PHASE_COLOURS: Mapping[Phase, str] = {
    Phase.BABBLE: "#9AA0A6",
    Phase.ENCODE: "#56B4E9",
    Phase.GROUND: "#009E73",
    Phase.WALK: "#F0E442",
    Phase.REFINE: "#0072B2",
    Phase.PRACTISE: "#E69F00",
    Phase.EVALUATE: "#CC79A7",
}
"""As the dashboard's bar of phases."""
WAIT: dict[str, Any] = {"facecolor": "none", "edgecolor": "#333333", "hatch": "////", "linewidth": 0}
WIDTH_INCHES = 12.0
LABEL_SHARE = 0.0072
"""A letter of a label needs so much of the width."""
UNITS = ((3 * 86400.0, 86400.0, "d"), (3 * 3600.0, 3600.0, "h"), (300.0, 60.0, "min"), (0.0, 1.0, "s"))
"""Times from here on are told in this unit."""
RED = "#D55E00"
MOST_EDGED = 120
"""Bars of one row have white edges up to so many."""


def draw_timeline(path: Path, timeline: Timeline, title: str) -> None:
    """The phases as bars, a row per level of blocks; who waited; and how many actors there were."""
    levels = sorted({span.announced.level for span in timeline.spans})
    unit_secs, unit = unit_of(timeline.end_secs)
    figure = Figure(figsize=(WIDTH_INCHES, 2.2 + 0.75 * len(levels)), layout="constrained")
    bars, crowd = figure.subplots(2, 1, sharex=True, height_ratios=[1.1 * len(levels) + 0.5, 0.8])
    for row, level in enumerate(levels):
        mine = [span for span in timeline.spans if span.announced.level == level]
        _bars(bars, row, mine, timeline.end_secs, unit_secs)
        _iterations(bars, row, mine, timeline.end_secs, unit_secs)
        _waits(bars, row, mine, timeline.waits, unit_secs)
    low, high = -0.55, len(levels) - 0.42
    _restarts(crowd, timeline, unit_secs, 1.0)
    # Not over the numbers of the iterations.
    _restarts(bars, timeline, unit_secs, (len(levels) - 0.8 - low) / (high - low))
    if timeline.stalls:
        places = [stall / unit_secs for stall in timeline.stalls]
        bars.plot(places, [-0.47] * len(places), "^", color=RED, markersize=7, clip_on=False)
    bars.set(ylim=(low, high), xlim=(0, max(timeline.end_secs, 1e-9) / unit_secs))
    bars.set_yticks(range(len(levels)), [f"level {level}" for level in levels] if len(levels) > 1 else [""])
    bars.tick_params(axis="y", length=0)
    for edge in ("top", "right", "left"):
        bars.spines[edge].set_visible(False)
    _actors(crowd, timeline, unit_secs)
    crowd.set_xlabel(f"time since the start ({unit}){_without_stops(timeline)}")
    figure.suptitle(title)
    figure.legend(
        handles=_legend(timeline), loc="outside lower center", ncols=9, frameon=False, handlelength=1.4
    )
    save(figure, path)


def unit_of(secs: float) -> tuple[float, str]:
    """Seconds in the unit that suits so long a time, and its sign."""
    return next((unit, sign) for least, unit, sign in UNITS if secs >= least)


def _bars(axes: Any, row: int, spans: Sequence[Span], whole_secs: float, unit_secs: float) -> None:
    # White edges between more bars than this would leave nothing of them.
    edge = {"edgecolor": "white", "linewidth": 0.4} if len(spans) <= MOST_EDGED else {"linewidth": 0}
    for phase, colour in PHASE_COLOURS.items():
        mine = [span for span in spans if span.announced.phase is phase]
        places = [(span.begin_secs / unit_secs, span.secs / unit_secs) for span in mine]
        axes.broken_barh(places, (row - 0.4, 0.55), facecolor=colour, **edge)
        box = {"boxstyle": "round,pad=0.2", "facecolor": colour, "linewidth": 0}
        style = {"ha": "center", "va": "center", "fontsize": 9, "zorder": 4, "bbox": box}
        style["color"] = "white" if phase is Phase.REFINE else "black"
        for (begin, size), span in zip(places, mine, strict=True):
            if span.secs > LABEL_SHARE * (len(phase) + 1) * whole_secs:
                axes.text(begin + size / 2, row - 0.125, phase.value, **style)


def _waits(
    axes: Any, row: int, spans: Sequence[Span], waits: Sequence[tuple[float, float]], unit_secs: float
) -> None:
    """Who waits is the level whose turn it is."""
    for span in spans:
        for begin, end in waits:
            first, last = max(begin, span.begin_secs), min(end, span.end_secs)
            if first < last:
                axes.broken_barh([(first / unit_secs, (last - first) / unit_secs)], (row - 0.4, 0.55), **WAIT)


def _iterations(axes: Any, row: int, spans: Sequence[Span], whole_secs: float, unit_secs: float) -> None:
    """A bracket over each iteration that is wide enough for its number; of narrow ones some numbers."""
    extents: dict[int, tuple[float, float]] = {}
    for span in spans:
        begin_secs, _ = extents.get(span.announced.iteration, (span.begin_secs, 0.0))
        extents[span.announced.iteration] = begin_secs, span.end_secs
    gap_secs, free_from_secs, letter_secs = 0.002 * whole_secs, 0.0, LABEL_SHARE * whole_secs
    for number, (begin_secs, end_secs) in extents.items():
        long, short = f"iteration {number}", str(number)
        text = long if end_secs - begin_secs > letter_secs * len(long) else short
        centre_secs = (begin_secs + end_secs) / 2
        if centre_secs - letter_secs * len(text) / 2 < free_from_secs:
            continue
        if end_secs - begin_secs > 4 * gap_secs:
            ends = [(begin_secs + gap_secs) / unit_secs, (end_secs - gap_secs) / unit_secs]
            axes.plot(ends, [row + 0.25] * 2, color=GREY)
        style = {"ha": "center", "va": "bottom", "fontsize": 9, "color": "#333333"}
        axes.text(centre_secs / unit_secs, row + 0.3, text, **style)
        free_from_secs = centre_secs + letter_secs * (len(text) / 2 + 1)


def _restarts(axes: Any, timeline: Timeline, unit_secs: float, height: float) -> None:
    """Lines up to a share of the height."""
    for restart in timeline.restarts:
        style = {"color": RED, "linewidth": 1.6, "linestyle": "-" if restart.stopped_secs else ":"}
        axes.axvline(restart.at_secs / unit_secs, ymax=height, zorder=5, **style)


def _actors(axes: Any, timeline: Timeline, unit_secs: float) -> None:
    steps = [(0.0, 0), *timeline.actors]
    steps = [step for step in steps if step[0] <= timeline.end_secs]
    places = [*(secs / unit_secs for secs, _ in steps), timeline.end_secs / unit_secs]
    counts = [*(count for _, count in steps), steps[-1][1]]
    axes.step(places, counts, where="post", color="#333333", linewidth=1.3)
    axes.fill_between(places, counts, step="post", color="#333333", alpha=0.12, linewidth=0)
    most = max(1, *counts)
    axes.set(ylim=(0, 1.2 * most), ylabel="actors", yticks=[0, most])


def _legend(timeline: Timeline) -> list[Any]:
    there = {span.announced.phase for span in timeline.spans}
    handles: list[Any] = [
        Patch(facecolor=colour, label=phase.value)
        for phase, colour in PHASE_COLOURS.items()
        if phase in there
    ]
    if timeline.waits:
        handles.append(Patch(label="somebody is missing", **WAIT))
    red: dict[str, Any] = {"color": RED, "linewidth": 1.6}
    if any(restart.stopped_secs for restart in timeline.restarts):
        handles.append(Line2D([], [], label="resumed", **red))
    if any(not restart.stopped_secs for restart in timeline.restarts):
        handles.append(Line2D([], [], linestyle=":", label="coordinator restarted", **red))
    if timeline.stalls:
        handles.append(Line2D([], [], color=RED, marker="^", linestyle="", label="stalled"))
    return handles


def _without_stops(timeline: Timeline) -> str:
    stopped_secs = sum(restart.stopped_secs for restart in timeline.restarts)
    if not stopped_secs:
        return ""
    unit_secs, unit = unit_of(stopped_secs)
    return f", without {stopped_secs / unit_secs:.1f} {unit} in which the run was stopped"
