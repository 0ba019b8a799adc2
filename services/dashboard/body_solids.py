"""Simulated bodies in the Body panel: their solids in the pose of one actor, and touch on their skin."""

from dataclasses import dataclass

import mujoco
import numpy as np
import rerun as rr
from numpy.typing import NDArray

from babble.worlds.drawing.coarse import outwards
from babble.worlds.drawing.poses import turned
from babble.worlds.drawing.solids import Kind, Solids, drawing
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.senses.rendering import View as Place
from babble.worlds.senses.touch import Touch
from babble.worlds.showing import shown
from protocol.messages import View
from services.dashboard.body_look import look_as
from services.dashboard.canvas import Canvas, Due
from services.dashboard.colours import WHITE
from services.dashboard.pens import Pen

Floats = NDArray[np.float32]
Numbers = NDArray[np.floating]

THIN_SECS = 0.5
"""Between two poses in the file."""
MOST_NEWTON = 10.0
"""The force from which on a point of the skin is as bright as can be; on the way there by its root."""
FORCES = (0.0, 0.35, 0.7, 1.0)
FORCE_COLOURS = np.array([(150, 40, 60), (230, 85, 25), (250, 175, 40), (255, 250, 190)])
POINT_SHARE, SPACING_SHARE = 0.002, 0.12
"""The radius of a point of the skin that feels next to nothing, as shares of the distance from which it is
seen and of that between points; the smaller counts."""
FELT_SIZES = 3.0
"""Points that feel the most are so many times as large."""
LABEL_SHARE = 0.36
"""How far above the middle of the picture its caption stands."""


@dataclass(frozen=True)
class _Pose:
    life: str
    env_step: int
    position: Floats
    quaternion: Floats
    touch: Floats | None


class SolidScene:
    """The panel of a `MujocoWorld`."""

    def __init__(self, world: MujocoWorld, view: Place) -> None:
        """`view` is from where pictures of this world are taken."""
        model = world.blueprint.model
        self.look = look_as(view, model)
        self._world = world
        self._drawing = drawing(model)
        self.floor = self._drawing.floor
        touch = shown(world).touch
        self._skin = None if touch is None else _Skin(model, touch, POINT_SHARE * self.look.distance_m)
        self._bodies = model.nbody
        self._caption_m = self.look.lookat_m + LABEL_SHARE * self.look.distance_m * np.array([0, 0, 1])
        self._latest = self._at_rest()
        self._pen = Pen(solid=True)
        self._fresh = False
        self._thin = Due(THIN_SECS)
        self.reason = ""

    def hear(self, view: View) -> bool:
        """Take in a pose; False if it is no pose of this body, and `reason` then says so."""
        arrays = {name: np.asarray(array, np.float32) for name, array in view.arrays.items()}
        position, quaternion, touch = arrays["position"], arrays["quaternion"], arrays.get("touch")
        before = self.reason
        self.reason = self._disagreement(view.life, len(position), None if touch is None else len(touch))
        self._fresh = self._fresh or self.reason != before
        if self.reason or not (np.isfinite(position).all() and np.isfinite(quaternion).all()):
            return False
        self._latest = _Pose(view.life, view.env_step, position, quaternion, touch)
        self._fresh = True
        return True

    def begin(self, canvas: Canvas) -> None:
        """The solids, which never change, and the latest pose, or that at rest."""
        for kind, solids in self._drawing.solids.items():
            canvas.log(f"/body/{kind}", _archetype(kind, solids), static=True)
        for number, mesh in enumerate(self._drawing.meshes):
            surface = rr.Mesh3D(
                vertex_positions=mesh.vertices,
                vertex_normals=mesh.normals,
                albedo_factor=mesh.solids.colour[0],
            )
            canvas.log(f"/body/meshes/{number}", surface, static=True)
        self._draw(canvas, thin=True)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """The newest pose, if there is a new one."""
        if self._fresh:
            self._draw(canvas, thin=self._thin(now_secs))
            self._fresh = False

    def _draw(self, canvas: Canvas, *, thin: bool) -> None:
        pose = self._latest
        for kind, solids in self._drawing.solids.items():
            position, quaternion = solids.at(pose.position, pose.quaternion)
            if kind == "capsules":
                # Rerun's capsules begin where their lower cap does.
                half = np.zeros_like(position)
                half[:, 2] = solids.size[:, 1]
                position = position - turned(quaternion, half)
            canvas.log(f"/body/{kind}", _instances(position, quaternion), thin=thin)
        for number, mesh in enumerate(self._drawing.meshes):
            poses = _instances(*mesh.solids.at(pose.position, pose.quaternion))
            canvas.log(f"/body/meshes/{number}", poses, thin=thin)
        if strings := self._drawing.strings:
            lines = rr.LineStrips3D(
                [string.at(pose.position, pose.quaternion) for string in strings],
                radii=[string.radius_m for string in strings],
                colors=np.stack([string.colour for string in strings]),
            )
            canvas.log("/body/strings", lines, thin=thin)
        if self._skin is not None:
            canvas.log("/body/touch", self._skin.points(pose), thin=thin)
        canvas.log("/body/caption", self._caption(pose), thin=thin)

    def _caption(self, pose: _Pose) -> rr.Points3D:
        text = f"{pose.life}, step {pose.env_step:,}" if pose.life else "no pose was heard yet"
        if self.reason:
            text = self.reason.replace(": ", ":\n")
        elif pose.touch is not None:
            text += f"\ntouch: red where it begins, pale at {MOST_NEWTON:.0f} N and more"
        return self._pen.names(self._caption_m[None].astype(np.float32), [text], [WHITE])

    def _at_rest(self) -> _Pose:
        """Where an episode begins; senses are not asked, for eyes would draw."""
        data = self._world.copies[0]
        self._world.blueprint.task.begin(data, np.random.default_rng(0), "centre")
        mujoco.mj_forward(self._world.blueprint.model, data)
        return _Pose("", 0, data.xpos.astype(np.float32), data.xquat.astype(np.float32), None)

    def _disagreement(self, life: str, bodies: int, points: int | None) -> str:
        felt_here = 0 if self._skin is None else self._skin.size
        if bodies != self._bodies:
            what = f"{bodies} bodies, and the world made here has {self._bodies}"
        elif points is not None and points != felt_here:
            what = f"touch on {points} points, and the body made here has {felt_here}"
        else:
            return ""
        return f"{life} shows {what}: start all processes with the same version of Babble and the same model."


class _Skin:
    """The points of a coarse skin as dots."""

    def __init__(self, model: mujoco.MjModel, touch: Touch, radius_m: float) -> None:
        counts = [len(patch.points) for patch in touch.patches]
        self.size = sum(counts)
        self._body = np.repeat([patch.body for patch in touch.patches], counts)
        self._local = np.concatenate([patch.points for patch in touch.patches])
        spacing_m = np.repeat([patch.distance_m for patch in touch.patches], counts)
        self._radius_m = np.minimum(radius_m, SPACING_SHARE * spacing_m)
        # A dot on the surface itself would be half inside.
        self._local += self._radius_m[:, None] * outwards(model, self._body, self._local)

    def points(self, pose: _Pose) -> rr.Points3D:
        """Those that feel something: from red to a pale yellow, and larger, the stronger the force."""
        if pose.touch is None:
            return rr.Points3D(np.zeros((0, 3)))
        felt = np.flatnonzero(np.nan_to_num(pose.touch) > 0)
        body = self._body[felt]
        place = pose.position[body] + turned(pose.quaternion[body], self._local[felt])
        strength = np.sqrt(np.clip(pose.touch[felt] / MOST_NEWTON, 0, 1))
        colour = [np.interp(strength, FORCES, channel) for channel in FORCE_COLOURS.T]
        radii = self._radius_m[felt] * (1 + (FELT_SIZES - 1) * strength)
        return rr.Points3D(place, colors=np.stack(colour, axis=1).astype(np.uint8), radii=radii)


def _archetype(kind: Kind, solids: Solids) -> rr.AsComponents:
    look = {"colors": solids.colour, "fill_mode": rr.components.FillMode.Solid}
    match kind:
        case "capsules":
            return rr.Capsules3D(radii=solids.size[:, 0], lengths=2 * solids.size[:, 1], **look)
        case "cylinders":
            return rr.Cylinders3D(radii=solids.size[:, 0], lengths=2 * solids.size[:, 1], **look)
        case "boxes":
            return rr.Boxes3D(half_sizes=solids.size, **look)
        case "ellipsoids":
            return rr.Ellipsoids3D(half_sizes=solids.size, **look)


def _instances(position: Numbers, quaternion: Numbers) -> rr.InstancePoses3D:
    """Rerun's quaternions have w last."""
    return rr.InstancePoses3D(translations=position, quaternions=quaternion[:, [1, 2, 3, 0]])
