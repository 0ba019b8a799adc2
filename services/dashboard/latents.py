"""Draws the latents of each block on its simplex: a cloud, where actors are, their ways and goals."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from services.dashboard.canvas import Canvas, Due, page
from services.dashboard.colours import DIM, GREY, WHITE, Colour, of_index
from services.dashboard.latent_book import CLOUD_POINTS, Floats, LatentBook, Newest
from services.dashboard.pens import Pen, grouped
from services.dashboard.simplex import Simplex, simplex_of

LATENT_SECS = 0.2
MOST_DRAWN_PER_SEC = 10.0
"""Of all blocks together: with more blocks each is drawn less often."""
CLOUD_DRAWN_SECS = 1.0
THIN_SECS = 1.0
THIN_CLOUD_SECS = 5.0
"""Times between rows of the file."""
MOST_ACTORS = 32
"""So many are drawn; all of them are in the cloud and the measures."""
NOTE = "no latents before an encoder is trained"
PULL_LENGTH = 0.16
BAND = (-0.44, -0.08)
"""d = 2: above the line lie the recent latents, apart from each other by chance alone..."""
LANES = (0.22, 1.0)
"""...and below it each actor has a lane, its way going up into the past."""


class LatentsPanel:
    """The simplex of every block."""

    def __init__(self, books: Mapping[str, LatentBook]) -> None:
        secs = max(LATENT_SECS, len(books) / MOST_DRAWN_PER_SEC)
        self._drawings = [_Drawing(book, secs) for book in books.values()]

    def begin(self, canvas: Canvas) -> None:
        """Log vertices and edges."""
        for drawing in self._drawings:
            drawing.begin(canvas)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log where the latents are."""
        for drawing in self._drawings:
            drawing.draw(canvas, now_secs)


class _Drawing:
    def __init__(self, book: LatentBook, secs: float) -> None:
        self._book = book
        self._simplex = simplex_of(book.latent_dim)
        self._pen = Pen(solid=self._simplex.solid)
        self._root = f"/latent/{book.block}"
        self._due, self._thin = Due(secs), Due(THIN_SECS)
        self._cloud_due, self._thin_cloud = Due(CLOUD_DRAWN_SECS), Due(THIN_CLOUD_SECS)
        self._drawn: tuple[int, int] | None = None
        self._noted = False
        self._cloud_drawn = 0

    def begin(self, canvas: Canvas) -> None:
        simplex, pen = self._simplex, self._pen
        names = [f"g{vertex}" for vertex in range(simplex.latent_dim)]
        shades = [of_index(vertex) for vertex in range(simplex.latent_dim)]
        corners = simplex.vertices[simplex.edges]
        canvas.log(f"{self._root}/simplex/edges", pen.strips(corners, [GREY], width_px=1.5), static=True)
        canvas.log(f"/status/reading/{self._book.block}", page(simplex.reading), static=True)
        if simplex.flattened:
            spokes = np.stack([np.zeros_like(simplex.vertices), simplex.vertices], axis=1)
            canvas.log(f"{self._root}/simplex/spokes", pen.strips(spokes, [DIM], width_px=1.0), static=True)
        canvas.log(
            f"{self._root}/simplex/vertices",
            pen.points(simplex.vertices, shades, radius_px=7, order=4),
            static=True,
        )
        canvas.log(f"{self._root}/simplex/names", pen.names(simplex.labels(), names, shades), static=True)
        if not self._book.changes:
            self._noted = True
            canvas.log(f"{self._root}/note", pen.names(simplex.middle(), [NOTE], [GREY]))

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        if self._noted and self._book.changes:
            self._noted = False
            canvas.log(f"{self._root}/note", self._pen.names(self._simplex.middle()[:0], [], []))
        if self._cloud_drawn != self._book.changes and self._cloud_due(now_secs):
            self._cloud_drawn = self._book.changes
            self._draw_cloud(canvas, thin=self._thin_cloud(now_secs))
        if not self._due(now_secs):
            return
        acting = self._book.acting(now_secs)[:MOST_ACTORS]
        state = self._book.changes, len(acting)
        if state != self._drawn:
            self._drawn = state
            self._draw_actors(canvas, acting, thin=not acting or self._thin(now_secs))

    def _draw_cloud(self, canvas: Canvas, *, thin: bool) -> None:
        cloud = self._book.cloud
        points = self._simplex.place(cloud)
        if self._simplex.latent_dim == 2:
            points[:, 1] += _scattered(len(points))
        nearest = [of_index(vertex) for vertex in cloud.argmax(axis=1)]
        shades = [self._pen.dimmed(colour) for colour in nearest]
        canvas.log(f"{self._root}/cloud", self._pen.points(points, shades, radius_px=1.6, order=1), thin=thin)

    def _draw_actors(self, canvas: Canvas, acting: Sequence[Newest], *, thin: bool) -> None:
        simplex, pen = self._simplex, self._pen
        shades = [_shade(newest) for newest in acting]
        lanes = _lanes(len(acting)) if simplex.latent_dim == 2 else np.zeros(len(acting))
        now = _stacked([simplex.place(newest.latent[:1])[0] for newest in acting], simplex)
        now[:, 1] += lanes
        ways = [self._way(newest, lane, len(acting)) for newest, lane in zip(acting, lanes, strict=True)]
        near = _near(simplex)
        heads, texts = grouped(now, [newest.label for newest in acting], near)
        pulls, origins, pulled = self._pulls(acting, now, shades)
        halo, shares = _wanted(acting, simplex)
        log = {
            "trail": pen.strips(ways, [pen.faint(colour) for colour in shades], width_px=1.5, order=2),
            "goal": pen.halos(halo, [of_index(vertex) for vertex in shares], list(shares.values())),
            "pull": pen.arrows(origins, pulls, pulled),
            "now": pen.points(now, shades, radius_px=5, order=6),
            "now/names": pen.names(now[heads], texts, [shades[head] for head in heads]),
        }
        for name, archetype in log.items():
            canvas.log(f"{self._root}/{name}", archetype, thin=thin)

    def _way(self, newest: Newest, lane: float, lanes: int) -> Floats:
        way = self._simplex.place(newest.trail)
        if self._simplex.latent_dim == 2 and len(way):
            height = 0.8 * (LANES[1] - LANES[0]) / max(lanes, 4)
            way[:, 1] += lane - height * np.linspace(1, 0, len(way))
        return way

    def _pulls(
        self, acting: Sequence[Newest], now: Floats, shades: Sequence[Colour]
    ) -> tuple[Floats, Floats, list[Colour]]:
        """Short arrows from where actors are towards their goals; none on arrival."""
        vectors, origins, kept = [], [], []
        for newest, origin, shade in zip(acting, now, shades, strict=True):
            if newest.goal is None:
                continue
            vector = self._simplex.place(newest.goal[:1] - newest.latent[:1])[0]
            length = float(np.linalg.norm(vector))
            if length > 0.05:
                vectors.append(vector * min(1.0, PULL_LENGTH / length))
                origins.append(origin)
                kept.append(shade)
        return _stacked(vectors, self._simplex), _stacked(origins, self._simplex), kept


def _shade(newest: Newest) -> Colour:
    """The colour of its first column's goal; white without one."""
    return WHITE if newest.goal is None else of_index(int(newest.goal[0].argmax()))


def _near(simplex: Simplex) -> float:
    """Actors closer than this share their names' place: lanes keep apart, and depth brings together."""
    if simplex.latent_dim == 2:
        return 0.05
    return 0.16 if simplex.solid else 0.1


def _wanted(acting: Sequence[Newest], simplex: Simplex) -> tuple[Floats, dict[int, float]]:
    """The vertices that are somebody's goal, and the share of columns that go there."""
    goals = [newest.goal.argmax(axis=1) for newest in acting if newest.goal is not None]
    counts = np.bincount(np.concatenate(goals), minlength=simplex.latent_dim) if goals else np.zeros(0)
    shares = {int(vertex): float(counts[vertex] / counts.sum()) for vertex in np.flatnonzero(counts)}
    return simplex.vertices[list(shares)], shares


def _stacked(rows: Sequence[NDArray[np.floating]], simplex: Simplex) -> Floats:
    return np.asarray(rows, np.float32).reshape(len(rows), simplex.vertices.shape[1])


def _lanes(count: int) -> Floats:
    """(n,) where the lanes of actors lie, d = 2."""
    top, bottom = LANES
    return np.asarray(top + (bottom - top) * np.arange(count) / max(count - 1, 3), np.float32)


def _scattered(count: int) -> Floats:
    """(n,) heights within the band, evenly spread and always the same for the same place in the cloud."""
    golden = 0.6180339887
    return np.asarray(
        BAND[0] + (BAND[1] - BAND[0]) * (np.arange(CLOUD_POINTS)[:count] * golden % 1.0), np.float32
    )


def line_bounds() -> tuple[tuple[float, float], tuple[float, float]]:
    """((left, right), (top, bottom)) of the drawing for d = 2."""
    return (-1.25, 1.25), (BAND[0] - 0.1, LANES[1] + 0.12)
