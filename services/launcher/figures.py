"""The figures of a report, drawn without a display, in Okabe and Ito's colours for colour-blind eyes."""

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.colors import ListedColormap, to_hex
from matplotlib.figure import Figure
from numpy.typing import NDArray

from babble.worlds.geometry import Body, CuboidBody, DumbbellBody, EllipsoidBody
from services.runtime.checkpoint import write_atomically

Array = NDArray[Any]

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#F0E442", "#000000")
"""Of the vertices, as long as they last."""
MARKERS = "osD^vP*X"
GREY = "#777777"
DPI = 110
MOST_NAMED = len(COLOURS)
"""More vertices are not named one by one in a legend, but by their number where they are."""
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

    def cut(self, components: Array) -> "Ends":
        """The same of some components of the posture alone."""
        return replace(
            self,
            posture=self.posture[:, components],
            way=self.way[..., components],
            first_way=self.first_way[..., components],
        )


def vertex_colours(count: int) -> Sequence[str]:
    """A colour per vertex: of more than there are names for, the hues of a rainbow, told apart by numbers."""
    if count <= len(COLOURS):
        return COLOURS[:count]
    return [to_hex(colour) for colour in colormaps["turbo"](np.linspace(0.04, 0.96, count))]


def marker(vertex: int) -> str:
    """The marker of a vertex; after eight they come round again."""
    return MARKERS[vertex % len(MARKERS)]


def picture(name: str, caption: str) -> list[str]:
    """The lines of a report that show a figure of the run."""
    return [f"![{caption}](figures/{name}.png)", "", f"*{caption}*", ""]


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG, whole or not at all. Raises `StorageError`."""
    drawn = io.BytesIO()
    figure.savefig(drawn, format="png", dpi=DPI)
    write_atomically(path, drawn.getvalue())


def draw_world(path: Path, body: Body, ends: Ends, title: str) -> None:
    """The body as a wire frame, the points reached per goal, and some ways there."""
    figure = Figure(figsize=(8, 4.8))
    axes: Any = figure.add_axes((0.0, 0.12, 1.0, 0.84), projection="3d")
    _wire(axes, body)
    colours, named = vertex_colours(ends.latent_dim), ends.latent_dim <= MOST_NAMED
    for goal, colour in enumerate(colours):
        legs = np.flatnonzero(ends.goal == goal)
        for way in ends.way[legs[:TRAJECTORIES]]:
            axes.plot(*way.T, color=colour, linewidth=1.5)
        for way in ends.first_way[ends.first_goal == goal][:TRAJECTORIES]:
            axes.plot(*way.T, color=colour, linewidth=1.2, linestyle=":")
            axes.plot(*way[:1].T, marker=".", color=colour, markersize=5)
        style = {"color": colour, "marker": marker(goal), "edgecolors": "white", "linewidths": 0.5}
        label = f"ends, goal {goal}" if named else None
        axes.scatter(*ends.posture[legs].T, s=70, depthshade=False, label=label, **style)
        if len(legs) and not named:
            axes.text(*ends.posture[legs].mean(axis=0), str(goal), zorder=9)
    axes.plot([], [], [], color=GREY, linewidth=1.5, label="way between ends")
    axes.plot([], [], [], ":.", color=GREY, linewidth=1.2, label="way from a random start")
    axes.set_box_aspect(body.extent / body.extent.max(), zoom=1.38)
    for artist in (*axes.lines, *axes.collections):
        artist.set_clip_on(False)
    _space(axes, body)
    axes.view_init(elev=24, azim=-62)
    figure.suptitle(title, y=0.97)
    figure.legend(*axes.get_legend_handles_labels(), loc="lower center", ncols=4, frameon=False)
    save(figure, path)


def draw_latent(path: Path, body: Body, points: Array, latent: Array, title: str) -> None:
    """The latents (N, d) of uniform points (N, 3) in two slices, and where each component is largest."""
    reach = body.extent
    figure = Figure(figsize=(7.2, 5.6), layout="compressed")
    panels = figure.subplots(2, 1, sharex=True, height_ratios=reach[1:].tolist())
    colours, value, meaning = latent_colours(latent)
    named = vertex_colours(latent.shape[1])
    for axes, (up, through) in zip(panels, ((1, 2), (2, 1)), strict=True):
        thin = np.abs(points[:, through]) < SLAB * reach[through]
        drawn = axes.scatter(*points[thin][:, [0, up]].T, c=value[thin], s=9, linewidths=0, **colours)
        for vertex, index in enumerate(latent.argmax(axis=0)):
            style = {"color": named[vertex], "markersize": 11, "markeredgecolor": "white", "clip_on": False}
            label = f"largest $z_{{{vertex}}}$ of all points" if len(named) <= MOST_NAMED else None
            axes.plot(points[index, 0], points[index, up], marker(vertex), label=label, **style)
        axes.set(xlim=(-1.05 * reach[0], 1.05 * reach[0]), ylim=(-1.1 * reach[up], 1.1 * reach[up]))
        axes.set_aspect("equal")
        axes.locator_params(nbins=5)
        axes.set_title(f"slice |{AXES[through]}| < {SLAB * reach[through]:.2f}", fontsize=10)
        axes.set_ylabel(f"{AXES[up]} (world units)")
    panels[1].set_xlabel("x (world units)")
    ticks = None if latent.shape[1] == 2 else list(range(0, latent.shape[1], 1 + latent.shape[1] // 20))
    figure.colorbar(drawn, ax=list(panels), shrink=0.8, ticks=ticks).set_label(meaning)
    figure.suptitle(title)
    handles, labels = panels[0].get_legend_handles_labels()
    if handles:
        figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(labels)), frameon=False)
    save(figure, path)


def latent_colours(latent: Array) -> tuple[dict[str, Any], Array, str]:
    """A colour scale, the values for it, and what they mean: z_0, or the vertex for more than two."""
    vertices = latent.shape[1]
    if vertices == 2:
        return {"cmap": "cividis", "vmin": 0, "vmax": 1}, latent[:, 0], "latent component $z_0$"
    colours = ListedColormap(list(vertex_colours(vertices)))
    scale = {"cmap": colours, "vmin": -0.5, "vmax": vertices - 0.5}
    return scale, latent.argmax(axis=1), "vertex with the largest component"


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
