"""The body as it stands where each goal leads, as in the thesis's figures 4.2 and 4.3: a row per vertex."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from babble.worlds.physics.world import MujocoWorld
from services.launcher.bodies import pictures, postures_in
from services.launcher.evaluate import Rollout
from services.launcher.figures import GREY, save, vertex_colours

Pixels = NDArray[np.uint8]

POSES = {2: 4, 3: 4, 4: 4, 5: 3, 6: 3, 7: 2, 8: 2}
"""By the number of vertices, so many poses each; of more vertices one each."""
MOST_VERTICES = 32
"""Of more, the first are pictured."""
COLUMNS = 8
"""Of pictures, where there is one pose per vertex."""
SAME = 1e-3
"""A posture as far as this from another is the same."""
BACKGROUND = 12
"""Colours (0..255) that differ less from the background are background."""
MARGIN = 0.06
ROW_INCHES, WIDEST_INCHES = 2.1, 12.0


@dataclass(frozen=True)
class Reached:
    """An end of a leg that is pictured."""

    vertex: int
    leg: int
    column: int
    z: float
    """the vertex's component of the latent there"""


def choose(rollout: Rollout, block: str, same: NDArray[np.bool_]) -> list[list[Reached]]:
    """By vertex that was a goal: its most typical end, then ends of others' first legs, from random starts.

    `same` (L, E) says whose state is still that of the leg's end. Vertices without one are left out.
    """
    legs = rollout.legs[block]
    poses = POSES.get(legs.latent.shape[2], 1)
    chosen = []
    for vertex in range(min(legs.latent.shape[2], MOST_VERTICES)):
        there = np.argwhere((legs.goal == vertex) & same)
        if not len(there):
            continue
        posture = legs.posture[there[:, 0], there[:, 1]][:, rollout.parts[block].components]
        order = np.linalg.norm(posture - posture.mean(axis=0), axis=1).argsort(kind="stable")
        typical = there[order[0]]
        others = [place for place in there.tolist() if place[1] != typical[1]]
        distinct = {column: (leg, column) for leg, column in reversed(others)}
        random_starts = sorted(distinct.values())[: poses - 1]
        chosen.append(
            [
                Reached(vertex, int(leg), int(column), float(legs.latent[leg, column, vertex]))
                for leg, column in [typical.tolist(), *random_starts]
            ]
        )
    return chosen


def draw_reached(path: Path, rollout: Rollout, block: str, world: MujocoWorld, title: str) -> bool:
    """Pictures of the ends of a block's legs; false if there is none whose state is known.

    Raises `RendererError` where nothing can be drawn, `StorageError`.
    """
    states, legs = rollout.states, rollout.legs[block]
    assert states is not None, "a simulated body has states"
    flat = postures_in(world, states.reshape(-1, states.shape[2])).reshape(legs.posture.shape)
    chosen = choose(rollout, block, np.abs(flat - legs.posture).max(axis=2) < SAME)
    if not chosen:
        return False
    ends = [end for row in chosen for end in row]
    drawn = cropped(list(pictures(world, np.stack([states[end.leg, end.column] for end in ends]))))
    colours = vertex_colours(legs.latent.shape[2])
    _arrange(path, chosen, drawn, colours, title)
    return True


def cropped(images: Sequence[Pixels]) -> list[Pixels]:
    """All images cut to what is in any of them, as far as they have one plain background."""
    stack = np.stack(images).astype(np.int16)
    border = np.concatenate([stack[:, 0], stack[:, -1], stack[:, :, 0], stack[:, :, -1]], axis=1)
    if np.ptp(border, axis=(0, 1)).max() > BACKGROUND:
        return list(images)
    matter = (np.abs(stack - stack[0, 0, 0]) > BACKGROUND).any(axis=(0, 3))
    rows, columns = np.flatnonzero(matter.any(axis=1)), np.flatnonzero(matter.any(axis=0))
    if not len(rows):
        return list(images)
    margin = int(MARGIN * len(matter))
    top, bottom = max(0, rows[0] - margin), rows[-1] + margin + 1
    left, right = max(0, columns[0] - margin), columns[-1] + margin + 1
    return [image[top:bottom, left:right] for image in images]


def _arrange(
    path: Path,
    chosen: Sequence[Sequence[Reached]],
    drawn: Sequence[Pixels],
    colours: Sequence[str],
    title: str,
) -> None:
    poses = max(map(len, chosen))
    single = poses == 1
    columns = min(COLUMNS, len(chosen)) if single else poses
    rows = -(-len(chosen) // columns) if single else len(chosen)
    height, width = drawn[0].shape[:2]
    row_inches = min(ROW_INCHES, (WIDEST_INCHES - 1) / columns * height / width)
    side = 0.55
    size = (side + columns * (row_inches * width / height + 0.08), 0.85 + rows * (row_inches + 0.3))
    figure = Figure(figsize=(max(size[0], 4.2), size[1]))
    grid = figure.subplots(rows, columns, squeeze=False)
    figure.subplots_adjust(
        left=side / size[0], right=1 - 0.05 / size[0], bottom=0.3 / size[1], top=1 - 0.85 / size[1],
        wspace=0.04, hspace=0.3 / row_inches,
    )  # fmt: skip
    for axes in grid.ravel():
        axes.set_axis_off()
    images = iter(drawn)
    for index, row in enumerate(chosen):
        for place, end in enumerate(row):
            axes = grid[divmod(index, columns)] if single else grid[index, place]
            _show(axes, next(images), end, colours[end.vertex], first=place == 0, single=single)
    if not single:
        for place, axes in enumerate(grid[0]):
            axes.set_title("most typical" if place == 0 else f"random start {place}", fontsize=9, color=GREY)
    figure.suptitle(title, fontsize=11)
    save(figure, path)


def _show(axes: Any, image: Pixels, end: Reached, colour: str, *, first: bool, single: bool) -> None:
    axes.imshow(image, interpolation="antialiased")
    axes.set_axis_on()
    axes.set(xticks=[], yticks=[])
    for edge in axes.spines.values():
        edge.set(color=colour, linewidth=2.5 if first else 1.0)
    goal = f"goal {end.vertex}, " if single else ""
    axes.set_xlabel(f"{goal}$z_{{{end.vertex}}}$ = {end.z:.2f}", fontsize=9, labelpad=3)
    if first and not single:
        axes.set_ylabel(f"goal {end.vertex}", fontsize=12, color=colour, fontweight="bold")
