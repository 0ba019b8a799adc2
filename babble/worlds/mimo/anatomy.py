"""What a body is made of, as data: joints, flesh, motors and what holds them together.

Angles are degrees, lengths metres, masses kilograms, torques N m, as in the tables of figures.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from babble.worlds.mimo.tables import Vector

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class JointFigures:
    """A hinge."""

    name: str
    axis: Vector
    pos: Vector
    range_deg: tuple[float, float]
    springref_deg: float
    stiffness: float
    damping: float
    frictionloss: float
    armature: float
    limit_softness: Numbers
    lock: bool
    """whether an inactive equality exists that can hold the joint"""


@dataclass(frozen=True)
class GeomFigures:
    """A piece of flesh."""

    name: str
    """'' for none: most pieces are nameless in MIMo"""
    shape: str
    size: Vector
    pos: Vector
    turn_deg: Vector
    mass: float
    look: str
    contacts: tuple[int, int]
    condim: int
    friction: Numbers
    softness: Numbers
    stiffness: Numbers


@dataclass(frozen=True)
class CameraFigures:
    """An eye's view."""

    name: str
    pos: Vector
    turn_deg: Vector
    fovy_deg: float


@dataclass(frozen=True)
class BodyFigures:
    """A segment of the body and the joints by which it hangs on its parent."""

    name: str
    parent: str
    pos: Vector
    turn_deg: Vector
    joints: tuple[JointFigures, ...]
    geoms: tuple[GeomFigures, ...]
    sites: Mapping[str, Vector]
    torque: tuple[str, str] | None
    """sensor and site of the torque by which it is held"""
    camera: CameraFigures | None


@dataclass(frozen=True)
class MotorFigures:
    """A motor: torque = `torque` x command, the command cut off at `strength`."""

    name: str
    joint: str
    torque: float
    strength: tuple[float, float]
    muscle: Numbers
    """VMAX, FMAX of the backward, FMAX of the forward muscle"""


@dataclass(frozen=True)
class TendonFigures:
    """Keeps a weighted sum of joint angles (radians) within a range."""

    name: str
    weights: Mapping[str, float]
    range: tuple[float, float]


@dataclass(frozen=True)
class LookFigures:
    """The surface of a piece of flesh."""

    rgba: Numbers
    specular: float
    shininess: float


@dataclass(frozen=True)
class Figures:
    """Everything that `babble.worlds.mimo.body.infant` needs; parts of the body in the order of the model."""

    bodies: tuple[BodyFigures, ...]
    motors: tuple[MotorFigures, ...]
    tendons: tuple[TendonFigures, ...]
    locks: tuple[str, ...]
    """the joints that an inactive equality can hold, in the order of the equalities"""
    torques: tuple[tuple[str, str], ...]
    """(sensor, site) of the torque sensors, in their order"""
    frictionless: tuple[tuple[str, str], ...]
    """pairs of geoms that slide on each other"""
    excludes: tuple[tuple[str, str], ...]
    """pairs of bodies that never meet"""
    looks: Mapping[str, LookFigures]
    lock_softness: Numbers
    timestep_secs: float
    iterations: int
    tolerance: float

    def body(self, name: str) -> BodyFigures:
        """The body of that name. Raises KeyError."""
        return next(body for body in self.bodies if body.name == name)
