"""Draw MIMo's bodies and the simulated worlds: `python examples/pictures.py FOLDER`.

Needs EGL or OSMesa; the pictures of docs/worlds were made by it.
"""

import sys
from collections.abc import Callable
from pathlib import Path

import gymnasium
import matplotlib.image
import mujoco
import numpy as np

from babble.worlds import WORLDS as ENTRIES
from babble.worlds import make
from babble.worlds.mimo.body import infant
from babble.worlds.mimo.cuts import arm, finger, hand
from babble.worlds.mimo.figures import load
from babble.worlds.mimo.scenes import add_face, add_floor, place, set_angles
from babble.worlds.physics.env import MujocoEnv
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.senses.rendering import View, picture

WIDTH, HEIGHT = 640, 480
STANDING = View(azimuth_deg=155, elevation_deg=-12, distance_m=1.25, lookat_m=(0, 0, 0.4))
LYING = View(azimuth_deg=125, elevation_deg=-35, distance_m=1.25, lookat_m=(0.0, 0, 0.06))
SITTING = View(azimuth_deg=140, elevation_deg=-15, distance_m=1.2, lookat_m=(0.1, 0, 0.22))
SMALL = View(azimuth_deg=150, elevation_deg=-15, distance_m=0.26, lookat_m=(0, 0, 0.05))
TINY = View(azimuth_deg=120, elevation_deg=-10, distance_m=0.14, lookat_m=(0, 0, 0.03))
ARM = View(azimuth_deg=120, elevation_deg=-20, distance_m=0.55, lookat_m=(0.14, 0, 0))

BODIES: dict[str, tuple[Callable[[], mujoco.MjSpec], View]] = {
    "body-arm": (lambda: arm(load("five_finger")), ARM),
    "body-hand": (lambda: hand(load("five_finger")), SMALL),
    "body-finger": (lambda: finger(load("five_finger")), TINY),
}
VIEW_OF_ANT = View(azimuth_deg=135, elevation_deg=-25, distance_m=4, lookat_m=(0, 0, 0.4))
ANT = str(Path(gymnasium.__file__).parent / "envs/mujoco/assets/ant.xml")
WORLDS: dict[str, tuple[str, dict[str, str], float]] = {
    "finger-extended": ("MimoFinger", {}, -1.0),
    "finger-flexed": ("MimoFinger", {}, 1.0),
    "hand-open": ("MimoHand", {}, -1.0),
    "hand-closed": ("MimoHand", {}, 1.0),
    "rollover": ("MimoRollover", {}, 0.0),
    "stand-up": ("MimoStandUp", {}, 0.0),
    "reach": ("MimoReach", {}, 0.0),
    "kick": ("MimoKick", {}, 0.0),
    "mjcf-ant": ("Mjcf", {"file": ANT}, 0.2),
}
"""World, parameters, and the command that all actuators are given for a second."""


def main(folder: Path) -> list[Path]:
    """Draw everything into the folder; returns the files."""
    folder.mkdir(parents=True, exist_ok=True)
    drawn = [
        draw_posture(folder, hands, pose) for hands in ("mitten", "five_finger") for pose in ("standing",)
    ]
    drawn += [draw_posture(folder, "mitten", pose) for pose in ("supine", "prone", "sitting")]
    drawn += [draw_body(folder, name) for name in BODIES]
    drawn += [draw_world(folder, name) for name in WORLDS]
    return drawn


def draw_posture(folder: Path, hands: str, pose: str) -> Path:
    """The whole body, put down on the floor."""
    spec = infant(load("mitten" if hands == "mitten" else "five_finger"))
    add_floor(spec)
    add_face(spec)
    angles = place(spec, pose)
    model = spec.compile()
    data = mujoco.MjData(model)
    set_angles(model, data, angles)
    view = {"standing": STANDING, "sitting": SITTING}.get(pose, LYING)
    return _drawn(folder / f"body-{hands.replace('_', '-')}-{pose}.png", model, data, view)


def draw_body(folder: Path, name: str) -> Path:
    """A part of the body by itself."""
    build, view = BODIES[name]
    model = build().compile()
    return _drawn(folder / f"{name}.png", model, mujoco.MjData(model), view)


def draw_world(folder: Path, name: str) -> Path:
    """A world a second after its start."""
    id, parameters, command = WORLDS[name]
    world = make(id, parameters, columns=1, seed=0)
    assert isinstance(world, MujocoWorld)
    world.reset()
    for _ in range(100 if command else 1):
        world.step(np.full((1, world.action_size), command, np.float32))
    return _drawn(folder / f"{name}.png", world.blueprint.model, world.copies[0], _view_of(id))


def _view_of(id: str) -> View:
    if id == "Mjcf":
        return VIEW_OF_ANT
    maker = ENTRIES[id].maker
    assert issubclass(maker, MujocoEnv)
    return maker.view


def _drawn(path: Path, model: mujoco.MjModel, data: mujoco.MjData, view: View) -> Path:
    mujoco.mj_forward(model, data)
    matplotlib.image.imsave(path, picture(model, data, width=WIDTH, height=HEIGHT, camera=view))
    return path


if __name__ == "__main__":
    for path in main(Path(sys.argv[1] if len(sys.argv) > 1 else "pictures")):
        print(path)
