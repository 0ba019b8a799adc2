"""Figures of bodies with joints: the postures reached per goal, and the latent on the way."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from services.launcher.figures import (
    GREY,
    MOST_NAMED,
    TRAJECTORIES,
    Ends,
    marker,
    save,
    vertex_colours,
)

Array = NDArray[Any]

MOST_STRIPS = 16
"""With more joints the ends are drawn as a map of means: strips would be too thin to read."""
MOST_STRIP_GOALS = 8
"""Nor are there strips for more goals than this in so many joints."""
MOST_DOTS = 64
"""Ends drawn per goal."""
LABEL_CHARS = 24
LIMITS = ("lower limit", "middle", "upper limit")
JITTER = 0.3
"""How wide the dots of one strip spread, as a share of its width."""


def draw_postures(path: Path, ends: Ends, names: Sequence[str], title: str) -> None:
    """Where each joint ended per goal, from -1 (lower limit) to 1; `names` of the joints, if known."""
    joints, few = ends.posture.shape[1], is_few(ends)
    size = (min(3.0 + 0.75 * joints, 12.0), 4.8) if few else (12.0, 3.8 + 0.35 * ends.latent_dim)
    figure = Figure(figsize=size, layout="constrained")
    axes: Any = figure.subplots()
    if few:
        strips(axes, ends)
        legend = axes.get_legend_handles_labels()
        figure.legend(*legend, loc="outside lower center", ncols=min(ends.latent_dim, 4), frameon=False)
    else:
        means(figure, axes, ends)
    known = len(names) == joints
    labels = short_names(names) if known else [str(joint) for joint in range(joints)]
    turned = 90 if known or not few else 0
    axes.set_xticks(range(joints), labels, rotation=turned, fontsize=9 if few else 6)
    axes.set_xlabel("joint")
    figure.suptitle(title)
    save(figure, path)


def is_few(ends: Ends) -> bool:
    """Whether there is room for a strip per joint and goal."""
    joints = ends.posture.shape[1]
    return joints <= MOST_STRIPS and joints * ends.latent_dim <= MOST_STRIPS * MOST_STRIP_GOALS


def draw_way(path: Path, latent: Array, goal: Array, title: str, env_steps_per_row: int = 1) -> None:
    """The latents (T, E, d) of some columns on their legs to `goal` (L, E); one panel per column.

    A latent is that of an action which is held for `env_steps_per_row` environment steps.
    """
    steps, columns = len(latent), min(TRAJECTORIES, latent.shape[1])
    leg_steps = steps // len(goal) * env_steps_per_row
    place = env_steps_per_row * np.arange(steps)
    figure = Figure(figsize=(9.0, 1.2 + 1.5 * columns), layout="constrained")
    panels = figure.subplots(columns, 1, sharex=True, squeeze=False)[:, 0]
    colours = vertex_colours(latent.shape[2])
    for column, axes in enumerate(panels):
        for leg, vertex in enumerate(goal[:, column]):
            axes.axvspan(
                leg * leg_steps, (leg + 1) * leg_steps, color=colours[vertex], alpha=0.15, linewidth=0
            )
        for vertex in range(latent.shape[2]):
            label = f"$z_{{{vertex}}}$"
            if latent.shape[2] <= MOST_NAMED:
                label += f"; shaded while goal {vertex} holds"
            axes.plot(place, latent[:, column, vertex], color=colours[vertex], linewidth=1.2, label=label)
        axes.set(ylim=(-0.02, 1.02), xlim=(0, steps * env_steps_per_row), ylabel="latent")
    panels[-1].set_xlabel("environment step")
    figure.suptitle(title)
    handles, labels = panels[0].get_legend_handles_labels()
    columns = min(3 if len(labels) <= MOST_NAMED else 8, len(labels))
    figure.legend(handles, labels, loc="outside lower center", ncols=columns, frameon=False)
    save(figure, path)


def strips(axes: Any, ends: Ends) -> None:
    """One strip per joint and goal, a dot per leg."""
    joints = ends.posture.shape[1]
    rng, width = np.random.default_rng(0), 0.8 / ends.latent_dim
    colours = vertex_colours(ends.latent_dim)
    for goal in range(ends.latent_dim):
        reached = ends.posture[ends.goal == goal][:MOST_DOTS]
        centre = np.arange(joints) + (goal - (ends.latent_dim - 1) / 2) * width
        place = centre + rng.uniform(-JITTER, JITTER, reached.shape) * width
        style = {"color": colours[goal], "marker": marker(goal), "linewidths": 0.3, "edgecolors": "white"}
        axes.scatter(place, reached, s=16, alpha=0.8, label=f"goal {goal}", zorder=3, **style)
    for border in np.arange(joints - 1) + 0.5:
        axes.axvline(border, color=GREY, linewidth=0.4, alpha=0.5)
    axes.set(xlim=(-0.5, joints - 0.5), ylim=(-1.08, 1.08), ylabel="place in the joint's range")
    axes.set_yticks([-1, 0, 1], LIMITS)
    axes.grid(axis="y", alpha=0.3)


def means(figure: Figure, axes: Any, ends: Ends) -> None:
    """The mean end of each joint (columns) per goal (rows)."""
    nothing = np.full(ends.posture.shape[1], np.nan)
    rows = [
        mine.mean(axis=0) if len(mine := ends.posture[ends.goal == goal]) else nothing
        for goal in range(ends.latent_dim)
    ]
    drawn = axes.imshow(rows, cmap="cividis", vmin=-1, vmax=1, aspect="auto", interpolation="nearest")
    axes.set_yticks(range(ends.latent_dim), [f"goal {goal}" for goal in range(ends.latent_dim)])
    bar = figure.colorbar(drawn, ax=axes, ticks=[-1, 0, 1], pad=0.01)
    bar.ax.set_yticklabels(LIMITS)


def short_names(names: Sequence[str]) -> list[str]:
    """Names without what all of them begin with; of a long one the end, for there they differ."""
    parts = [re.split(r"(?<=[:_/])", name) for name in names]
    while all(len(each) > 1 and each[0] == parts[0][0] for each in parts):
        parts = [each[1:] for each in parts]
    short = map("".join, parts)
    return [name if len(name) <= LABEL_CHARS else f"…{name[1 - LABEL_CHARS :]}" for name in short]
