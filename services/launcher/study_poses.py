"""Pictures of the two states of each condition that lie furthest apart; loads MuJoCo."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from babble.worlds import make
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.senses.rendering import picture
from services.launcher.bodies import QUALITY, SIDE_PX, view_of
from services.launcher.body_pictures import Pixels, cropped
from services.launcher.figures import save
from services.launcher.study_measurement import Measurement
from services.launcher.study_plan import Condition, Plan
from services.launcher.study_table import Measurements
from services.runtime.settings import WorldSettings

POSITION, VELOCITY = "position/", "velocity/"
PAIRS_ACROSS = 4
PICTURE_INCHES = 1.7


@dataclass(frozen=True)
class Furthest:
    """A condition's furthest pair, of the seed that reached furthest."""

    condition: Condition
    seed: int
    measured: Measurement


def draw_furthest(path: Path, plan: Plan, measurements: Measurements, world: WorldSettings) -> bool:
    """The postures of the furthest pairs; false for a world that has no simulated body.

    States do not say where a body lies: it is drawn where its episodes begin. Raises `RendererError` where
    nothing can be drawn, `StorageError`.
    """
    made = make(world.id, world.parameters, 1, 0)
    if not isinstance(made, MujocoWorld):
        return False
    made.reset()
    pairs = furthest_of(plan, measurements)
    images = [
        _posed(made, dict(zip(pair.measured.state_names, state, strict=True)))
        for pair in pairs
        for state in pair.measured.furthest
    ]
    _arrange(path, pairs, cropped(images))
    return True


def furthest_of(plan: Plan, measurements: Measurements) -> list[Furthest]:
    """Of each condition that has a run."""
    found = []
    for condition in plan.condition:
        if by_seed := measurements.get(condition.id):
            seed = max(by_seed, key=lambda each: by_seed[each].coverage.diameter)
            found.append(Furthest(condition, seed, by_seed[seed]))
    return found


def velocity_share(measured: Measurement) -> float | None:
    """How much of the squared distance of the furthest pair is of velocities; None where it has none."""
    one, other = (np.array(state) for state in measured.furthest)
    squares = (one - other) ** 2
    moving = np.array([name.startswith(VELOCITY) for name in measured.state_names])
    return float(squares[moving].sum() / squares.sum()) if moving.any() else None


def _posed(world: MujocoWorld, state: Mapping[str, float]) -> Pixels:
    model, data = world.blueprint.model, mujoco.MjData(world.blueprint.model)
    data.qpos[:] = world.copies[0].qpos
    for name, value in state.items():
        if name.startswith(POSITION):
            data.qpos[model.joint(name.removeprefix(POSITION)).qposadr[0]] = value
    mujoco.mj_forward(model, data)
    return picture(model, data, width=SIDE_PX, height=SIDE_PX, camera=view_of(world), quality=QUALITY)


def _arrange(path: Path, pairs: list[Furthest], images: list[NDArray[Any]]) -> None:
    rows, across = -(-len(pairs) // PAIRS_ACROSS), min(PAIRS_ACROSS, len(pairs))
    height, width = images[0].shape[:2]
    size = (across * (2 * PICTURE_INCHES + 0.25), rows * (PICTURE_INCHES * height / width + 0.55) + 0.4)
    figure = Figure(figsize=size, layout="constrained")
    outer = figure.subfigures(rows, across, squeeze=False).ravel()
    for place, (part, pair) in enumerate(zip(outer, pairs, strict=False)):
        for axes, image in zip(part.subplots(1, 2), images[2 * place : 2 * place + 2], strict=True):
            axes.imshow(image, interpolation="antialiased")
            axes.set_axis_off()
        part.suptitle(_title(pair), fontsize=8)
    save(figure, path)


def _title(pair: Furthest) -> str:
    share = velocity_share(pair.measured)
    moving = "" if share is None else f", {share:.1%} of it velocity"
    words = f"{pair.condition.id} {pair.condition.title}, seed {pair.seed}"
    return f"{words}\n{pair.measured.coverage.diameter:.1f} apart{moving}"
