"""Pictures of a simulation, drawn without a screen: for eyes, quickly; for people, well."""

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.patterns import matching
from babble.worlds.physics.names import names_of
from babble.worlds.senses.screen import FONT_SCALE, screen

Pixels = NDArray[np.uint8]

MAX_SIDE_PX = 4096
MAX_GEOMS = 10_000


@dataclass(frozen=True, kw_only=True)
class Quality:
    """What a picture is worth."""

    samples: int = 4
    """per pixel, against jagged edges"""
    shadow_px: int = 0
    """side of the maps by which lights cast shadows; 0 for none"""
    reflections: bool = False
    """materials that mirror do"""
    background: tuple[float, float, float] | None = None
    """the colour into which the distance fades; None for no fog"""
    site_groups: tuple[int, ...] = ()
    """the groups of sites that are drawn: they are marks, not matter"""
    facets: int = 28
    """around each round thing"""
    floor_cells: int = 80
    """along each side of an endless floor without texture; more shade the light of near lamps better"""


class Renderer:
    """Draws the copies of one model, at one size."""

    def __init__(
        self, model: mujoco.MjModel, *, height: int, width: int, quality: Quality | None = None
    ) -> None:
        """Raises ValueError for a size that is none; needs no OpenGL yet."""
        check_size(height, width)
        self._model = model
        self._quality = quality or Quality()
        self._rect = mujoco.MjrRect(0, 0, width, height)
        self._scene = mujoco.MjvScene(model, MAX_GEOMS)
        flags = self._scene.flags
        flags[mujoco.mjtRndFlag.mjRND_SHADOW] = self._quality.shadow_px > 0
        flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = self._quality.reflections
        flags[mujoco.mjtRndFlag.mjRND_FOG] = self._quality.background is not None
        self._options = mujoco.MjvOption()
        self._options.sitegroup[:] = [group in self._quality.site_groups for group in range(mujoco.mjNGROUP)]
        self._options.flags[mujoco.mjtVisFlag.mjVIS_RANGEFINDER] = False
        self._resources: mujoco.MjrContext | None = None
        self._free: Callable[[], object] | None = None

    def images(
        self,
        copies: Sequence[mujoco.MjData],
        cameras: Sequence[mujoco.MjvCamera],
        dress: Callable[[mujoco.MjvScene], None] | None = None,
    ) -> Pixels:
        """(E, cameras, H, W, 3) what each camera sees of each copy, the top row first.

        `dress` may change each scene before it is drawn. Raises `RendererError` where nothing can be drawn.
        """
        rect = self._rect
        images = np.empty((len(copies), len(cameras), rect.height, rect.width, 3), np.uint8)
        with screen.current():
            resources = self._ready()
            for data, row in zip(copies, images, strict=True):
                for camera, image in zip(cameras, row, strict=True):
                    every = mujoco.mjtCatBit.mjCAT_ALL.value
                    mujoco.mjv_updateScene(self._model, data, self._options, None, camera, every, self._scene)
                    if dress is not None:
                        dress(self._scene)
                    mujoco.mjr_render(rect, self._scene, resources)
                    mujoco.mjr_readPixels(image, None, rect, resources)
        return images[:, :, ::-1]

    def close(self) -> None:
        """Give back what OpenGL holds; the next picture takes it again."""
        if self._free is not None:
            self._free()
        self._free = self._resources = None

    def _ready(self) -> mujoco.MjrContext:
        if self._resources is None:
            self._resources = mujoco.MjrContext(self._as_drawn(), FONT_SCALE)
            self._free = screen.keep(self, self._resources)
        # Which buffer is drawn into belongs to the OpenGL context, which other renderers use as well.
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN.value, self._resources)
        return self._resources

    def _as_drawn(self) -> mujoco.MjModel:
        """A copy of the model that asks OpenGL for no more than these pictures need."""
        drawn, quality = copy.copy(self._model), self._quality
        visual = drawn.vis
        visual.global_.offheight, visual.global_.offwidth = self._rect.height, self._rect.width
        visual.quality.offsamples, visual.quality.shadowsize = quality.samples, quality.shadow_px
        visual.quality.numslices, visual.quality.numstacks = quality.facets, quality.facets // 2
        # Near the edge of the region that has shadows, MuJoCo's floors shade themselves in specks.
        visual.map.shadowclip *= 2
        if quality.background is not None:
            visual.rgba.fog = (*quality.background, 1.0)
        _cut_floors(drawn, quality.floor_cells)
        return drawn


def _cut_floors(drawn: mujoco.MjModel, cells: int) -> None:
    """Cut endless floors into cells: the many of MuJoCo's own choice cost more than the rest of a scene.

    Light is computed at their corners. Floors with a texture are left alone, as its scale would change.
    """
    half = drawn.vis.map.zfar * drawn.stat.extent
    is_endless = (drawn.geom_size[:, :2] <= 0).any(axis=1) & (drawn.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    material = drawn.geom_matid
    is_textured = (material >= 0) & (drawn.mat_texid >= 0).any(axis=1)[material] if drawn.nmat else False
    drawn.geom_size[is_endless & ~np.asarray(is_textured)] = (half, half, 2 * half / cells)


@dataclass(frozen=True, kw_only=True)
class View:
    """From where a picture is taken."""

    azimuth_deg: float = 135.0
    """direction in which the camera looks, around the vertical: 0 along +x, 90 along +y"""
    elevation_deg: float = -20.0
    """upwards; negative to look down"""
    distance_m: float | None = None
    """from the point looked at; None to see the whole model"""
    lookat_m: tuple[float, float, float] | None = None
    """the point looked at; None for the model's centre"""


PUPILS = 2
"""The group of sites that MIMo's pupils are in."""
STUDIO = Quality(
    shadow_px=4096,
    reflections=True,
    background=(0.93, 0.94, 0.96),
    site_groups=(PUPILS,),
    facets=64,
    floor_cells=200,
)
FINER = 2
WHOLE_MODEL_EXTENTS = 1.6
LAMP_EXTENTS = 2.0


def picture(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    width: int,
    height: int,
    camera: str | View | None = None,
    quality: Quality = STUDIO,
) -> Pixels:
    """(H, W, 3) of 0..255: a picture for people, in the light of a studio, as of the last mj_forward.

    `camera` is the name of one of the model's or a view from anywhere. Raises ValueError for a name
    that the model lacks and a size that is none, `RendererError` where nothing can be drawn.
    """
    check_size(height, width, MAX_SIDE_PX // FINER)
    if isinstance(camera, str):
        index = int(matching(names_of(model, "camera"), [camera], "camera")[0])
        taken_by, distance_m = fixed_camera(index), model.stat.extent
    else:
        taken_by = _free_camera(model, camera or View())
        distance_m = taken_by.distance
    renderer = Renderer(model, height=FINER * height, width=FINER * width, quality=quality)
    try:
        fine = renderer.images([data], [taken_by], partial(_studio, model.stat.extent, distance_m))[0, 0]
    finally:
        renderer.close()
    blocks = fine.reshape(height, FINER, width, FINER, 3)
    return np.rint(blocks.mean(axis=(1, 3))).astype(np.uint8)


def check_size(height: int, width: int, most_px: int = MAX_SIDE_PX) -> None:
    """Raises ValueError unless both are whole numbers of pixels within bounds."""
    for name, side in (("height", height), ("width", width)):
        if not isinstance(side, int) or isinstance(side, bool) or not 1 <= side <= most_px:
            raise ValueError(
                f"a picture's {name} must be a whole number from 1 to {most_px} px, got {side!r}"
            )


def fixed_camera(index: int) -> mujoco.MjvCamera:
    """The model's camera of this number."""
    camera = mujoco.MjvCamera()
    camera.type, camera.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, index
    return camera


def _free_camera(model: mujoco.MjModel, view: View) -> mujoco.MjvCamera:
    camera = mujoco.MjvCamera()
    camera.type = mujoco.mjtCamera.mjCAMERA_FREE
    camera.azimuth, camera.elevation = view.azimuth_deg, view.elevation_deg
    extent = WHOLE_MODEL_EXTENTS * model.stat.extent
    camera.distance = extent if view.distance_m is None else view.distance_m
    camera.lookat[:] = model.stat.center if view.lookat_m is None else view.lookat_m
    return camera


def _studio(extent_m: float, distance_m: float, scene: mujoco.MjvScene) -> None:
    """Soft light, a lamp that casts shadows from above the camera's left shoulder, a weak one; a backdrop."""
    view = scene.camera[0]
    forward, up = np.array(view.forward, np.float64), np.array(view.up, np.float64)
    right, subject = np.cross(forward, up), view.pos + distance_m * forward
    lamps = (
        (forward + 0.4 * right - 0.55 * np.array([0, 0, 1]), 0.42, True),
        (forward - 1.2 * right, 0.14, False),
    )
    for light, (direction, strength, casts_shadow) in zip(scene.lights, lamps, strict=False):
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
        light.dir = direction / np.linalg.norm(direction)
        # Its rays are parallel, but the shadow's depth is measured from here: far away it is coarse.
        light.pos = subject - LAMP_EXTENTS * extent_m * np.array(light.dir)
        light.ambient, light.diffuse, light.specular = [0.34] * 3, [strength] * 3, [0.15 * strength] * 3
        light.headlight, light.castshadow = False, casts_shadow
        light.attenuation, light.texid = (1, 0, 0), -1
    scene.nlight = len(lamps)
    far = 0.98 * view.frustum_far
    mujoco.mjv_initGeom(
        scene.geoms[scene.ngeom],
        mujoco.mjtGeom.mjGEOM_PLANE,
        np.array([far, far, 1.0]),
        view.pos + far * forward,
        np.column_stack([right, up, -forward]).ravel(),
        np.ones(4, np.float32),
    )
    scene.ngeom += 1
