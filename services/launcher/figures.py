"""The figures of a report, drawn without a display, in Okabe and Ito's colours for colour-blind eyes."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from babble.scores import REACHED
from babble.worlds.geometry import Body, CuboidBody, DumbbellBody, EllipsoidBody
from protocol.messages import Score

Array = NDArray[Any]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
MOST_VERTICES = len(COLOURS)
"""More vertices than colours are not drawn."""
MARKERS = "osD^vP*X"
GREY = "#777777"
DPI = 110
TRAJECTORIES = 3
"""Columns whose way is drawn."""
MAP_POINTS = 12_000
SLAB = 0.25
"""A slice of the latent map holds the points within this share of the body's half size."""
AXES = "xyz"


@dataclass(frozen=True)
class Ends:
    """Where legs to each goal ended in fresh worlds, and the ways there."""

    goal: Array
    """(K,) the vertex of each leg but the first"""
    posture: Array
    """(K, p) where it ended"""
    way: Array
    """(K, T + 1, p) all of its postures"""
    first_goal: Array
    """(E,) the vertex of the first leg"""
    first_way: Array
    """(E, T + 1, p) the postures of the first leg, from a random start"""
    latent_dim: int


@dataclass(frozen=True)
class Curve:
    """A measure over the run's time, in pieces that belong together (one fit, one practise)."""

    title: str
    label: str
    pieces: Sequence[tuple[Sequence[float], Sequence[float]]]
    """(seconds since the start, value)"""


def draw_world(path: Path, body: Body, ends: Ends, title: str) -> None:
    """The body as a wire frame, the points reached per goal, and some ways there."""
    figure = Figure(figsize=(8, 4.8))
    axes: Any = figure.add_axes((0.0, 0.12, 1.0, 0.84), projection="3d")
    _wire(axes, body)
    for goal in range(ends.latent_dim):
        legs = np.flatnonzero(ends.goal == goal)
        colour = COLOURS[goal]
        for way in ends.way[legs[:TRAJECTORIES]]:
            axes.plot(*way.T, color=colour, linewidth=1.5)
        for way in ends.first_way[ends.first_goal == goal][:TRAJECTORIES]:
            axes.plot(*way.T, color=colour, linewidth=1.2, linestyle=":")
            axes.plot(*way[:1].T, marker=".", color=colour, markersize=5)
        style = {"color": colour, "marker": MARKERS[goal], "edgecolors": "white", "linewidths": 0.5}
        label = f"ends, goal {goal}"
        axes.scatter(*ends.posture[legs].T, s=70, depthshade=False, label=label, **style)
    axes.plot([], [], [], color=GREY, linewidth=1.5, label="way between ends")
    axes.plot([], [], [], ":.", color=GREY, linewidth=1.2, label="way from a random start")
    axes.set_box_aspect(body.extent / body.extent.max(), zoom=1.38)
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)
    _space(axes, body)
    axes.view_init(elev=24, azim=-62)
    figure.suptitle(title, y=0.97)
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncols=4, frameon=False)
    figure.savefig(path, dpi=DPI)


def draw_latent(path: Path, body: Body, points: Array, latent: Array, title: str) -> None:
    """The latents (N, d) of uniform points (N, 3) in two slices, and where each component is largest."""
    reach = body.extent
    figure = Figure(figsize=(7.2, 5.6), layout="compressed")
    panels = figure.subplots(2, 1, sharex=True, height_ratios=reach[1:].tolist())
    colours, value, meaning = _latent_colours(latent)
    for axes, (up, through) in zip(panels, ((1, 2), (2, 1)), strict=True):
        thin = np.abs(points[:, through]) < SLAB * reach[through]
        drawn = axes.scatter(*points[thin][:, [0, up]].T, c=value[thin], s=9, linewidths=0, **colours)
        for vertex, index in enumerate(latent.argmax(axis=0)):
            style = {"color": COLOURS[vertex], "markersize": 11, "markeredgecolor": "white", "clip_on": False}
            label = f"largest $z_{{{vertex}}}$ of all points"
            axes.plot(points[index, 0], points[index, up], MARKERS[vertex], label=label, **style)
        axes.set(xlim=(-1.05 * reach[0], 1.05 * reach[0]), ylim=(-1.1 * reach[up], 1.1 * reach[up]))
        axes.set_aspect("equal")
        axes.locator_params(nbins=5)
        axes.set_title(f"slice |{AXES[through]}| < {SLAB * reach[through]:.2f}", fontsize=10)
        axes.set_ylabel(f"{AXES[up]} (world units)")
    panels[1].set_xlabel("x (world units)")
    ticks = None if latent.shape[1] == 2 else list(range(latent.shape[1]))
    figure.colorbar(drawn, ax=list(panels), shrink=0.8, ticks=ticks).set_label(meaning)
    figure.suptitle(title)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)), frameon=False)
    figure.savefig(path, dpi=DPI)


def _latent_colours(latent: Array) -> tuple[dict[str, Any], Array, str]:
    """A colour scale, the values for it, and what they mean: z_0, or the vertex for more than two."""
    vertices = latent.shape[1]
    if vertices == 2:
        return {"cmap": "cividis", "vmin": 0, "vmax": 1}, latent[:, 0], "latent component $z_0$"
    colours = ListedColormap(COLOURS[:vertices])
    scale = {"cmap": colours, "vmin": -0.5, "vmax": vertices - 0.5}
    return scale, latent.argmax(axis=1), "vertex with the largest component"


def draw_learning(
    path: Path, rows: Sequence[Score], best: int | None, curves: Sequence[Curve], title: str
) -> None:
    """Scores by iteration with their bar, and beside them the curves, if there are any."""
    panels = 1 + len(curves)
    figure = Figure(figsize=(5.2 if panels == 1 else min(3.9 * panels, 12.6), 3.9), layout="constrained")
    first, *others = figure.subplots(1, panels, squeeze=False)[0]
    _scores(first, rows, best)
    for axes, curve, colour in zip(others, curves, COLOURS, strict=False):
        for seconds, values in curve.pieces:
            axes.plot(seconds, values, "o-", color=colour, markersize=3, linewidth=1.2)
        axes.set_title(curve.title, fontsize=10)
        axes.set_xlabel("time since the start (s)")
        axes.set_ylabel(curve.label)
        axes.grid(alpha=0.3)
    figure.suptitle(title)
    figure.legend(
        *first.get_legend_handles_labels(),
        loc="outside lower center",
        ncols=2 if panels == 1 else 4,
        frameon=False,
    )
    figure.savefig(path, dpi=DPI)


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
            face = colour if policy == "mean" else "white"
            axes.plot(
                iterations,
                values,
                line,
                marker=marker,
                color=colour,
                markerfacecolor=face,
                label=f"{measure}, {policy} actions",
            )
    axes.axhline(REACHED, color=GREY, linewidth=1, linestyle="--", label=f"bar of success, {REACHED}")
    if best is not None:
        axes.axvspan(best - 0.2, best + 0.2, color=GREY, alpha=0.18, linewidth=0, label="best iteration")
    axes.set_ylim(max(0.0, lowest - 0.1), 1.03)
    axes.set_xticks(sorted({row.iteration for row in rows}))
    axes.set_title("scores from random starts", fontsize=10)
    axes.set_xlabel("iteration (0: after GROUND)")
    axes.set_ylabel("score (no unit)")
    axes.grid(alpha=0.3)


def _value(row: Score, measure: str) -> float:
    value: float = row.landmarks[measure] if measure in row.landmarks else getattr(row, measure)
    return value


def _space(axes: Any, body: Body) -> None:
    for axis, reach in zip(AXES, body.extent, strict=True):
        getattr(axes, f"set_{axis}lim")(-reach, reach)
        getattr(axes, f"set_{axis}label")(f"{axis} (world units)", labelpad=2)
        ticks = [-reach, 0, reach] if reach < 0.5 * body.extent.max() else np.linspace(-reach, reach, 5)
        getattr(axes, f"set_{axis}ticks")(ticks, [f"{tick:.2g}" for tick in ticks])
        axes.tick_params(axis=axis, labelsize=8)


def _wire(axes: Any, body: Body) -> None:
    style: Mapping[str, Any] = {"color": GREY, "linewidth": 0.5, "alpha": 0.55}
    if isinstance(body, CuboidBody):
        for corner in np.array(np.meshgrid(*[[-1, 1]] * 3)).reshape(3, -1).T:
            for axis in np.flatnonzero(corner < 0):
                edge = np.stack([corner, np.where(np.arange(3) == axis, 1, corner)]) * body.extent
                axes.plot(*edge.T, color=GREY, linewidth=1)
        return
    along, around = np.meshgrid(np.linspace(-1, 1, 41), np.linspace(0, 2 * np.pi, 25))
    if isinstance(body, EllipsoidBody):
        angle = along * np.pi / 2
        sphere = [np.sin(angle), np.cos(angle) * np.cos(around), np.cos(angle) * np.sin(around)]
        grid = [part * half for part, half in zip(sphere, body.extent, strict=True)]
    elif isinstance(body, DumbbellBody):
        x = along * body.extent[0]
        lobe = np.sqrt(np.maximum(body.lobe_radius**2 - (np.abs(x) - body.lobe_centre) ** 2, 0.0))
        radius = np.where(np.abs(x) < body.lobe_centre, np.maximum(lobe, body.bridge_radius), lobe)
        grid = [x, radius * np.cos(around), radius * np.sin(around)]
    else:
        return
    axes.plot_wireframe(*grid, rstride=3, cstride=2, **style)
