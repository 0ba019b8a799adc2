"""The bodies of the shape worlds: where a point may be, and where a wall puts one that left.

All functions take and return (N, 3) float64 arrays. A wall slides: a point outside goes to the
nearest point of the body in the Euclidean sense (scaling it back radially would lose the poles).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

Points = NDArray[np.float64]
Triple = tuple[float, float, float]

AXES = (0, 1, 2)
NEWTON_STEPS = 64
"""Bound of the ellipsoid's Newton iteration, which needs fewer than ten for a step past the wall."""


class Body(Protocol):
    """A solid around the origin."""

    @property
    def diameter(self) -> float:
        """The greatest distance between two of its points."""
        ...

    def span(self, axes: Sequence[int]) -> float:
        """The greatest distance between two of its points in these of the axes 0, 1 and 2; 0 for none."""
        ...

    @property
    def extent(self) -> Points:
        """(3,) half sizes of the box around it."""
        ...

    def nearest(self, points: Points) -> Points:
        """The nearest point of the body to each of the points; points inside stay."""
        ...

    def uniform(self, count: int, rng: np.random.Generator) -> Points:
        """`count` points drawn uniformly from the body."""
        ...


@dataclass(frozen=True)
class CuboidBody:
    """A box with the given half sizes."""

    half_sizes: Triple

    def __post_init__(self) -> None:
        object.__setattr__(self, "half_sizes", positive_triple("half_sizes", self.half_sizes))

    @property
    def diameter(self) -> float:
        """Its space diagonal."""
        return self.span(AXES)

    def span(self, axes: Sequence[int]) -> float:
        """The diagonal of its projection."""
        return 2 * math.hypot(*(self.half_sizes[axis] for axis in axes))

    @cached_property
    def extent(self) -> Points:
        """The half sizes."""
        return np.array(self.half_sizes)

    def nearest(self, points: Points) -> Points:
        """Each coordinate clipped to its wall."""
        return np.minimum(np.maximum(points, -self.extent), self.extent)

    def uniform(self, count: int, rng: np.random.Generator) -> Points:
        """Uniform per axis."""
        return rng.uniform(-1, 1, (count, 3)) * self.extent


@dataclass(frozen=True)
class EllipsoidBody:
    """An ellipsoid with the given semi-axes."""

    semi_axes: Triple

    def __post_init__(self) -> None:
        object.__setattr__(self, "semi_axes", positive_triple("semi_axes", self.semi_axes))

    @property
    def diameter(self) -> float:
        """Its longest axis."""
        return self.span(AXES)

    def span(self, axes: Sequence[int]) -> float:
        """The longest axis of its projection."""
        return 2 * max((self.semi_axes[axis] for axis in axes), default=0.0)

    @cached_property
    def extent(self) -> Points:
        """The semi-axes."""
        return np.array(self.semi_axes)

    def nearest(self, points: Points) -> Points:
        """The foot of the normal through each point outside.

        The foot is a^2 y / (a^2 + t) for the t >= 0 that puts it on the surface. The equation's left
        side is convex and falls with t, so Newton's method from a lower bound never overshoots.
        """
        outside = np.flatnonzero(((points / self.extent) ** 2).sum(axis=1) > 1)
        if not outside.size:
            return points
        squares, far = self.extent**2, points[outside]
        reach = self.extent * np.abs(far)
        t = np.maximum((reach - squares).max(axis=1), 0.0)
        for _ in range(NEWTON_STEPS):
            terms = (reach / (squares + t[:, None])) ** 2
            excess = terms.sum(axis=1) - 1
            if excess.max() <= 1e-14:
                break
            slope = 2 * (terms / (squares + t[:, None])).sum(axis=1)
            t += np.maximum(excess, 0.0) / slope
        result = points.copy()
        result[outside] = squares * far / (squares + t[:, None])
        return result

    def uniform(self, count: int, rng: np.random.Generator) -> Points:
        """Uniform in the unit ball, stretched."""
        return _in_unit_ball(count, rng) * self.extent


@dataclass(frozen=True)
class DumbbellBody:
    """Two balls on the x axis and the cylinder that joins their centres."""

    lobe_centre: float
    lobe_radius: float
    bridge_radius: float

    def __post_init__(self) -> None:
        for name in ("lobe_centre", "lobe_radius", "bridge_radius"):
            object.__setattr__(self, name, positive(name, getattr(self, name)))
        if not self.bridge_radius < self.lobe_radius < self.lobe_centre:
            raise ValueError(
                "a dumbbell needs bridge_radius < lobe_radius < lobe_centre, got "
                f"{self.bridge_radius:g}, {self.lobe_radius:g} and {self.lobe_centre:g}"
            )

    @property
    def diameter(self) -> float:
        """From the outer end of one lobe to that of the other."""
        return self.span(AXES)

    def span(self, axes: Sequence[int]) -> float:
        """End to end where the long axis is among them, else across a lobe."""
        if 0 in axes:
            return 2 * (self.lobe_centre + self.lobe_radius)
        return 2 * self.lobe_radius if axes else 0.0

    @cached_property
    def extent(self) -> Points:
        """The box around both lobes."""
        return np.array([self.lobe_centre + self.lobe_radius, self.lobe_radius, self.lobe_radius])

    def nearest(self, points: Points) -> Points:
        """The nearest of the nearest points of the three parts."""
        parts = np.stack([self._lobe(points, -1.0), self._lobe(points, 1.0), self._bridge(points)])
        distances = ((parts - points) ** 2).sum(axis=2)
        return np.asarray(parts[distances.argmin(axis=0), np.arange(len(points))])

    def uniform(self, count: int, rng: np.random.Generator) -> Points:
        """Uniform in the box around it, kept where it falls inside."""
        found = np.empty((0, 3))
        while len(found) < count:
            drawn = rng.uniform(-1, 1, (2 * count + 16, 3)) * self.extent
            found = np.concatenate([found, drawn[(self.nearest(drawn) == drawn).all(axis=1)]])
        return found[:count]

    def _lobe(self, points: Points, side: float) -> Points:
        centre = np.array([side * self.lobe_centre, 0.0, 0.0])
        away = points - centre
        distance = np.sqrt((away**2).sum(axis=1, keepdims=True))
        pulled = centre + away * (self.lobe_radius / np.maximum(distance, self.lobe_radius))
        return np.where(distance > self.lobe_radius, pulled, points)

    def _bridge(self, points: Points) -> Points:
        x = np.clip(points[:, :1], -self.lobe_centre, self.lobe_centre)
        across = points[:, 1:]
        distance = np.sqrt((across**2).sum(axis=1, keepdims=True))
        pulled = across * (self.bridge_radius / np.maximum(distance, self.bridge_radius))
        return np.concatenate([x, np.where(distance > self.bridge_radius, pulled, across)], axis=1)


def positive(name: str, value: object) -> float:
    """`value` as a float. Raises ValueError unless it is a positive finite number."""
    if isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool):
        number = float(value)
        if math.isfinite(number) and number > 0:
            return number
    raise ValueError(f"{name} must be a positive number, got {value!r}")


def positive_triple(name: str, value: object) -> Triple:
    """`value` as three floats. Raises ValueError unless it is three positive finite numbers."""
    if isinstance(value, Sequence | np.ndarray) and not isinstance(value, str) and len(value) == 3:
        x, y, z = (positive(f"each of {name}", part) for part in value)
        return x, y, z
    raise ValueError(f"{name} must be three positive numbers, got {value!r}")


def _in_unit_ball(count: int, rng: np.random.Generator) -> Points:
    direction = rng.standard_normal((count, 3))
    direction /= np.sqrt((direction**2).sum(axis=1, keepdims=True))
    return np.asarray(direction * rng.random((count, 1)) ** (1 / 3))
