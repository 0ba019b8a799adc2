"""`MimoFinger`: one finger of MIMo's five-finger hand (thesis 4.2), everything else held still.

MIMo's finger joints move independently; the thesis calls a finger's joints coupled. Here a tendon
spring between neighbouring joints couples them softly; `coupling = 0` leaves MIMo as it is.
"""

from dataclasses import dataclass

import numpy as np

from babble.landmarks import Landmark
from babble.worlds.checks import check_choice, check_number
from babble.worlds.mimo.coupling import couple_neighbours
from babble.worlds.mimo.cuts import cut
from babble.worlds.mimo.figures import load
from babble.worlds.physics.env import BodyParameters, MujocoEnv, blueprint
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import Blueprint
from babble.worlds.senses.rendering import View

FINGERS = {
    "index": ("ff", ("knuckle", "middle", "distal")),
    "middle": ("mf", ("knuckle", "middle", "distal")),
    "ring": ("rf", ("knuckle", "middle", "distal")),
    "little": ("lf", ("knuckle", "middle", "distal")),
    "thumb": ("th", ("middle", "distal")),
}
"""By name: MIMo's letters, and the joints of flexion from the palm outwards."""
NEAR_LIMIT = 0.8
"""A joint is at a limit within 10 % of its range, which goes from -1 to 1."""


MOST_STIFFNESS = 100.0
"""N m; far more than any finger's motor can pull"""


@dataclass(frozen=True, kw_only=True)
class FingerParameters(BodyParameters):
    """Parameters of `MimoFinger`."""

    finger: str = "index"
    """index, middle, ring, little or thumb"""
    side: str = "right"
    coupling: float = 0.05
    """stiffness of the spring between neighbouring joints' shares of flexion, N m; 0 for none"""
    contacts: bool = False
    """whether the finger collides with the palm"""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_choice("finger", self.finger, FINGERS)
        check_choice("side", self.side, ("right", "left"))
        check_number("coupling", self.coupling, least=0, most=MOST_STIFFNESS)


class MimoFinger(MujocoEnv):
    """One finger; action = torques of its flexion joints, observation = their angles by default."""

    Parameters = FingerParameters
    view = View(lookat_m=(-0.008, -0.014, 0.032), azimuth_deg=150, elevation_deg=-20, distance_m=0.24)

    def build(self, parameters: FingerParameters) -> Blueprint:
        """The finger cut out of the body."""
        joints = flexion_joints(parameters.side, parameters.finger)
        spec = cut(
            load("five_finger"),
            root=f"{parameters.side}_hand",
            joints=joints,
            contacts=parameters.contacts,
        )
        couple_neighbours(spec, joints, parameters.coupling)
        model = spec.compile()
        everything = np.arange(model.njnt)
        return blueprint(
            "MimoFinger",
            model,
            parameters,
            joints=everything,
            actuators=np.arange(model.nu),
            task=lambda: Play(model, everything),
            landmarks=(
                Landmark("extended", tuple((joint,) for joint in everything.tolist()), -1, -NEAR_LIMIT),
                Landmark("flexed", tuple((joint,) for joint in everything.tolist()), NEAR_LIMIT, 1),
            ),
        )


def flexion_joints(side: str, finger: str) -> list[str]:
    """The names of a finger's flexion joints, from the palm outwards."""
    letters, parts = FINGERS[finger]
    return [f"robot:{side}_{letters}_{part}" for part in parts]
