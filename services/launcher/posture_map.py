"""The latent over a plane of postures, for bodies: what the encoder makes of them, and where goals lead."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.launcher.figures import (
    MOST_NAMED,
    TRAJECTORIES,
    Ends,
    latent_colours,
    marker,
    save,
    vertex_colours,
)

Floats = NDArray[Any]

CELLS = 61
"""Along each side of the map."""
MOST_VISITED = 6000
"""Postures on the way, of which a plane is found and which are drawn where the body cannot be posed."""
MOST_WAYS = 12
"""From random starts, of all goals together; of each goal one at least."""
PALE = 0.75
"""A cell of more than two vertices is the paler, the less its largest component is."""
EMPTY = 1e-9
BESIDE = 1.06
"""The map reaches so far beyond what was visited."""


@dataclass(frozen=True)
class Plane:
    """A plane in the space of postures, with coordinates in its lengths."""

    centre: Floats
    """(p,)"""
    axes: Floats
    """(2, p) of length 1, at right angles; the second is 0 where postures have one number"""
    held: float
    """the share of the spread of the goals' mean ends that is in the plane"""

    def of(self, postures: Floats) -> Floats:
        """(..., p) -> (..., 2) their shadows on the plane."""
        return (postures - self.centre) @ self.axes.T

    def at(self, place: Floats) -> Floats:
        """(..., 2) -> (..., p)"""
        return self.centre + place @ self.axes


@dataclass(frozen=True)
class Map:
    """Latents on a plane: of all of it, or of what was visited."""

    plane: Plane
    place: Floats
    """(N, 2)"""
    latent: Floats
    """(N, d); NaN where no posture is within the joints' limits"""
    across: tuple[int, int] | None
    """(rows, columns) of a map of all cells; None of visited places"""
    reach: tuple[float, float, float, float]
    """left, right, bottom, top"""


def plane_of(ends: Ends, visited: Floats) -> Plane:
    """The plane through the goals' mean ends; where they fill less than one, also along what was visited.

    With more than three goals the plane that holds most of their spread.
    """
    goals = np.unique(ends.goal)
    means = np.stack([ends.posture[ends.goal == goal].mean(axis=0) for goal in goals]).astype(np.float64)
    centre = means.mean(axis=0)
    _, spread, found = np.linalg.svd(means - centre, full_matrices=False)
    axes = [axis for axis, size in zip(found, spread, strict=True) if size > EMPTY][:2]
    if len(axes) < 2:
        left = visited.reshape(-1, visited.shape[-1]).astype(np.float64) - centre
        for axis in axes:
            left = left - np.outer(left @ axis, axis)
        _, sizes, more = np.linalg.svd(left - left.mean(axis=0), full_matrices=False)
        axes += [axis for axis, size in zip(more, sizes, strict=True) if size > EMPTY][: 2 - len(axes)]
    axes += [np.zeros(len(centre))] * (2 - len(axes))
    whole = float((spread**2).sum())
    held = float((spread[:2] ** 2).sum()) / whole if whole > EMPTY else 1.0
    return Plane(centre, np.stack(axes), held)


def cells(plane: Plane, ends: Ends, visited: Floats) -> tuple[Floats, tuple[float, float, float, float]]:
    """(CELLS * CELLS, 2) places that cover what was visited and where goals lead; and how far they reach."""
    shadows = plane.of(np.concatenate([visited, ends.posture]))
    middle = (shadows.max(axis=0) + shadows.min(axis=0)) / 2
    half = BESIDE * np.maximum(np.ptp(shadows, axis=0) / 2, 0.05)
    (left, bottom), (right, top) = middle - half, middle + half
    grid = np.meshgrid(np.linspace(left, right, CELLS), np.linspace(bottom, top, CELLS))
    return np.stack(grid, axis=-1).reshape(-1, 2), (left, right, bottom, top)


def draw_map(path: Path, drawn: Map, ends: Ends, title: str) -> None:
    """The map, the ends of each goal on it, and some ways there from random starts."""
    figure = Figure(figsize=(7.4, 6.0), layout="compressed")
    axes: Any = figure.subplots()
    vertices = drawn.latent.shape[1]
    scale, value, meaning = latent_colours(np.nan_to_num(drawn.latent))
    if drawn.across is None:
        shown = axes.scatter(*drawn.place.T, c=value, s=7, linewidths=0, **scale)
    else:
        shown = axes.imshow(
            _coloured(drawn, value, vertices),
            origin="lower",
            extent=drawn.reach,
            aspect="auto",
            interpolation="nearest",
            **scale,
        )
    _ways(axes, drawn.plane, ends)
    ticks = None if vertices == 2 else list(range(0, vertices, 1 + vertices // 20))
    figure.colorbar(shown, ax=axes, shrink=0.8, ticks=ticks).set_label(
        meaning if vertices == 2 or drawn.across is None else f"{meaning} (paler: it is smaller)"
    )
    axes.set(xlim=drawn.reach[:2], ylim=drawn.reach[2:])
    axes.set_xlabel("first axis of the plane (half ranges of joints)")
    if drawn.plane.axes[1].any():
        axes.set_aspect("equal", adjustable="box")
        axes.set_ylabel("second axis")
    else:
        axes.set_yticks([])
    figure.suptitle(title)
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, frameon=False)
    save(figure, path)


def _coloured(drawn: Map, value: Floats, vertices: int) -> Floats:
    """(rows, columns) of values for the colour scale, or (rows, columns, 4) of colours for many vertices."""
    assert drawn.across is not None
    nowhere = np.isnan(drawn.latent).any(axis=1)
    if vertices == 2:
        return np.where(nowhere, np.nan, value).reshape(drawn.across)
    palette = np.array([to_rgb(colour) for colour in vertex_colours(vertices)])
    largest = np.nan_to_num(drawn.latent).max(axis=1)
    strength = 1 - PALE + PALE * (largest - 1 / vertices) / (1 - 1 / vertices)
    colours = 1 - (1 - palette[value]) * np.clip(strength, 0, 1)[:, None]
    return np.column_stack([colours, ~nowhere]).reshape(*drawn.across, 4)


def _ways(axes: Any, plane: Plane, ends: Ends) -> None:
    named, shown = ends.latent_dim <= MOST_NAMED, max(1, min(TRAJECTORIES, MOST_WAYS // ends.latent_dim))
    for vertex, colour in enumerate(vertex_colours(ends.latent_dim)):
        for way in ends.first_way[ends.first_goal == vertex][:shown]:
            place = plane.of(way)
            axes.plot(*place.T, color="white", linewidth=2.6, zorder=2)
            axes.plot(*place.T, color=colour, linewidth=1.2, zorder=3)
            axes.plot(*place[:1].T, "o", color=colour, markeredgecolor="white", markersize=5, zorder=3)
        reached = plane.of(ends.posture[ends.goal == vertex])
        style = {"color": colour, "marker": marker(vertex), "edgecolors": "white", "linewidths": 1.0}
        label = f"ends, goal {vertex}" if named else None
        axes.scatter(*reached.T, s=90, zorder=4, label=label, **style)
        if len(reached) and not named:
            axes.annotate(str(vertex), reached.mean(axis=0), fontsize=9, zorder=5)
    axes.plot([], [], "o-", color="#555555", markersize=5, label="way from a random start")
