"""What a block of a run found, rolled out in fresh worlds: in words, for the report."""

import itertools
from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from babble.worlds import World
from babble.worlds.batch import PointWorld
from protocol.messages import Score
from services.launcher.evaluate import Rollout, Run, Version, load_models, roll_out, shortfalls

if TYPE_CHECKING:
    from services.launcher.figures import Ends

PLACES = {
    "Cuboid": "both ends of the long diagonal",
    "Ellipsoid": "both ends of the long axis",
    "Dumbbell": "the outer ends of both lobes",
}
"""What a Composer with two vertices should find (thesis 4.1)."""
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


def rolled_out(run: Run, version: Version) -> tuple[list[str], list[str]]:
    """Where each goal ends in fresh worlds, in words, and the figures of it. Raises `RunError`."""
    beside = [run.version(block, version.iteration) for block in run.blocks]
    models = {each.block: load_models(run, each) for each in beside}
    rollout = roll_out(run, beside, models)
    world = run.world(1, [0, 6, 4])
    encoder = models[version.block].encoder
    ends = _ends(rollout, version.block, encoder.latent_dim)
    (anew,) = [row for row in rollout.scores() if row.block == version.block]
    words = [
        "In fresh worlds, from random starts and with mean actions:",
        "",
        *_places(rollout, ends, world),
        *_named(anew),
        "",
        f"Scores of these rollouts: separation {anew.separation:.3f}, z_min {anew.z_min:.3f}.",
    ]
    from services.launcher.block_pictures import pictures_of

    return words, pictures_of(rollout, version, encoder, ends, world)


def _sought(run: Run, version: Version, row: Score) -> str:
    if row.landmarks:
        return f"the postures {' and '.join(row.landmarks)}"
    if run.settings.one_block(version.block).latent_dim > 2:
        return "places far apart, one per goal,"
    return PLACES.get(run.settings.world.id, "two places far apart")


def _places(rollout: Rollout, ends: "Ends", world: World) -> list[str]:
    """Where the goals end, and how far apart; goals that no leg had are left out."""
    means = {
        goal: ends.posture[ends.goal == goal].mean(axis=0)
        for goal in range(ends.latent_dim)
        if (ends.goal == goal).any()
    }
    lines = []
    for goal, mean in means.items():
        off = float(np.linalg.norm(ends.posture[ends.goal == goal] - mean, axis=1).mean())
        lines.append(f"- goal {goal} ends at {_posture(mean, world)}, on average within {off:.2f} of it")
    for one, other in itertools.combinations(means, 2):
        apart = float(np.linalg.norm(means[one] - means[other]))
        share = f"{apart / rollout.diameter:.0%} of the diameter {rollout.diameter:.2f}"
        lines.append(f"- the ends of goals {one} and {other} are {apart:.2f} apart: {share}")
    return lines


def _posture(mean: NDArray[np.floating], world: World) -> str:
    """A place, or where each joint is in its range."""
    if isinstance(world, PointWorld):
        return _point(mean)
    names = world.posture_names
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


def _ends(rollout: Rollout, block: str, latent_dim: int) -> "Ends":
    from services.launcher.figures import Ends

    legs, path = rollout.legs[block], rollout.path
    steps = rollout.run.settings.evaluation.leg_steps
    ways = np.stack([path[leg * steps : (leg + 1) * steps + 1] for leg in range(1, len(legs.goal))])
    size = path.shape[2]
    return Ends(
        goal=legs.goal[1:].reshape(-1),
        posture=legs.posture[1:].reshape(-1, size),
        way=ways.swapaxes(1, 2).reshape(-1, steps + 1, size),
        first_goal=legs.goal[0],
        first_way=path[: steps + 1].swapaxes(0, 1),
        latent_dim=latent_dim,
    )


def _point(position: Iterable[float]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in position)})"
