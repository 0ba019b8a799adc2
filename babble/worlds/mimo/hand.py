"""`MimoHand`: MIMo's five fingers on a held palm (thesis 4.3), softly coupled to their neighbours."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import mujoco
import numpy as np

from babble.landmarks import Landmark
from babble.worlds.checks import check_choice, check_number
from babble.worlds.mimo.coupling import couple, couple_neighbours
from babble.worlds.mimo.cuts import cut
from babble.worlds.mimo.figures import load
from babble.worlds.mimo.finger import MOST_STIFFNESS, NEAR_LIMIT, flexion_joints
from babble.worlds.physics.env import BodyParameters, MujocoEnv, blueprint
from babble.worlds.physics.names import names_of
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.rendering import View

NEIGHBOURS = ("index", "middle", "ring", "little", "thumb")
"""Fingers in a row; the thumb's two joints go with the outer two of the little finger."""


@dataclass(frozen=True, kw_only=True)
class HandParameters(BodyParameters):
    """Parameters of `MimoHand`."""

    side: str = "right"
    coupling: float = 0.05
    """stiffness between a finger's joint and the same joint of its neighbour, as shares of flexion, N m"""
    finger_coupling: float = 0.05
    """stiffness between the joints within a finger, N m"""
    contacts: bool = False
    """whether fingers collide with one another and the palm"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("side", self.side, ("right", "left"))
        check_number("coupling", self.coupling, least=0, most=MOST_STIFFNESS)
        check_number("finger_coupling", self.finger_coupling, least=0, most=MOST_STIFFNESS)


class MimoHand(MujocoEnv):
    """A hand; action = torques of 14 flexion joints, observation = their angles by default."""

    Parameters = HandParameters
    view = View(lookat_m=(-0.01, -0.018, 0.03), azimuth_deg=150, elevation_deg=-20, distance_m=0.24)

    def build(self, parameters: HandParameters) -> Blueprint:
        """The hand cut out of the body."""
        fingers = [flexion_joints(parameters.side, finger) for finger in NEIGHBOURS]
        spec = cut(
            load("five_finger"),
            root=f"{parameters.side}_hand",
            joints=[joint for finger in fingers for joint in finger],
            contacts=parameters.contacts,
        )
        _couple(spec, fingers, parameters)
        model = spec.compile()
        everything = np.arange(model.njnt)
        names = names_of(model, "joint")
        groups = tuple(tuple(names.index(joint) for joint in finger) for finger in fingers)
        return blueprint(
            "MimoHand",
            model,
            parameters,
            joints=everything,
            actuators=np.arange(model.nu),
            task=lambda: Play(model, everything),
            landmarks=(
                Landmark("open", groups, -1, -NEAR_LIMIT),
                Landmark("closed", groups, NEAR_LIMIT, 1),
            ),
        )


def _couple(spec: mujoco.MjSpec, fingers: Sequence[Sequence[str]], parameters: HandParameters) -> None:
    for finger in fingers:
        couple_neighbours(spec, finger, parameters.finger_coupling)
    if parameters.coupling:
        for finger, neighbour in pairwise(fingers):
            shared = min(len(finger), len(neighbour))
            for one, other in zip(finger[-shared:], neighbour[-shared:], strict=True):
                couple(spec, one, other, parameters.coupling)
