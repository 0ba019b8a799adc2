"""The figures of a level of a tree: its blocks side by side."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from babble.parts import Part
from babble.scores import REACHED
from babble.worlds import World
from babble.worlds.batch import PointWorld
from protocol.messages import Score
from services.launcher.curves import Curves, Measure, clock
from services.launcher.figures import AXES, GREY, MOST_NAMED, Ends, save, vertex_colours
from services.launcher.judging import measures
from services.launcher.learning_figure import MOST_DOTS
from services.launcher.posture_figures import is_few, means, short_names, strips
from services.launcher.timeline import Timeline
from services.launcher.timeline_figure import unit_of

COLUMNS = 4
PANEL_INCHES = (3.1, 2.7)
ABOVE, BELOW = 0.75, 0.75
"""Inches for the title, and for the legend of all panels."""
MOST_LABELLED = 16
"""Joints of one panel that are named."""


@dataclass(frozen=True)
class Panel:
    """Where one block's goals lead."""

    block: str
    ends: Ends
    """of what it moves, from -1 to 1"""
    names: Sequence[str]


def panel_of(block: str, ends: Ends, part: Part, names: Sequence[str], world: World) -> Panel:
    """The ends (of whole postures) of a block that moves a part of a world."""
    moved = ends.cut(part.components)
    if isinstance(world, PointWorld):
        reach = world.body.extent[part.components]
        moved = replace(moved, posture=moved.posture / reach)
        names = [AXES[component] for component in part.components]
    return Panel(block, moved, short_names(names) if names else [])


def draw_ends(path: Path, panels: Sequence[Panel], title: str) -> None:
    """A panel per block: where each component of what it moves ends, per goal."""
    figure, grid = _grid(len(panels), title)
    # Names of joints may be of any length.
    figure.set_layout_engine("constrained")
    for axes, panel in zip(grid, panels, strict=False):
        if is_few(panel.ends):
            strips(axes, panel.ends)
            axes.set_ylabel("")
        else:
            means(figure, axes, panel.ends)
        joints = panel.ends.posture.shape[1]
        if len(panel.names) == joints <= MOST_LABELLED:
            axes.set_xticks(range(joints), panel.names, rotation=90 if joints > len(AXES) else 0, fontsize=7)
        axes.tick_params(axis="y", labelsize=7)
        axes.set_title(panel.block, fontsize=10)
    most = max((axes for axes in grid), key=lambda axes: len(axes.get_legend_handles_labels()[0]))
    handles, labels = most.get_legend_handles_labels()
    if 0 < len(labels) <= MOST_NAMED:
        figure.legend(handles, labels, loc="outside lower center", ncols=len(labels), frameon=False)
    save(figure, path)


def draw_learning(
    path: Path,
    blocks: Sequence[str],
    rows: Sequence[Score],
    curves: Curves,
    timeline: Timeline,
    level: int,
) -> None:
    """A panel per measure, a line per block."""
    colours = dict(zip(blocks, vertex_colours(len(blocks)), strict=True))
    found = [measure for block in blocks for measure in curves.of(block)]
    drawers: list[Callable[[Any], None]] = [
        lambda axes: _scores(axes, rows, colours, "z_min", lambda row: row.z_min),
        lambda axes: _scores(axes, rows, colours, "weakest measure", lambda row: min(measures(row).values())),
        *(_curve_drawer(measure, colours, curves, timeline, level) for measure in dict.fromkeys(found)),
    ]
    figure, grid = _grid(len(drawers), f"level {level}: what its blocks learned")
    for axes, draw in zip(grid, drawers, strict=False):
        draw(axes)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.3)
    # Constrained layout takes seconds for so many panels.
    width, height = figure.get_size_inches()
    edges = {"left": 0.65 / width, "right": 1 - 0.15 / width}
    edges |= {"bottom": (BELOW + 0.5) / height, "top": 1 - ABOVE / height}
    figure.subplots_adjust(wspace=0.32, hspace=0.55, **edges)
    handles, labels = grid[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="lower center", ncols=min(8, len(labels)), frameon=False)
    save(figure, path)


def _grid(panels: int, title: str) -> tuple[Figure, Sequence[Any]]:
    columns = min(COLUMNS, panels)
    lines = -(-panels // columns)
    width, height = max(5.0, PANEL_INCHES[0] * columns), ABOVE + BELOW + PANEL_INCHES[1] * lines
    figure = Figure(figsize=(width, height))
    grid = figure.subplots(lines, columns, squeeze=False).ravel().tolist()
    for axes in grid[panels:]:
        axes.set_axis_off()
    figure.suptitle(title)
    return figure, grid


def _scores(
    axes: Any,
    rows: Sequence[Score],
    colours: dict[str, str],
    title: str,
    value: Callable[[Score], float],
) -> None:
    """By iteration, of mean actions."""
    for block, colour in colours.items():
        mine = sorted(
            (row for row in rows if row.block == block and row.policy == "mean"),
            key=lambda row: row.iteration,
        )
        places, values = [row.iteration for row in mine], [value(row) for row in mine]
        axes.plot(places, values, "o-", color=colour, markersize=3, linewidth=1.2, label=block)
    axes.axhline(REACHED, color=GREY, linewidth=1, linestyle="--")
    axes.set_ylim(min(0.8, axes.get_ylim()[0]), 1.03)
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_title(f"score: {title}", fontsize=10)
    axes.set_xlabel("iteration (0: after GROUND)", fontsize=8)


def _curve_drawer(
    measure: Measure, colours: dict[str, str], curves: Curves, timeline: Timeline, level: int
) -> Callable[[Any], None]:
    def draw(axes: Any) -> None:
        hands = clock(timeline, measure.phases, level)
        unit_secs, unit = unit_of(hands.borders[-1])
        for block, colour in colours.items():
            series = curves.of(block).get(measure)
            if series is None:
                continue
            cuts = np.flatnonzero(np.diff(np.array(series.term))) + 1
            place = np.insert(hands.of(series.secs) / unit_secs, cuts, np.nan)
            dots = "o-" if len(series.value) <= MOST_DOTS else "-"
            value = np.insert(np.array(series.value), cuts, np.nan)
            axes.plot(place, value, dots, color=colour, linewidth=1, markersize=2.2)
        axes.set_title(measure.title, fontsize=10)
        axes.set_ylabel(measure.label, fontsize=8)
        phases = " and ".join(phase.value.upper() for phase in measure.phases)
        axes.set_xlabel(f"{unit} in {phases}", fontsize=8)

    return draw
