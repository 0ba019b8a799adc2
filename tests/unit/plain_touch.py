"""MIMo's published rule of touch, step by step in plain loops: what `Touch` is compared with."""

from collections.abc import Sequence

import mujoco
import numpy as np

from babble.worlds.senses.skin import Patch


def plain_touch(model: mujoco.MjModel, data: mujoco.MjData, patches: Sequence[Patch]) -> list[np.ndarray]:
    """For each patch the forces (n, 3) on its points, in the frame of its body."""
    felt = {patch.body: np.zeros((len(patch.points), 3)) for patch in patches}
    for index in range(data.ncon):
        contact = data.contact[index]
        for geom, side in ((contact.geom1, -1.0), (contact.geom2, +1.0)):
            for patch in patches:
                if model.geom_bodyid[geom] == patch.body:
                    felt[patch.body] += _shared(data, patch, contact, side, contact_force(model, data, index))
    return [felt[patch.body] for patch in patches]


def contact_force(model: mujoco.MjModel, data: mujoco.MjData, index: int) -> np.ndarray:
    """The force of a contact on its geom2, in the world."""
    wrench = np.zeros(6)
    mujoco.mj_contactForce(model, data, index, wrench)
    normal, first, second = data.contact[index].frame.reshape(3, 3)
    return wrench[0] * normal + wrench[1] * first + wrench[2] * second


def body_forces(model: mujoco.MjModel, data: mujoco.MjData, body: int) -> np.ndarray:
    """The sum of all contact forces on a body, in the world."""
    total = np.zeros(3)
    for index in range(data.ncon):
        contact = data.contact[index]
        if model.geom_bodyid[contact.geom1] == body:
            total -= contact_force(model, data, index)
        if model.geom_bodyid[contact.geom2] == body:
            total += contact_force(model, data, index)
    return total


def _shared(
    data: mujoco.MjData, patch: Patch, contact: mujoco._structs.MjContact, side: float, force: np.ndarray
) -> np.ndarray:
    to_body = data.xmat[patch.body].reshape(3, 3).T
    # The normal points from geom1 into geom2, and the place is midway between their surfaces.
    surface = contact.pos + side * contact.frame[:3] * contact.dist / 2
    place = to_body @ (surface - data.xpos[patch.body])
    weights = np.zeros(len(patch.points))
    for number, point in enumerate(patch.points):
        weights[number] = max(0.0, 1.0 - np.linalg.norm(point - place) / (2 * patch.distance_m))
    return np.outer(weights / weights.sum(), to_body @ (side * force))
