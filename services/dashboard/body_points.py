"""Simple worlds in the Body panel: the shape's wires, the points reached in it, and where actors are now."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from babble.worlds.batch import PointWorld
from babble.worlds.drawing.wires import wire_frame
from protocol.messages import View
from services.dashboard.body_look import look_at_shape
from services.dashboard.canvas import Canvas, Due
from services.dashboard.colours import DIM, GREY, WHITE, of_index
from services.dashboard.latent_book import label_order
from services.dashboard.pens import Pen, grouped

Floats = NDArray[np.float32]
Colours = NDArray[np.uint32]

SHAPE, REACHED, NOW, PATH = "/body/shape", "/body/reached", "/body/now", "/body/path"
SILENT_SECS = 3.0
"""An actor that was not heard for so long is no longer drawn."""
MOST_ACTORS = 32
MOST_REACHED = 1500
REACHED_SECS = 60.0
"""The points reached are filled anew in about so long, whatever actors send."""
FIRST_POINTS = 400
"""So many are taken at once at the beginning, so that there is something to see."""
REACHED_DRAWN_SECS, REACHED_THIN_SECS = 1.0, 10.0
NOW_THIN_SECS = 0.5
"""Times between rows, and between rows of the file."""
NEAR_SHARE = 0.08
"""Names of points that are nearer to one another than this share of the shape's size are written together."""


@dataclass(frozen=True)
class _Newest:
    heard_secs: float
    posture: Floats
    shades: Colours
    path: Floats


class PointScene:
    """The panel of a `PointWorld`."""

    def __init__(self, world: PointWorld, block: str) -> None:
        """`block` is the one by whose latents points are coloured."""
        self.look = look_at_shape(world.body)
        self._body = world.body
        self._block = block
        self._near = NEAR_SHARE * float(np.linalg.norm(world.body.extent))
        self._pen = Pen(solid=True)
        self._actors: dict[str, _Newest] = {}
        self._reached = _Reached()
        self._due, self._thin = Due(REACHED_DRAWN_SECS), Due(REACHED_THIN_SECS)
        self._now_thin = Due(NOW_THIN_SECS)
        self._fresh = self._fresh_reached = False

    def hear(self, view: View, now_secs: float) -> bool:
        """Take in postures with or without latents; False for some that are none of this world."""
        if view.view == "latent" and (view.block != self._block or "posture" not in view.arrays):
            return True
        arrays = {name: np.asarray(array, np.float32) for name, array in view.arrays.items()}
        posture, latent = arrays["posture"], arrays.get("latent")
        path = arrays.get("path", posture[:0])
        if any(each.shape[1] != 3 or not np.isfinite(each).all() for each in (posture, path)):
            return False
        if not len(posture):
            return False
        if view.life not in self._actors and len(self._actors) >= MOST_ACTORS:
            return False
        shades = _shades(latent, len(posture))
        self._actors[view.life] = _Newest(now_secs, posture, shades, path)
        self._reached.add(posture, shades, now_secs)
        self._fresh = self._fresh_reached = True
        return True

    def begin(self, canvas: Canvas) -> None:
        """The wires, and what was reached so far."""
        lines = [line.astype(np.float32) for line in wire_frame(self._body)]
        canvas.log(SHAPE, self._pen.strips(lines, [DIM] * len(lines), width_px=1.3), static=True)
        self._draw_reached(canvas, thin=True)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Where actors are as often as it is heard, what they reached once a second."""
        silent = [life for life, each in self._actors.items() if now_secs - each.heard_secs > SILENT_SECS]
        for life in silent:
            del self._actors[life]
        if self._fresh or silent:
            self._fresh = False
            self._draw_now(canvas, thin=self._now_thin(now_secs) or not self._actors)
        if self._fresh_reached and self._due(now_secs):
            self._fresh_reached = False
            self._draw_reached(canvas, thin=self._thin(now_secs))

    def _draw_reached(self, canvas: Canvas, *, thin: bool) -> None:
        points, shades = self._reached.points, self._reached.shades
        canvas.log(REACHED, self._pen.points(points, shades.tolist(), radius_px=2.2, order=1), thin=thin)

    def _draw_now(self, canvas: Canvas, *, thin: bool) -> None:
        """All columns of all actors; the first of each larger, with its way and its name."""
        names = sorted(self._actors, key=label_order)
        actors = [self._actors[name] for name in names]
        firsts = _stacked([each.posture[:1] for each in actors])
        others = _stacked([each.posture[1:] for each in actors])
        shades = [int(each.shades[0]) for each in actors]
        other_shades = [int(shade) for each in actors for shade in each.shades[1:]]
        heads, texts = grouped(firsts, names, self._near)
        rows = {
            f"{NOW}/others": self._pen.points(others, other_shades, radius_px=4, order=2),
            PATH: self._pen.strips([each.path for each in actors], shades, width_px=2.5),
            NOW: self._pen.points(firsts, [WHITE] * len(firsts), radius_px=7, order=3),
            f"{NOW}/names": self._pen.names(firsts[heads], texts, [WHITE] * len(heads)),
        }
        for path, archetype in rows.items():
            canvas.log(path, archetype, thin=thin)


class _Reached:
    """A sample of the points of the last while; each keeps its place until it is replaced."""

    def __init__(self) -> None:
        self._rng = np.random.default_rng(0)
        self._points = np.zeros((MOST_REACHED, 3), np.float32)
        self._shades = np.zeros(MOST_REACHED, np.uint32)
        self._taken = 0
        self._room = float(FIRST_POINTS)
        self._filled_secs: float | None = None

    @property
    def points(self) -> Floats:
        """(n, 3)"""
        return self._points[: self._taken]

    @property
    def shades(self) -> Colours:
        """(n,)"""
        return self._shades[: self._taken]

    def add(self, points: Floats, shades: Colours, now_secs: float) -> None:
        """Take some of them, at random, as many as there is room for by now."""
        if self._filled_secs is not None:
            grown = (now_secs - self._filled_secs) * MOST_REACHED / REACHED_SECS
            self._room = min(self._room + grown, float(FIRST_POINTS))
        self._filled_secs = now_secs
        chosen = self._rng.permutation(len(points))[: int(self._room)]
        self._room -= len(chosen)
        empty = np.arange(self._taken, min(self._taken + len(chosen), MOST_REACHED))
        old = self._rng.integers(MOST_REACHED, size=len(chosen) - len(empty))
        places = np.concatenate([empty, old])
        self._points[places], self._shades[places] = points[chosen], shades[chosen]
        self._taken += len(empty)


def _shades(latent: Floats | None, number: int) -> Colours:
    """(E,) the colours of the nearest vertices; grey where there are no latents, or none that are numbers."""
    shades = np.full(number, GREY, np.uint32)
    if latent is not None:
        known = np.isfinite(latent).all(axis=1)
        shades[known] = [of_index(int(vertex)) for vertex in latent[known].argmax(axis=1)]
    return shades


def _stacked(parts: list[Floats]) -> Floats:
    return np.concatenate(parts) if parts else np.zeros((0, 3), np.float32)
