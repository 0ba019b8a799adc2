"""Measures of the latents that actors show: distance to the goal, entropy, and the use of each vertex."""

from collections.abc import Mapping

import numpy as np

from services.dashboard.canvas import Canvas, Due, Lines
from services.dashboard.colours import GREY, ORANGE, SKY, of_index
from services.dashboard.latent_book import Floats, LatentBook

DISTANCE_SECS = 0.5
SPREAD_SECS = 1.0
THIN_SECS = 2.0
THIN_SPREAD_SECS = 5.0


def latent_entropy(latents: Floats) -> float:
    """Mean entropy of the latents (n, d), 0 at a vertex and 1 in the middle; NaN of none."""
    if not len(latents):
        return float("nan")
    shares = np.clip(latents.astype(np.float64), 1e-9, 1.0)
    return float(-(shares * np.log(shares)).sum(axis=1).mean() / np.log(latents.shape[1]))


def vertex_usage(latents: Floats) -> Floats:
    """(d,) the share of the latents (n, d) that are nearest to each vertex; zeros of none."""
    counts = np.bincount(latents.argmax(axis=1), minlength=latents.shape[1])
    return np.asarray(counts / max(1, len(latents)), np.float32)


def usage_entropy(usage: Floats) -> float:
    """Entropy of the usage (d,): 1 if all vertices are used alike, 0 if only one is."""
    used = usage[usage > 0].astype(np.float64)
    return float(abs((used * np.log(used)).sum()) / np.log(len(usage)))


class MeasuresPanel:
    """Lines for each block, under /measures/<block>."""

    def __init__(self, books: Mapping[str, LatentBook]) -> None:
        self._books = books
        self._lines = Lines()
        self._due, self._thin = Due(DISTANCE_SECS), Due(THIN_SECS)
        self._spread_due, self._thin_spread = Due(SPREAD_SECS), Due(THIN_SPREAD_SECS)
        self._seen: dict[str, int] = {}

    def begin(self, canvas: Canvas) -> None:
        """Name the lines."""
        self._lines.begin(canvas)
        for block, book in self._books.items():
            root = f"/measures/{block}"
            self._lines.name(canvas, f"{root}/goal_distance/p90", "p90", GREY)
            self._lines.name(canvas, f"{root}/goal_distance/mean", "mean", SKY, 2.0)
            self._lines.name(canvas, f"{root}/latent_entropy", "of one latent", SKY)
            self._lines.name(canvas, f"{root}/usage_entropy", "of the use of vertices", ORANGE)
            for vertex in range(book.latent_dim):
                self._lines.name(canvas, f"{root}/usage/{vertex}", f"g{vertex}", of_index(vertex), 2.0)

    def draw(self, canvas: Canvas, now_secs: float) -> None:
        """Log distances twice a second, the rest once; nothing while nobody acts."""
        if self._due(now_secs):
            thin = self._thin(now_secs)
            for book in self._books.values():
                self._draw_distance(canvas, book, now_secs, thin=thin)
        if self._spread_due(now_secs):
            thin = self._thin_spread(now_secs)
            for block, book in self._books.items():
                if book.changes != self._seen.get(block, 0):
                    self._seen[block] = book.changes
                    self._draw_spread(canvas, book, thin=thin)

    def _draw_distance(self, canvas: Canvas, book: LatentBook, now_secs: float, *, thin: bool) -> None:
        distances = [newest.distances for newest in book.acting(now_secs)]
        flat = np.concatenate(distances) if distances else np.zeros(0)
        if len(flat):
            root = f"/measures/{book.block}/goal_distance"
            self._lines.add(canvas, f"{root}/mean", float(flat.mean()), thin=thin)
            self._lines.add(canvas, f"{root}/p90", float(np.quantile(flat, 0.9)), thin=thin)

    def _draw_spread(self, canvas: Canvas, book: LatentBook, *, thin: bool) -> None:
        root, usage = f"/measures/{book.block}", vertex_usage(book.cloud)
        self._lines.add(canvas, f"{root}/latent_entropy", latent_entropy(book.cloud), thin=thin)
        self._lines.add(canvas, f"{root}/usage_entropy", usage_entropy(usage), thin=thin)
        for vertex, share in enumerate(usage):
            self._lines.add(canvas, f"{root}/usage/{vertex}", float(share), thin=thin)
