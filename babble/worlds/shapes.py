"""The simple worlds of the thesis (3.4) as Gymnasium environments: a point in a solid.

The reward is 0 and an episode never ends by itself: the goal's reward is computed from the latent
(babble.policy.goals.reward), and a time limit is the user's choice.
"""

import inspect
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium import spaces

from babble.worlds.batch import Floats, PointWorld
from babble.worlds.geometry import Body, CuboidBody, DumbbellBody, EllipsoidBody, positive

HALF_SIZES = (1.0, 0.6, 0.3)
SPEED = 0.08
LOBE_CENTRE = 0.9
LOBE_RADIUS = 0.5
BRIDGE_RADIUS = 0.15


class Shape(gymnasium.Env[Floats, Floats]):
    """A point in a body: observation = position (3,) float32, action = velocity / speed in [-1, 1]^3."""

    metadata: ClassVar[dict[str, Any]] = {"render_modes": []}
    crossing_axis: ClassVar[int | None] = None

    def __init__(self, body: Body, speed: float) -> None:
        self.body = body
        self.speed = positive("speed", speed)
        edge = body.extent.astype(np.float32)
        self.observation_space = spaces.Box(-edge, edge, dtype=np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (3,), dtype=np.float32)
        self._points = self.world(columns=1, rng=np.random.default_rng())

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """The parameters and their default values."""
        return {name: given.default for name, given in inspect.signature(cls).parameters.items()}

    @property
    def diameter(self) -> float:
        """The greatest distance between two points of the body."""
        return self.body.diameter

    def world(self, columns: int, rng: np.random.Generator) -> PointWorld:
        """`columns` copies of this environment, stepped together."""
        return PointWorld(
            type(self).__name__,
            self.body,
            speed=self.speed,
            columns=columns,
            rng=rng,
            crossing_axis=self.crossing_axis,
        )

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Start at the centre, or anywhere in the body with `options={"start": "random"}`."""
        super().reset(seed=seed)
        self._points.rng = self.np_random
        return self._points.reset((options or {}).get("start", "centre"))[0], {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """Move by speed * action; walls slide."""
        return self._points.step(np.asarray(action)[None]).observation[0], 0.0, False, False, {}


class Cuboid(Shape):
    """A box; diameter = its space diagonal."""

    def __init__(self, half_sizes: tuple[float, float, float] = HALF_SIZES, speed: float = SPEED) -> None:
        super().__init__(CuboidBody(half_sizes), speed)


class Ellipsoid(Shape):
    """An ellipsoid; diameter = its longest axis."""

    def __init__(self, semi_axes: tuple[float, float, float] = HALF_SIZES, speed: float = SPEED) -> None:
        super().__init__(EllipsoidBody(semi_axes), speed)


class Dumbbell(Shape):
    """Two balls and a narrow bridge between them along x; diameter = end to end."""

    crossing_axis = 0

    def __init__(
        self,
        lobe_centre: float = LOBE_CENTRE,
        lobe_radius: float = LOBE_RADIUS,
        bridge_radius: float = BRIDGE_RADIUS,
        speed: float = SPEED,
    ) -> None:
        super().__init__(DumbbellBody(lobe_centre, lobe_radius, bridge_radius), speed)
