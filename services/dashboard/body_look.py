"""From where a body is looked at, and before what."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from babble.worlds.geometry import Body

if TYPE_CHECKING:
    import mujoco

    from babble.worlds.drawing.solids import Floor
    from babble.worlds.senses.rendering import View

Array = NDArray[np.float64]

BACKGROUND = (13, 15, 20)
GRID_COLOUR = (96, 104, 118, 90)
GRID_CELLS = 12.0
"""About so many cells of the floor's grid lie between the eye and what is looked at."""
SHAPE_AZIMUTH_DEG, SHAPE_ELEVATION_DEG, SHAPE_SIZES = 115.0, -24.0, 3.7
NEARER = 0.83
"""Rerun's eye has a wider angle than MuJoCo's cameras, for which the views are."""
WHOLE_MODEL_EXTENTS = 1.6


@dataclass(frozen=True)
class Look:
    """The place of the eye, in metres and degrees, as MuJoCo's free camera has it."""

    lookat_m: Array
    distance_m: float
    azimuth_deg: float
    elevation_deg: float

    @property
    def eye_m(self) -> Array:
        """(3,) where the eye is."""
        azimuth, elevation = np.radians([self.azimuth_deg, self.elevation_deg])
        forward = [
            np.cos(elevation) * np.cos(azimuth),
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
        ]
        return np.asarray(self.lookat_m - NEARER * self.distance_m * np.array(forward))


def look_at_shape(body: Body) -> Look:
    """From above and before, so that the whole shape is seen."""
    distance = SHAPE_SIZES * float(np.linalg.norm(body.extent))
    return Look(np.zeros(3), distance, SHAPE_AZIMUTH_DEG, SHAPE_ELEVATION_DEG)


def look_as(view: "View", model: "mujoco.MjModel") -> Look:
    """As the world's own pictures are taken."""
    distance_m = WHOLE_MODEL_EXTENTS * model.stat.extent if view.distance_m is None else view.distance_m
    lookat_m = np.array(model.stat.center if view.lookat_m is None else view.lookat_m, np.float64)
    return Look(lookat_m, distance_m, view.azimuth_deg, view.elevation_deg)


def spatial_view(name: str, origin: str, look: Look, floor: "Floor | None") -> rrb.Spatial3DView:
    """The view, with a thin grid where there is a floor."""
    eye = rrb.EyeControls3D(
        kind=rrb.Eye3DKind.Orbital, position=look.eye_m, look_target=look.lookat_m, eye_up=(0, 0, 1)
    )
    return rrb.Spatial3DView(
        origin=origin,
        name=name,
        background=rrb.Background(color=BACKGROUND),
        line_grid=_grid(look, floor),
        eye_controls=eye,
    )


def _grid(look: Look, floor: "Floor | None") -> rrb.LineGrid3D:
    if floor is None:
        return rrb.LineGrid3D(visible=False)
    return rrb.LineGrid3D(
        visible=True,
        spacing=_round(look.distance_m / GRID_CELLS),
        plane=rr.components.Plane3D(floor.normal, floor.distance_m),
        stroke_width=0.6,
        color=GRID_COLOUR,
    )


def _round(length: float) -> float:
    """The nearest of 1, 2 and 5 times a power of ten."""
    ten = 10.0 ** np.floor(np.log10(length))
    return float(ten * min((1, 2, 5, 10), key=lambda step: abs(np.log(length / ten / step))))
