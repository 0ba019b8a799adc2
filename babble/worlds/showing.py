"""What can be seen of a world from outside: a body's pose, the touch on its skin, what its eyes see.

Of the first copy, and only read: no random number is drawn, nothing of the simulation is written to, so a
run that is watched is the run that is not. Two processes that make the same world name the same eyes
and have the same points of skin, in the same order.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from babble.observations import Layout
from babble.worlds.batch import Floats, PointWorld, World

if TYPE_CHECKING:
    from babble.worlds.physics.world import MujocoWorld
    from babble.worlds.senses.touch import Touch

Pixels = NDArray[np.uint8]
SIDES = ("left", "right")


@dataclass(frozen=True)
class Pose:
    """Where all bodies of a model are, B with the world itself, and what the skin feels."""

    position: Floats
    """(B, 3) of the bodies' origins, in metres"""
    quaternion: Floats
    """(B, 4) the bodies' rotations, w first"""
    touch: Floats | None
    """(N,) the force on each point of the skin, in newton; None for a body without skin"""


class Shown:
    """What can be seen of one world's first copy."""

    def __init__(self, world: World, simulated: "MujocoWorld | None", touch: "Touch | None") -> None:
        self._simulated = simulated
        self._touch = touch
        layout = Layout(world.senses)
        self._images = [(layout.slices[name], shape) for name, shape in layout.images.items()]
        cameras = () if simulated is None else _cameras(simulated)
        self.eyes = _eye_names(sum(shape[0] for _, shape in self._images), cameras)
        """the names of the eyes, in the order of their images"""

    @property
    def touch(self) -> "Touch | None":
        """The skin that `pose` tells of; None without one."""
        return self._touch

    def pose(self) -> Pose | None:
        """As of the last step; None for what is no simulated body, and while its simulation is broken."""
        if self._simulated is None:
            return None
        data = self._simulated.copies[0]
        with np.errstate(over="ignore"):
            position, quaternion = data.xpos.astype(np.float32), data.xquat.astype(np.float32)
        if not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            return None
        return Pose(position, quaternion, None if self._touch is None else self._touch.read([data])[0])

    def images(self, observation: Floats) -> dict[str, Pixels]:
        """By the name of the eye: what it shows (H, W, 3) in the first row of observations (E, n)."""
        pictures = [
            picture
            for place, shape in self._images
            for picture in np.clip(observation[0, place], 0, 255).astype(np.uint8).reshape(shape)
        ]
        return dict(zip(self.eyes, pictures, strict=True))


def shown(world: World, *, touch: bool = True) -> Shown:
    """What can be seen of the world; with `touch` also of one that does not sense it."""
    if isinstance(world, PointWorld):
        return Shown(world, None, None)
    # MuJoCo and the skin take their time and memory, which worlds without a body do not need.
    from babble.worlds.drawing.coarse import coarse_touch
    from babble.worlds.physics.world import MujocoWorld

    if not isinstance(world, MujocoWorld):
        return Shown(world, None, None)
    return Shown(world, world, coarse_touch(world.blueprint.model) if touch else None)


def _cameras(world: "MujocoWorld") -> tuple[str, ...]:
    model = world.blueprint.model
    return tuple(model.camera(index).name for index in range(model.ncam))


def _eye_names(eyes: int, cameras: tuple[str, ...]) -> tuple[str, ...]:
    """After the cameras if all of them are eyes, which then come in the model's order; else by number."""
    if len(cameras) == eyes and len({_spoken(camera) for camera in cameras}) == eyes:
        return tuple(map(_spoken, cameras))
    return ("eye",) if eyes == 1 else tuple(f"eye {number + 1}" for number in range(eyes))


def _spoken(camera: str) -> str:
    """ "left eye" for "eye_left"; other names as they are."""
    for side in SIDES:
        if camera == f"eye_{side}":
            return f"{side} eye"
    return camera or "eye"
