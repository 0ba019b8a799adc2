"""Picture where each goal of a run leads: `python examples/vertices.py RUN PICTURE.png`.

The body as it stands at the ends of legs to each vertex of the simplex, a row per vertex, as in the thesis's
figures 4.2 and 4.3; `babble report RUN` puts the same picture into the run's report.
"""

import sys
from pathlib import Path

from babble.worlds.physics.world import MujocoWorld
from services.launcher.body_pictures import draw_reached
from services.launcher.evaluate import load_models, open_run, roll_out


def main(where: str, path: Path) -> float:
    """Writes the picture of the first block's ends, of a tree the highest one's; returns their z_min."""
    run = open_run(where)
    blocks = run.levels[max(run.levels)]
    versions = [run.version(block) for block in blocks]
    rollout = roll_out(run, versions, {version.block: load_models(run, version) for version in versions})
    world = run.world(1, [0])
    if not isinstance(world, MujocoWorld):
        raise SystemExit(f"{world.id} has no body to picture")
    draw_reached(path, rollout, blocks[0], world, f"{run.name}: where goals lead")
    return rollout.scores()[0].z_min


if __name__ == "__main__":
    print(f"z_min {main(sys.argv[1], Path(sys.argv[2])):.3f}")
