"""Simulated bodies for the report: their states, put back to be pictured, and postures to be encoded.

Imported only for worlds that have a body: it loads MuJoCo.
"""

from collections.abc import Iterator
from dataclasses import replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.worlds import WORLDS
from babble.worlds.batch import World
from babble.worlds.physics.env import MujocoEnv
from babble.worlds.physics.world import Blueprint, MujocoWorld
from babble.worlds.senses.joints import centre_and_half_range
from babble.worlds.senses.rendering import STUDIO, View, picture

Floats = NDArray[np.float32]
States = NDArray[np.float64]
Pixels = NDArray[np.uint8]

EVERYTHING = mujoco.mjtState.mjSTATE_INTEGRATION.value
SIDE_PX = 400
QUALITY = replace(STUDIO, shadow_px=2048, facets=32, floor_cells=100)
"""Hardly to be told from the studio's at this size, in a third of the time."""
COPIES = 64
"""Postures are sensed by so many at once."""


def states_of(world: World) -> States | None:
    """(E, s) everything that MuJoCo goes on from; None for a world that is no simulated body."""
    if not isinstance(world, MujocoWorld):
        return None
    model = world.blueprint.model
    states = np.empty((world.columns, mujoco.mj_stateSize(model, EVERYTHING)))
    for state, data in zip(states, world.copies, strict=True):
        mujoco.mj_getState(model, data, state, EVERYTHING)
    return states


def postures_in(world: MujocoWorld, states: States) -> Floats:
    """(N, p) where each joint is in its range, as `World.posture`, of N states."""
    data = mujoco.MjData(world.blueprint.model)
    positions = np.empty((len(states), world.posture_size))
    qpos = world.blueprint.model.jnt_qposadr[world.blueprint.joints]
    for position, state in zip(positions, states, strict=True):
        mujoco.mj_setState(world.blueprint.model, data, state, EVERYTHING)
        position[:] = data.qpos[qpos]
    centre, half = centre_and_half_range(world.blueprint.model, world.blueprint.joints)
    return np.clip((positions - centre) / half, -1, 1).astype(np.float32)


def pictures(world: MujocoWorld, states: States) -> Iterator[Pixels]:
    """(SIDE_PX, SIDE_PX, 3) of each state. Raises `RendererError` where nothing can be drawn."""
    model = world.blueprint.model
    data = mujoco.MjData(model)
    for state in states:
        mujoco.mj_setState(model, data, state, EVERYTHING)
        mujoco.mj_forward(model, data)
        yield picture(model, data, width=SIDE_PX, height=SIDE_PX, camera=view_of(world), quality=QUALITY)


def view_of(world: World) -> View:
    """From where a world's body is best seen."""
    maker = WORLDS[world.id].maker
    return maker.view if isinstance(maker, type) and issubclass(maker, MujocoEnv) else View()


def is_posable(world: World) -> bool:
    """Whether the joints of the posture are all there is to know of what the body senses at rest.

    Not where the body is free to move, where it sees (pictures take too long) and where senses are dimmed.
    """
    if not isinstance(world, MujocoWorld):
        return False
    blueprint, images = world.blueprint, [shape for shape in world.senses.values() if len(shape) > 1]
    return blueprint.model.nq == len(blueprint.joints) and not blueprint.degradations and not images


def sensed(blueprint: Blueprint, postures: Floats) -> Floats:
    """(N, n) what a posable body senses when it is put, at rest, into postures (N, p)."""
    model = blueprint.model
    places, (centre, half) = (
        model.jnt_qposadr[blueprint.joints],
        centre_and_half_range(model, blueprint.joints),
    )
    copies = [mujoco.MjData(model) for _ in range(min(COPIES, len(postures)))]
    actuation = blueprint.actuation(len(copies))
    actuation.begin(np.ones(len(copies), np.bool_))
    senses = blueprint.senses(actuation, np.random.default_rng(0))
    rows = []
    for begin in range(0, len(postures), len(copies) or 1):
        some = postures[begin : begin + len(copies)]
        for data, posture in zip(copies, some, strict=False):
            data.qpos[places] = centre + half * posture
            mujoco.mj_forward(model, data)
        row = [sense.read(copies).reshape(len(copies), -1) for sense in senses]
        rows.append(np.concatenate(row, axis=1)[: len(some)])
    return np.concatenate(rows)
