"""What a block of a run found, rolled out in fresh worlds: in words, for the report."""

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from babble.worlds import World
from babble.worlds.batch import PointWorld
from protocol.messages import Score
from services.launcher.evaluate import Rollout
from services.launcher.judging import shortfalls
from services.launcher.scored_run import Run, Version

if TYPE_CHECKING:
    from services.launcher.figures import Ends

PLACES = {
    "Cuboid": "both ends of the long diagonal",
    "Ellipsoid": "both ends of the long axis",
    "Dumbbell": "the outer ends of both lobes",
}
"""What a Composer with two vertices should find (thesis 4.1)."""
AXES = "xyz"
MOST_NUMBERS = 8
"""A posture of more numbers is told by their range."""


def verdict(run: Run, version: Version, rows: Iterable[Score]) -> str:
    """Whether the iteration is a success, by the rows measured during the run."""
    row = next(row for row in rows if row.iteration == version.iteration)
    missing = shortfalls(row)
    place = _sought(run, version, row)
    found = "were found" if not missing else "were not found"
    crossed = {} if row.crossing is None else {"crossing": row.crossing}
    numbers = {"separation": row.separation, "z_min": row.z_min, **crossed, **row.landmarks}
    measured = ", ".join(f"{name} {value:.2f}" for name, value in numbers.items())
    which = "best" if run.best.get(version.block) == version.iteration else "newest"
    kept = f"The {which} iteration is {version.iteration} ({measured}, {row.policy} actions)"
    sentence = f"{place[0].upper()}{place[1:]} {found}"
    why = f": {', '.join(missing)}" if missing else ""
    return f"**{sentence}{why}.** {kept}."


def in_words(rollout: Rollout, version: Version, world: World) -> list[str]:
    """Where each goal of a block ends in fresh worlds; `world` has one copy."""
    ends = ends_of(rollout, version.block)
    (anew,) = [row for row in rollout.scores() if row.block == version.block]
    return [
        f"In {rollout.path.shape[1]} fresh worlds, from random starts and with mean actions:",
        "",
        *_places(rollout, version.block, ends, world),
        *_named(anew),
        "",
        f"Scores of these rollouts: separation {anew.separation:.3f}, z_min {anew.z_min:.3f}.",
    ]


def _sought(run: Run, version: Version, row: Score) -> str:
    if row.landmarks:
        return f"the postures {' and '.join(row.landmarks)}"
    if run.settings.one_block(version.block).latent_dim > 2:
        return "places far apart, one per goal,"
    if version.block not in run.settings.levels[-1]:
        return "two places far apart of what it moves"
    apart = "two places far apart" if row.crossing is None else "two goals on opposite sides"
    return PLACES.get(run.settings.world.id, apart)


def _places(rollout: Rollout, block: str, ends: "Ends", world: World) -> list[str]:
    """Where the goals end, and how far apart; goals that no leg had are left out."""
    part = rollout.parts[block]
    ends = ends.cut(part.components)
    means = {
        goal: ends.posture[ends.goal == goal].mean(axis=0)
        for goal in range(ends.latent_dim)
        if (ends.goal == goal).any()
    }
    lines = []
    for goal, mean in means.items():
        off = float(np.linalg.norm(ends.posture[ends.goal == goal] - mean, axis=1).mean())
        place = _posture(mean, world, part.components)
        lines.append(f"- goal {goal} ends at {place}, on average within {off:.2f} of it")
    for one, other in itertools.combinations(means, 2):
        apart = float(np.linalg.norm(means[one] - means[other]))
        share = f"{apart / part.diameter:.0%} of the diameter {part.diameter:.2f}"
        lines.append(f"- the ends of goals {one} and {other} are {apart:.2f} apart: {share}")
    return lines


def _posture(mean: NDArray[np.floating], world: World, components: NDArray[np.intp]) -> str:
    """A place, or where each joint is in its range; `components` are what of the posture is told."""
    if isinstance(world, PointWorld):
        axes = "".join(AXES[component] for component in components)
        return _point(mean) if axes == AXES else f"{axes} = {_point(mean)}"
    names = [world.posture_names[component] for component in components] if world.posture_names else []
    if len(mean) > MOST_NUMBERS:
        return (
            f"a posture of {len(mean)} joints between {mean.min():.2f} and {mean.max():.2f} "
            "(-1 and 1 are their limits)"
        )
    if len(names) != len(mean):
        return f"{_point(mean)} (-1 and 1 are the joints' limits)"
    told = ", ".join(f"{name} {value:.2f}" for name, value in zip(names, mean, strict=True))
    return f"{told} (-1 and 1 are the joints' limits)"


def _named(row: Score) -> list[str]:
    """Landmarks and the task's own reward, where there are any."""
    lines = []
    for name, share in row.landmarks.items():
        goal = row.landmark_vertices.get(name)
        lines.append(
            f"- no goal leads to the posture {name}"
            if goal is None
            else f"- goal {goal} is the posture {name}: {share:.0%} of its legs end there"
        )
    if row.external_reward is not None:
        each = ", ".join(
            f"goal {goal} {reward:.3f}"
            for goal, reward in enumerate(row.external_reward_by_vertex or [])
            if reward is not None
        )
        lines.append(f"- the task's own reward per step is {row.external_reward:.3f} ({each})")
    return lines


def ends_of(rollout: Rollout, block: str) -> "Ends":
    """Where a block's legs ended, and the ways there, in whole postures."""
    from services.launcher.figures import Ends

    legs, path = rollout.legs[block], rollout.path
    steps = rollout.leg_rows
    ways = np.stack([path[leg * steps : (leg + 1) * steps + 1] for leg in range(1, len(legs.goal))])
    size = path.shape[2]
    return Ends(
        goal=legs.goal[1:].reshape(-1),
        posture=legs.posture[1:].reshape(-1, size),
        way=ways.swapaxes(1, 2).reshape(-1, steps + 1, size),
        first_goal=legs.goal[0],
        first_way=path[: steps + 1].swapaxes(0, 1),
        latent_dim=legs.latent.shape[2],
    )


def _point(position: Iterable[float]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in position)})"
