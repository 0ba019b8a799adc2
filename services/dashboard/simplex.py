"""Where latents lie on the page: the simplex of d vertices as line, triangle, tetrahedron or polygon (pure).

A polygon of more than four vertices is not one-to-one: opposite vertices cancel to its middle. It is
fixed and labelled all the same, which a projection fitted to the data would not be.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float32]

LABEL_GAP, SOLID_LABEL_GAP = 1.13, 1.24
"""Names of vertices stand so far out, as a multiple of the distance from the middle."""

DOTS = (
    "Small dots are recent latents in the colour of their nearest vertex. Large ones are the actors now, "
    "with their way, in the colour of their goal; goals glow, the more the more worlds go there."
)
READINGS = {
    2: "Above the line recent latents, spread in height only to be told apart; below it a lane for each "
    "actor, with its past upwards. ",
    3: "",
    4: "Turn the tetrahedron with the mouse. ",
}
FLATTENED = (
    "The simplex of {} vertices is flattened to a polygon: opposite vertices cancel, and a point in the "
    "middle may lie between two of them. The distance to the goal is that on the whole simplex. "
)


@dataclass(frozen=True)
class Simplex:
    """A drawing of the simplex; on the flat ones y points down, as in Rerun's 2-D views."""

    vertices: Floats
    """(d, 2), or (d, 3) for the tetrahedron"""
    edges: NDArray[np.intp]
    """(m, 2) pairs of vertices that are joined"""
    reading: str
    """how to read the drawing and what it does not show, for a person"""

    @property
    def latent_dim(self) -> int:
        """The number of vertices."""
        return len(self.vertices)

    @property
    def flattened(self) -> bool:
        """True if different latents may lie at the same place."""
        return self.latent_dim > self.vertices.shape[1] + 1

    @property
    def solid(self) -> bool:
        """True if it is drawn in 3-D."""
        return self.vertices.shape[1] == 3

    def place(self, latents: Floats) -> Floats:
        """Latents (n, d) as points of the page (n, 2 or 3): means of the vertices, weighed by them."""
        return np.asarray(latents @ self.vertices, np.float32)

    def labels(self) -> Floats:
        """Where the vertices' names stand: (d, 2 or 3), outside the drawing."""
        return np.asarray(self.vertices * (SOLID_LABEL_GAP if self.solid else LABEL_GAP), np.float32)

    def middle(self) -> Floats:
        """(1, 2 or 3) where all vertices weigh the same."""
        return np.asarray(self.vertices.mean(axis=0, keepdims=True), np.float32)

    def bounds(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """((left, right), (top, bottom)) of a flat drawing with its names."""
        low, high = self.labels()[:, :2].min(axis=0), self.labels()[:, :2].max(axis=0)
        return (float(low[0]) - 0.1, float(high[0]) + 0.1), (float(low[1]) - 0.1, float(high[1]) + 0.15)


def simplex_of(latent_dim: int) -> Simplex:
    """The drawing for d vertices, d >= 2."""
    if latent_dim == 2:
        vertices = np.array([[-1, 0], [1, 0]])
    elif latent_dim == 4:
        vertices = _tetrahedron()
    else:
        angles = 2 * math.pi * np.arange(latent_dim) / latent_dim - math.pi / 2
        vertices = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    reading = READINGS.get(latent_dim, FLATTENED.format(latent_dim)) + DOTS
    if latent_dim <= 4:
        edges = np.argwhere(np.triu(np.ones((latent_dim, latent_dim)), 1))
        return Simplex(vertices.astype(np.float32), edges, reading)
    around = np.stack([np.arange(latent_dim), (np.arange(latent_dim) + 1) % latent_dim], axis=1)
    return Simplex(vertices.astype(np.float32), around, reading)


def _tetrahedron() -> NDArray[np.float64]:
    """Corners at distance 1 from the middle, the first on top; z points up."""
    around = 2 * math.pi * np.arange(3) / 3 - math.pi / 2
    ring = math.sqrt(8) / 3
    base = np.stack([ring * np.cos(around), ring * np.sin(around), np.full(3, -1 / 3)], axis=1)
    return np.concatenate([[[0.0, 0.0, 1.0]], base])
