"""Views that several tabs have: simplexes, and lines over the run's time."""

from collections.abc import Mapping, Sequence

import rerun as rr
import rerun.blueprint as rrb

from services.dashboard.canvas import colours
from services.dashboard.colours import of_index
from services.dashboard.latents import line_bounds
from services.dashboard.simplex import Simplex, simplex_of
from services.runtime.settings import BlockSettings

RECENT_SECS = 120
"""Plots of latents show so much of the past; the others all of it."""
MOST_NAMED = 8
"""Lines of blocks in one plot; the names of more would hide them."""


def simplex_view(block: BlockSettings, name: str) -> rrb.View:
    """The simplex of a block."""
    drawing, origin = simplex_of(block.latent_dim), f"/latent/{block.name}"
    if drawing.solid:
        eye = rrb.EyeControls3D(position=(0.5, -2.6, 1.0), look_target=(0, 0, 0.1), eye_up=(0, 0, 1))
        return rrb.Spatial3DView(origin=origin, name=name, eye_controls=eye, line_grid=False)
    across, down = _bounds(drawing)
    bounds = rrb.VisualBounds2D(x_range=across, y_range=down)
    return rrb.Spatial2DView(origin=origin, name=name, visual_bounds=bounds)


def _bounds(drawing: Simplex) -> tuple[tuple[float, float], tuple[float, float]]:
    return line_bounds() if drawing.latent_dim == 2 else drawing.bounds()


def usage(block: str, recent_secs: int | None) -> rrb.View:
    """How much each vertex of a block is used."""
    name = f"Share of recent latents nearest to each vertex{ago(recent_secs)}"
    return plot(name, [f"/measures/{block}/usage/**"], recent_secs, rrb.ScalarAxis(range=(0.0, 1.0)))


def plot(
    name: str, paths: Sequence[str], recent_secs: int | None = None, axis: rrb.ScalarAxis | None = None
) -> rrb.View:
    """Lines over the run's time: the last `recent_secs`, or all of it."""
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ {path}" for path in paths],
        name=name,
        axis_x=times(recent_secs),
        axis_y=axis,
        plot_legend=_legend(),
    )


def compare(
    name: str,
    paths: Mapping[str, str],
    recent_secs: int | None = None,
    axis: rrb.ScalarAxis | None = None,
    *,
    dots: bool = False,
) -> rrb.View:
    """The same line of several blocks, by block: here it has the block's name and a colour of its own.

    `dots`: at each number, so that a single one is seen.
    """
    return rrb.TimeSeriesView(
        origin="/",
        contents=[f"+ {path}" for path in paths.values()],
        name=name,
        axis_x=times(recent_secs),
        axis_y=axis,
        plot_legend=_legend(len(paths)),
        overrides={path: _series(block, index, dots) for index, (block, path) in enumerate(paths.items())},
    )


def _series(block: str, index: int, dots: bool) -> list[rr.SeriesLines | rr.SeriesPoints]:
    shade = colours([of_index(index)])
    line = rr.SeriesLines(names=[block], colors=shade)
    if not dots:
        return [line]
    return [line, rr.SeriesPoints(names=[block], colors=shade, markers=["circle"], marker_sizes=[4.0])]


def times(recent_secs: int | None) -> rrb.TimeAxis:
    """From so long before the cursor, or from the beginning, to the cursor."""
    start = rr.TimeRangeBoundary.infinite()
    if recent_secs is not None:
        start = rr.TimeRangeBoundary.cursor_relative(seconds=-recent_secs)
    return rrb.TimeAxis(view_range=rr.TimeRange(start=start, end=rr.TimeRangeBoundary.cursor_relative()))


def ago(recent_secs: int | None) -> str:
    """What a title says of so short a past."""
    return "" if recent_secs is None else f", last {recent_secs // 60} min"


def _legend(lines: int = 1) -> rrb.PlotLegend:
    """One for so many lines; none where it would hide them."""
    return rrb.PlotLegend(corner=rrb.Corner2D.LeftTop, visible=None if lines <= MOST_NAMED else False)
