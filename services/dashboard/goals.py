"""The flow of goals through a tree of blocks: a picture of the tree, and lanes and lines over time.

All of it is one actor's first column: what each block aims at, and how near it is to that.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr

from services.dashboard.canvas import Canvas, Due, Lines, colours, page
from services.dashboard.colours import DIM, GREY, WHITE, Colour, of_index
from services.dashboard.latent_book import Floats, LatentBook, Newest, label_order
from services.dashboard.pens import Pen
from services.dashboard.tree import BLOCK, Tree

DRAW_SECS = 0.2
MOST_DRAWN_PER_SEC = 50.0
"""Of all blocks together: with more blocks the picture is drawn less often."""
THIN_SECS = 2.0
RING = 0.34
"""Radius of a block, where a leaf takes a height of 1."""
GAUGE = 0.29
"""Radius of the disc of a block that has arrived."""
WAY_HIGH, WAY_LOW = 0.08, 0.38
"""Right of a block its way is drawn, between these heights: at its goal, and as far from it as can be."""
NAME_HEIGHT = -0.5
"""The text of a block hangs there."""
HEADING, FOOT = 1.2, 0.6
"""So far above the first leaf are the names of the levels, and below the last the actor's."""
CIRCLE = 2 * np.pi * np.linspace(0, 1, 33)
ALONG = np.linspace(0, 1, 17)
IDLE = "idle"
READING = (
    "The first column of one actor. The colour of a block, and of the line that leads to it, is the vertex "
    "that it aims at; the disc is full when it is there (its area is z_goal, the latent's share of that "
    "vertex). The curve is z_goal over its last steps. Grey lines carry no goal; grey blocks are idle."
)


@dataclass(frozen=True)
class Aim:
    """What a block does in the first column."""

    goal: int
    near: float
    """z_goal, the latent's share of the goal's vertex"""
    way: Floats
    """(K,) z_goal over the last steps, the newest last"""

    @classmethod
    def of(cls, newest: Newest) -> "Aim | None":
        """None without a goal."""
        if newest.goal is None:
            return None
        goal = int(newest.goal[0].argmax())
        return cls(goal, float(newest.latent[0, goal]), newest.trail[:, goal])


class GoalsPanel:
    """Under /goals: tree (the picture), aim (lanes) and near (lines); nothing if there is one level."""

    def __init__(self, tree: Tree, books: Mapping[str, LatentBook]) -> None:
        self._tree, self._books = tree, books
        self._order = tree.order() if tree.deep else []
        self._picture = _Picture(tree)
        self._lines = Lines()
        secs = max(DRAW_SECS, len(books) / MOST_DRAWN_PER_SEC)
        self._due, self._thin = Due(secs), Due(THIN_SECS)
        self._drawn: tuple[str, list[int]] | None = None

    def begin(self, canvas: Canvas) -> None:
        """Log what stands still."""
        if not self._order:
            return
        self._lines.begin(canvas)
        self._picture.begin(canvas)
        self._picture.draw(canvas, {}, "", thin=True)
        self._drawn = None
        for index, name in enumerate(self._order):
            self._lines.name(canvas, near_path(name), name, of_index(index))
            vertices = range(self._books[name].latent_dim)
            states = rr.StateConfiguration(
                values=[*(f"g{vertex}" for vertex in vertices), IDLE],
                colors=colours([*(of_index(vertex) for vertex in vertices), DIM]),
            )
            canvas.log(aim_path(self._tree, name), states, static=True)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log what each block aims at, if any has moved."""
        if not self._order or not self._due(now_secs):
            return
        label, newest = _of_one_actor([self._books[name] for name in self._order], now_secs)
        state = label, [self._books[name].changes for name in self._order]
        if state == self._drawn:
            return
        self._drawn = state
        aims = {name: aim for name, one in newest.items() if (aim := Aim.of(one)) is not None}
        thin = self._thin(now_secs) or not aims
        self._picture.draw(canvas, aims, label, thin=thin)
        for name in self._order:
            aim = aims.get(name)
            said = IDLE if aim is None else f"g{aim.goal}"
            canvas.log(aim_path(self._tree, name), rr.StateChange(state=said), thin=thin)
            self._lines.add(canvas, near_path(name), None if aim is None else aim.near, thin=thin)


def aim_path(tree: Tree, name: str) -> str:
    """The lane of a block; lanes are shown by their paths, so the number puts children after their parent."""
    return f"/goals/aim/{tree.order().index(name):02}/{name}"


def near_path(name: str) -> str:
    """The line of a block's z_goal."""
    return f"/goals/near/{name}"


class _Picture:
    """Blocks as rings, each filled as near as it is to its goal, and joined to the one above it."""

    def __init__(self, tree: Tree) -> None:
        self._tree = tree
        self._places = tree.places()
        self._pairs = [(parent, child) for child, parent in tree.parents.items()]
        self._pen = Pen(solid=False)

    def begin(self, canvas: Canvas) -> None:
        pen, places = self._pen, self._places
        canvas.log("/status/reading/goals", page(READING), static=True)
        across = [places[names[0]][0] + BLOCK for names in self._tree.levels]
        heads = np.array([[x, -HEADING] for x in across], np.float32)
        words = [f"Level {level}" for level in range(len(across))]
        canvas.log("/goals/tree/levels", pen.names(heads, words, [WHITE] * len(words)), static=True)
        # Without colours, which change while all else stands still.
        rings = rr.LineStrips2D.from_fields(
            strips=[place + RING * _circle() for place in places.values()], radii=[-1.2], draw_order=3
        )
        edges = rr.LineStrips2D.from_fields(
            strips=[_bent(places[parent], places[child], self._tree.reach) for parent, child in self._pairs],
            radii=[-1.2],
            draw_order=1,
        )
        canvas.log("/goals/tree/rings", rings, static=True)
        canvas.log("/goals/tree/edges", edges, static=True)

    def draw(self, canvas: Canvas, aims: Mapping[str, Aim], label: str, *, thin: bool) -> None:
        pen, places = self._pen, self._places
        shades = {name: of_index(aims[name].goal) if name in aims else DIM for name in places}
        given = [shades[child] if parent in aims else DIM for parent, child in self._pairs]
        acting = [name for name in places if name in aims]
        discs = rr.Points2D(
            np.array([places[name] for name in acting], np.float32).reshape(-1, 2),
            radii=[GAUGE * float(np.sqrt(np.clip(aims[name].near, 0, 1))) for name in acting],
            colors=colours([shades[name] for name in acting]),
            draw_order=4,
        )
        ways = [_way(places[name], aims[name].way, self._tree.reach) for name in acting]
        foot = np.array([[BLOCK, max(place[1] for place in places.values()) + FOOT]], np.float32)
        log = {
            "edges": rr.LineStrips2D.from_fields(colors=colours(given)),
            "rings": rr.LineStrips2D.from_fields(colors=colours(list(shades.values()))),
            "discs": discs,
            "ways": pen.strips(ways, [shades[name] for name in acting], width_px=1.5, order=2),
            "names": self._words(aims, shades),
            "actor": pen.names(foot[: len(acting)], [f"of {label}"][: len(acting)], [WHITE]),
        }
        for name, archetype in log.items():
            canvas.log(f"/goals/tree/{name}", archetype, thin=thin)

    def _words(self, aims: Mapping[str, Aim], shades: Mapping[str, Colour]) -> rr.AsComponents:
        """Beside each block its name, and what it aims at."""
        texts = {
            name: f"{name}  g{aims[name].goal}  {aims[name].near:.2f}" if name in aims else name
            for name in self._places
        }
        at = [
            place + np.array([BLOCK + self._tree.width(len(texts[name])) / 2, NAME_HEIGHT])
            for name, place in self._places.items()
        ]
        tones = [shades[name] if name in aims else GREY for name in texts]
        return self._pen.names(np.array(at, np.float32), list(texts.values()), tones)


def tree_bounds(tree: Tree) -> tuple[tuple[float, float], tuple[float, float]]:
    """((left, right), (top, bottom)) of the picture."""
    places = np.array(list(tree.places().values()))
    (left, top), (right, bottom) = places.min(axis=0), places.max(axis=0)
    return (float(left) - 0.9, float(right) + tree.reach + 0.3), (float(top) - 1.5, float(bottom) + 1.5)


def _of_one_actor(books: Sequence[LatentBook], now_secs: float) -> tuple[str, dict[str, Newest]]:
    """The first actor that acts in any block, and its newest of each block; ("", {}) if there is none."""
    acting = {book.block: {newest.label: newest for newest in book.acting(now_secs)} for book in books}
    label = min({label for newest in acting.values() for label in newest}, key=label_order, default="")
    return label, {block: newest[label] for block, newest in acting.items() if label in newest}


def _circle() -> Floats:
    return np.stack([np.cos(CIRCLE), np.sin(CIRCLE)], axis=1).astype(np.float32)


def _way(place: Floats, near: Floats, reach: float) -> Floats:
    """(K, 2) the curve of z_goal (K,) beside a block."""
    across = np.linspace(BLOCK, reach, len(near))
    heights = WAY_LOW + (WAY_HIGH - WAY_LOW) * near
    return np.asarray(place + np.stack([across, heights], axis=1), np.float32)


def _bent(parent: Floats, child: Floats, reach: float) -> Floats:
    """(17, 2) a line from the end of what belongs to the parent to the child's ring, level at both ends."""
    start, stop = parent + np.array([reach + 0.1, 0]), child - np.array([RING + 0.05, 0])
    smooth = ALONG * ALONG * (3 - 2 * ALONG)
    line = start + (stop - start) * np.stack([ALONG, smooth], axis=1)
    return np.asarray(line, np.float32)
