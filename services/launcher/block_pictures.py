"""The figures of what a block of a run found, and the lines of the report that show them."""

import numpy as np

from babble.worlds import World
from babble.worlds.batch import PointWorld
from services.launcher import figures, posture_figures, posture_map
from services.launcher.evaluate import Rollout, Version, latents_at
from services.launcher.figures import Ends, picture
from services.launcher.posture_map import CELLS, MOST_VISITED, Map

EYELESS = "The poses that were reached are not pictured: {}."


def pictures_of(rollout: Rollout, version: Version, ends: Ends, world: World) -> list[str]:
    """Draw where a block's goals lead and what its encoder makes of the world; `world` has one copy.

    The encoder of a block with children sees the world through theirs.

    Raises `StorageError`.
    """
    if isinstance(world, PointWorld):
        return _of_points(rollout, version, ends, world)
    moved = ends.cut(rollout.parts[version.block].components)
    return [
        *of_body(rollout, version, world),
        *_of_map(rollout, version, moved, world),
        *_of_postures(rollout, version, moved, world),
    ]


def _named(rollout: Rollout, version: Version) -> str:
    return f"{rollout.run.settings.world.id}, block {version.block}, iteration {version.iteration}"


def _of_points(rollout: Rollout, version: Version, ends: Ends, world: PointWorld) -> list[str]:
    block, folder, name = version.block, rollout.run.folder / "figures", _named(rollout, version)
    points = world.uniform_points(figures.MAP_POINTS, np.random.default_rng(0))
    figures.draw_world(folder / f"{block}-world.png", world.body, ends, f"{name}: where goals lead")
    latent = latents_at(rollout.tree, rollout.models, block, points.astype(np.float32))
    figures.draw_latent(folder / f"{block}-latent.png", world.body, points, latent, f"{name}: the latent map")
    return [
        *picture(
            f"{block}-world",
            "The world, the points reached per goal in fresh worlds (mean actions), and some of the ways: "
            "from a random start (dotted), and from one end to the other.",
        ),
        *picture(
            f"{block}-latent",
            "The latent over the world: points spread uniformly, in two slices through the middle. The "
            "marks are the points of the whole world, not only of the slice, where a component is largest.",
        ),
    ]


def of_body(rollout: Rollout, version: Version, world: World) -> list[str]:
    """Pictures of the body itself; none for what is no simulated body, a sentence where none can be drawn."""
    if rollout.states is None:
        return []
    from babble.worlds.physics.world import MujocoWorld
    from babble.worlds.senses.screen import RendererError
    from services.launcher.body_pictures import draw_reached

    block = version.block
    assert isinstance(world, MujocoWorld), "only simulated bodies have states"
    try:
        path = rollout.run.folder / "figures" / f"{block}-reached.png"
        drawn = draw_reached(path, rollout, block, world, f"{_named(rollout, version)}: where goals lead")
    except RendererError as error:
        return [EYELESS.format(error), ""]
    if not drawn:
        return []
    return picture(
        f"{block}-reached",
        "The body where each goal leads in fresh worlds (mean actions): first the end that is nearest to "
        "the mean of all, then ends of other copies, each from a random start of its own.",
    )


def _of_map(rollout: Rollout, version: Version, ends: Ends, world: World) -> list[str]:
    block = version.block
    path = rollout.path[..., rollout.parts[block].components]
    flat = path[:-1].reshape(-1, path.shape[2])
    every = max(1, len(flat) // MOST_VISITED)
    visited = flat[::every]
    plane = posture_map.plane_of(ends, visited)
    place, reach = posture_map.cells(plane, ends, visited)
    posed = _posed(rollout, block, world, plane.at(place))
    if posed is None:
        latent = rollout.latent[block].reshape(len(flat), -1)[::every]
        drawn = Map(plane, plane.of(visited), latent, None, reach)
        how = "of the postures that were visited, seen along the plane"
    else:
        drawn = Map(plane, place, posed, (CELLS, CELLS), reach)
        how = "of the body put, at rest, into the postures of the plane; white where a joint cannot go"
    figure_path = rollout.run.folder / "figures" / f"{block}-map.png"
    posture_map.draw_map(figure_path, drawn, ends, f"{_named(rollout, version)}: the latent map")
    held = "" if plane.held > 0.995 else f", which holds {plane.held:.0%} of their spread"
    return picture(
        f"{block}-map",
        f"The latent over a plane through the goals' mean ends{held}: {how}. Ends and some ways there "
        "(mean actions) are drawn as their shadows on the plane.",
    )


def _posed(rollout: Rollout, block: str, world: World, postures: np.ndarray) -> np.ndarray | None:
    """(N, d) latents of postures (N, q) of what a block moves, the rest of the body in the middle.

    NaN beyond the joints' limits; None where that cannot be known.
    """
    if rollout.states is None:
        return None
    from babble.worlds.physics.world import MujocoWorld
    from services.launcher.bodies import is_posable, sensed

    if not isinstance(world, MujocoWorld) or not is_posable(world):
        return None
    latent = np.full((len(postures), rollout.models[block].encoder.latent_dim), np.nan)
    possible = np.abs(postures).max(axis=1) <= 1
    if possible.any():
        whole = np.zeros((int(possible.sum()), world.posture_size), np.float32)
        whole[:, rollout.parts[block].components] = postures[possible]
        observation = sensed(world.blueprint, whole).astype(np.float32)
        latent[possible] = latents_at(rollout.tree, rollout.models, block, observation)
    return latent


def names_of(rollout: Rollout, block: str, world: World) -> list[str]:
    """Of the joints that a block moves; empty where they have none."""
    names = world.posture_names
    return [names[component] for component in rollout.parts[block].components] if names else []


def _of_postures(rollout: Rollout, version: Version, ends: Ends, world: World) -> list[str]:
    block, folder, name = version.block, rollout.run.folder / "figures", _named(rollout, version)
    path = folder / f"{block}-postures.png"
    posture_figures.draw_postures(path, ends, names_of(rollout, block, world), f"{name}: where goals lead")
    latent, goal = rollout.latent[block], rollout.legs[block].goal
    way, title = folder / f"{block}-way.png", f"{name}: the latent on the way"
    posture_figures.draw_way(way, latent, goal, title, rollout.env_steps_per_row)
    return [
        *picture(
            f"{block}-postures",
            "Where each joint ends per goal in fresh worlds (mean actions), within its range.",
        ),
        *picture(
            f"{block}-way",
            "The latent of some columns on the way from a random start from goal to goal (mean actions).",
        ),
    ]
