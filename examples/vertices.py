"""Picture where each goal of a finished run leads: `python examples/vertices.py RUN PICTURE.png`.

The body as it stands at the end of a leg to each vertex of the simplex, side by side, as in the thesis's
figures 4.1 to 4.3. For runs whose body is simulated and whose tree is one block.
"""

import sys
from pathlib import Path

import matplotlib.image
import numpy as np

from babble.scores import Walk, Walker
from babble.worlds import WORLDS
from babble.worlds.physics.env import MujocoEnv
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.senses.rendering import picture
from services.launcher.evaluate import load_models, open_run

COLUMNS, LEGS, HEIGHT, WIDTH = 16, 2, 360, 300


def main(where: str, path: Path) -> dict[int, float]:
    """Writes the picture; returns z_j at the end of the leg shown for each vertex j."""
    run = open_run(where)
    block = run.blocks[0]
    models = load_models(run, run.version(block))
    world = run.world(COLUMNS, [0])
    if not isinstance(world, MujocoWorld):
        raise SystemExit(f"{world.id} has no body to picture")
    everything = np.arange(world.observation_size), np.arange(world.action_size)
    walker = Walker(models.encoder, models.policy, *everything)
    walk = Walk(world, {block: walker}, np.random.default_rng(0), LEGS, run.settings.evaluation.leg_steps)
    while not walk.done:
        walk.advance(1)
    legs = walk.legs()[block]
    maker = WORLDS[world.id].maker
    assert issubclass(maker, MujocoEnv)
    reached, pictures = {}, []
    for vertex in np.unique(legs.goal[-1]).tolist():
        column = int(np.flatnonzero(legs.goal[-1] == vertex)[0])
        reached[vertex] = float(legs.latent[-1, column, vertex])
        view = maker.view
        data = world.copies[column]
        pictures.append(picture(world.blueprint.model, data, width=WIDTH, height=HEIGHT, camera=view))
    matplotlib.image.imsave(path, np.concatenate(pictures, axis=1))
    return reached


if __name__ == "__main__":
    for vertex, z in main(sys.argv[1], Path(sys.argv[2])).items():
        print(f"goal {vertex}: z {z:.3f}")
