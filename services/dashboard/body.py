"""The Body panel: the body as one actor shows it, in 3-D, and what its eyes see.

The world is made here once more for its looks, and never stepped. Where that cannot be, or an actor shows
another one, the panel says so in one sentence instead.
"""

import math
from typing import TYPE_CHECKING

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from numpy.typing import NDArray

from babble import worlds
from babble.worlds.batch import PointWorld
from babble.worlds.showing import shown
from protocol.messages import View
from services.dashboard.body_look import spatial_view
from services.dashboard.body_points import SILENT_SECS, PointScene
from services.dashboard.canvas import Canvas, Due, plain
from services.runtime.settings import RunSettings, WorldSettings

if TYPE_CHECKING:
    from services.dashboard.body_solids import SolidScene

Pixels = NDArray[np.uint8]

ORIGIN, REASON = "/body", "/body/reason"
JPEG_QUALITY = 80
EYES_FILE_SECS = 1.0
"""Images go to the file this often."""


def eye_path(eye: str) -> str:
    """The entity of an eye's images."""
    return f"/eyes/{eye.replace(' ', '_')}"


class BodyPanel:
    """Draws the body of a run."""

    def __init__(self, settings: RunSettings) -> None:
        """A world that cannot be made is a `reason`."""
        self.eyes: tuple[str, ...] = ()
        """the names of the eyes whose images are drawn; see `eye_path`"""
        self.ignored = 0
        """views that could not be drawn"""
        self._points: PointScene | None = None
        self._solids: SolidScene | None = None
        self._cause = self._said = ""
        self._life, self._heard_secs = "", -math.inf
        self._images: dict[str, Pixels] = {}
        self._fresh_eyes: set[str] = set()
        self._eyes_file_due = Due(EYES_FILE_SECS)
        try:
            self._make(settings.world, settings.block[0].name)
        except worlds.WorldError as error:
            self._cause = f"The body cannot be drawn here: {error}."

    @property
    def reason(self) -> str:
        """Why the body is not drawn, in one sentence; empty if it is."""
        return self._cause or ("" if self._solids is None else self._solids.reason)

    def hear_view(self, view: View, now_secs: float) -> None:
        """Take in what an actor shows, under the name of its `life`; poses and images of one at a time."""
        taken = True
        match view.view:
            case "latent" | "posture" if self._points is not None:
                taken = self._points.hear(view, now_secs)
            case "pose" if self._solids is not None and self._follows(view.life, now_secs):
                taken = self._solids.hear(view)
            case "image" if self._follows(view.life, now_secs):
                taken = view.title in self.eyes
                if taken:
                    self._images[view.title] = np.asarray(view.arrays["pixels"], np.uint8)
                    self._fresh_eyes.add(view.title)
        self.ignored += not taken

    def begin(self, canvas: Canvas) -> None:
        """What never changes, and what still holds."""
        if self._points is not None:
            self._points.begin(canvas)
        if self._solids is not None:
            self._solids.begin(canvas)
        for eye in self._images:
            self._draw_eye(canvas, eye, thin=True)
        self._say(canvas)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """What is new since it was last called."""
        if self._points is not None:
            self._points.draw(canvas, now_secs)
        if self._solids is not None:
            self._solids.draw(canvas, now_secs)
        if self._fresh_eyes:
            thin = self._eyes_file_due(now_secs)
            for eye in sorted(self._fresh_eyes):
                self._draw_eye(canvas, eye, thin=thin)
            self._fresh_eyes.clear()
        if self.reason != self._said:
            self._say(canvas)

    def body_view(self, name: str) -> rrb.View:
        """Where the body is seen, under this title; the sentence where there is a `reason`."""
        if self.reason:
            return rrb.TextDocumentView(origin=REASON, name=name)
        if self._solids is not None:
            return spatial_view(name, ORIGIN, self._solids.look, self._solids.floor)
        assert self._points is not None
        return spatial_view(name, ORIGIN, self._points.look, None)

    def _make(self, world: WorldSettings, block: str) -> None:
        made = worlds.make(world.id, world.parameters, 1, 0)
        if isinstance(made, PointWorld):
            self._points = PointScene(made, block)
            return
        # MuJoCo is loaded by now; for a shape it never is.
        from babble.worlds.physics.env import MujocoEnv
        from babble.worlds.physics.world import MujocoWorld
        from services.dashboard.body_solids import SolidScene

        maker = worlds.WORLDS[world.id].maker
        if not isinstance(made, MujocoWorld) or not issubclass(maker, MujocoEnv):
            self._cause = f"The world {world.id} has no body that can be drawn."
            return
        self._solids = SolidScene(made, maker.view)
        self.eyes = shown(made, touch=False).eyes

    def _follows(self, life: str, now_secs: float) -> bool:
        """Whether this actor is the one that is shown; it is until it has been silent for a while."""
        if life != self._life and now_secs - self._heard_secs < SILENT_SECS:
            return False
        self._life, self._heard_secs = life, now_secs
        return True

    def _draw_eye(self, canvas: Canvas, eye: str, *, thin: bool) -> None:
        image = rr.Image(self._images[eye]).compress(jpeg_quality=JPEG_QUALITY)
        canvas.log(eye_path(eye), image, thin=thin)

    def _say(self, canvas: Canvas) -> None:
        self._said = self.reason
        if self.reason:
            canvas.log(REASON, rr.TextDocument(plain(self.reason)))
