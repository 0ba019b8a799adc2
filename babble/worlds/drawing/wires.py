"""Shapes as wire frames: lines that follow their surfaces."""

import itertools
from collections.abc import Callable

import numpy as np

from babble.worlds.geometry import Body, DumbbellBody, EllipsoidBody, Points

STEPS = 48
"""Of a whole circle."""
MERIDIANS = 8
CIRCLES = 7


def wire_frame(body: Body) -> list[Points]:
    """Lines (n, 3) on the body's surface; of a cuboid, or a body of unknown shape, the edges of its box."""
    if isinstance(body, EllipsoidBody):
        return [line * body.extent for line in _round(_ball_profile(), np.linspace(-1, 1, CIRCLES + 2))]
    if isinstance(body, DumbbellBody):
        return _dumbbell(body)
    return _edges(body.extent)


def _edges(half_sizes: Points) -> list[Points]:
    """The twelve edges of a box."""
    edges = []
    for axis, (one, other) in itertools.product(range(3), itertools.product((-1.0, 1.0), repeat=2)):
        ends = np.insert([[one, other]] * 2, axis, [-1.0, 1.0], axis=1)
        edges.append(ends * half_sizes)
    return edges


def _dumbbell(body: DumbbellBody) -> list[Points]:
    """The lobes meet the bridge where a lobe is as wide as the bridge."""
    neck = body.lobe_centre - float(np.sqrt(body.lobe_radius**2 - body.bridge_radius**2))
    end = body.lobe_centre + body.lobe_radius
    lobe = neck + (end - neck) * _cosine(STEPS // 2)
    x = np.concatenate([-lobe[::-1], lobe])
    around = [0.0, neck, body.lobe_centre, (neck + body.lobe_centre) / 2, (end + body.lobe_centre) / 2]
    circles = np.array(sorted({*around, *(-place for place in around)}))

    def radius(place: Points) -> Points:
        away = np.abs(place)
        lobe = np.sqrt(np.maximum(body.lobe_radius**2 - (away - body.lobe_centre) ** 2, 0))
        return np.maximum(lobe, np.where(away < neck, body.bridge_radius, 0))

    return _round((x, radius), circles)


Profile = tuple[Points, Callable[[Points], Points]]
"""Places along x, and the radius about it at any places."""


def _ball_profile() -> Profile:
    return 2 * _cosine(STEPS) - 1, lambda place: np.sqrt(np.maximum(1 - place**2, 0))


def _round(profile: Profile, circles: Points) -> list[Points]:
    """The wires of what is round about x: lines along it, and circles at the given places."""
    x, radius = profile
    lines = []
    for angle in 2 * np.pi * np.arange(MERIDIANS) / MERIDIANS:
        lines.append(np.stack([x, radius(x) * np.cos(angle), radius(x) * np.sin(angle)], axis=1))
    angles = 2 * np.pi * np.arange(STEPS + 1) / STEPS
    for place, wide in zip(circles, radius(circles), strict=True):
        if wide > 0:
            ring = [np.full_like(angles, place), wide * np.cos(angles), wide * np.sin(angles)]
            lines.append(np.stack(ring, axis=1))
    return lines


def _cosine(steps: int) -> Points:
    """Places from 0 to 1, denser towards the ends, where round things curve away."""
    return (1 - np.cos(np.pi * np.arange(steps + 1) / steps)) / 2
