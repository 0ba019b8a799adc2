"""What a world is: copies of one body, stepped together, as actors use them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from babble.landmarks import Landmark
from babble.worlds.geometry import Body, Points

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Start = Literal["centre", "random"]


@dataclass(frozen=True)
class Step:
    """What one step of all copies gave."""

    observation: Floats
    """(E, n) what the step arrived at, also where it ended an episode"""
    terminated: Flags
    """(E,) the episode ended for good"""
    truncated: Flags
    """(E,) the episode was cut off and could have gone on"""
    external_reward: Floats
    """(E,) the task's own reward, 0 without one; for the goal's see babble.policy.goals.reward"""
    failed: Flags | None = None
    """(E,) the simulation broke down: these columns' numbers mean nothing, and they must be restarted;
    None where that cannot happen"""


class World(Protocol):
    """`columns` copies (E) of one body."""

    @property
    def id(self) -> str:
        """Its name in babble.worlds.WORLDS."""
        ...

    @property
    def columns(self) -> int:
        """E, the number of copies."""
        ...

    @property
    def observation_size(self) -> int:
        """n, the length of one observation."""
        ...

    @property
    def senses(self) -> Mapping[str, tuple[int, ...]]:
        """The shape of each sense, in the order in which they, flattened, make up an observation."""
        ...

    @property
    def action_size(self) -> int:
        """a, the length of one action; each component acts within [-1, 1]."""
        ...

    @property
    def observation_names(self) -> tuple[str, ...]:
        """(n,) "sense/component", such as "position/robot:left_knee"; numbers may share a name."""
        ...

    @property
    def action_names(self) -> tuple[str, ...]:
        """(a,) the actuators, such as "act:left_knee"; components may share a name."""
        ...

    @property
    def posture_size(self) -> int:
        """p, the length of one posture."""
        ...

    @property
    def moves(self) -> tuple[tuple[int, ...], ...]:
        """(a,) for each component of the action, the components of the posture that it moves by itself."""
        ...

    @property
    def diameter(self) -> float:
        """The greatest distance between two postures, the unit of separation."""
        ...

    def span(self, components: Sequence[int]) -> float:
        """The greatest distance between two postures in these components alone."""
        ...

    @property
    def crossing_axis(self) -> int | None:
        """The component of the posture whose sign tells two halves apart; None where there are none."""
        ...

    @property
    def posture_names(self) -> tuple[str, ...]:
        """The names of the posture's components, such as joints; empty where they have none."""
        ...

    @property
    def state_names(self) -> tuple[str, ...]:
        """(s,) the names of the state's components: "position/<what>", then "velocity/<what>" if any."""
        ...

    @property
    def rewarded(self) -> bool:
        """Whether there is a task with an external reward; without one it is always 0."""
        ...

    @property
    def landmarks(self) -> tuple[Landmark, ...]:
        """The postures that have a name; scores say how often each is reached. Empty where there are none."""
        ...

    def reset(self, start: Start = "centre") -> Floats:
        """Put all copies at the centre or at uniformly random places; the observations (E, n)."""
        ...

    def step(self, action: Floats) -> Step:
        """Act in all copies by (E, a), clipped to [-1, 1]. Raises ValueError for a wrong shape or NaN."""
        ...

    def restart(self, columns: Flags) -> Floats:
        """Begin a new episode in the flagged copies (E,); returns the observations (E, n) of all."""
        ...

    def posture(self) -> Floats:
        """(E, p) where the copies are; its distances define separation."""
        ...

    def side(self) -> Floats | None:
        """(E,) from 1 for lying on the back to -1 for the belly; None for a body whose sides do not count."""
        ...

    def state(self) -> Floats:
        """(E, s) how the copies are and move, in the body's own units, whatever senses it has.

        Of joints: all of the posture's, rad or m, then their velocities, rad/s or m/s.
        """
        ...


class PointWorld:
    """Points inside a body, each moved by a bounded velocity; implements `World`."""

    observation_size = 3
    senses: Mapping[str, tuple[int, ...]] = MappingProxyType({"position": (3,)})
    landmarks: tuple[Landmark, ...] = ()
    posture_names: tuple[str, ...] = ()
    rewarded = False
    observation_names = state_names = ("position/x", "position/y", "position/z")
    action_size = 3
    action_names = ("x", "y", "z")
    posture_size = 3
    moves = ((0,), (1,), (2,))

    def __init__(
        self,
        id: str,
        body: Body,
        *,
        speed: float,
        columns: int,
        rng: np.random.Generator,
        crossing_axis: int | None = None,
    ) -> None:
        if columns < 1:
            raise ValueError(f"a world needs at least one column, got {columns}")
        self.id = id
        self.body = body
        self.speed = speed
        self.columns = columns
        self.crossing_axis = crossing_axis
        self.rng = rng
        self._position: Points = np.zeros((columns, 3))

    @property
    def diameter(self) -> float:
        """The body's diameter."""
        return self.body.diameter

    def span(self, components: Sequence[int]) -> float:
        """The body's span in these of x, y and z."""
        return self.body.span(components)

    def reset(self, start: Start = "centre") -> Floats:
        """Put all points at the origin, or anywhere in the body."""
        if start not in ("centre", "random"):
            raise ValueError(f"start must be 'centre' or 'random', got {start!r}")
        scattered = start == "random"
        self._position = (
            self.body.uniform(self.columns, self.rng) if scattered else np.zeros((self.columns, 3))
        )
        return self.posture()

    def step(self, action: Floats) -> Step:
        """Move each point by speed * action per axis; a wall lets it slide."""
        if action.shape != (self.columns, 3) or not np.isfinite(action).all():
            raise ValueError(
                f"actions must be finite numbers of shape ({self.columns}, 3), got shape {action.shape}"
            )
        velocity = self.speed * np.clip(action, -1, 1, dtype=np.float64)
        self._position = self.body.nearest(self._position + velocity)
        none = np.zeros(self.columns, dtype=np.bool_)
        return Step(self.posture(), none, none.copy(), np.zeros(self.columns, dtype=np.float32))

    def restart(self, columns: Flags) -> Floats:
        """Put the flagged points back at the origin."""
        self._position[columns] = 0.0
        return self.posture()

    def posture(self) -> Floats:
        """The positions (E, 3)."""
        return self._position.astype(np.float32)

    def side(self) -> None:
        """None: a point has no sides."""

    def state(self) -> Floats:
        """The positions (E, 3); a point has no velocity of its own."""
        return self.posture()

    def uniform_points(self, count: int, rng: np.random.Generator) -> Floats:
        """Positions drawn uniformly from the body."""
        return self.body.uniform(count, rng).astype(np.float32)
