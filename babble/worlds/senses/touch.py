"""Touch: points of the skin feel the forces of contacts near them, by MIMo's published rule.

For each contact and each of its bodies that has skin: p is the contact's place moved by half the gap
along the normal, to that body's surface; a point at distance r from p has the weight max(0, 1 - r / R),
R = 2 * the distance between points; the body's contact force is shared among its points by weight.
After Mattern et al., "MIMo: A Multi-Modal Infant Model", IEEE TCDS 2024 (package mimoTouch).

Three things are other than in that package: the second body of a self-contact is treated as the first,
with the opposite force and the normal towards it; MjData is not written to; and no force is lost, for
where no point lies within R, the nearest one feels all of it.
"""

from collections.abc import Mapping, Sequence
from itertools import chain
from typing import Literal

import mujoco
import numpy as np

from babble.worlds.senses.contacts import Array, Contacts, Indices, contacts_of, joined
from babble.worlds.senses.nearby import Nearby
from babble.worlds.senses.sense import Copies, Floats
from babble.worlds.senses.skin import MIMO_DISTANCES_M, SkinError, skin

Components = Literal["vector", "norm"]
REACH_POINTS = 2.0
"""R in distances between points."""
SIGNS = np.array([-1.0, 1.0]).reshape(2, 1, 1)
"""The normal points away from the first geom of a contact and into the second."""
NOWHERE: Indices = np.zeros(0, np.int64)


class Touch:
    """The forces on the points of the skin in newton; implements `Sense`.

    Points are in the order of `patches`. With components "vector" each point gives three values, the
    force on it in the frame of the body that it belongs to; with "norm" one, the length of that vector.
    """

    name = "touch"

    def __init__(
        self,
        model: mujoco.MjModel,
        bodies: Sequence[str] = ("*",),
        resolution: float = 1.0,
        components: Components = "vector",
        distances_m: Mapping[str, float] = MIMO_DISTANCES_M,
    ) -> None:
        """Feel with the bodies that match the patterns; see `skin` for these, distances and errors."""
        if components not in ("vector", "norm"):
            raise SkinError(f'touch: components are "vector" or "norm", got {components!r}')
        self.patches = skin(model, bodies, resolution, distances_m)
        self._model = model
        self._vector = components == "vector"
        reach_m = REACH_POINTS * np.array([patch.distance_m for patch in self.patches])
        self._nearby = Nearby(self.patches, reach_m)
        self._body = np.array([patch.body for patch in self.patches])
        self._bodies = model.nbody
        self._number = sum(len(patch.points) for patch in self.patches)
        each = 3 if self._vector else 1
        self.shape = (self._number * each,)
        felt_by = ((patch.name or str(patch.body),) * (each * len(patch.points)) for patch in self.patches)
        self.components = tuple(chain.from_iterable(felt_by))
        of_body = np.full(model.nbody, -1)
        of_body[self._body] = np.arange(len(self.patches))
        # The last entry answers for what is no geom (-1).
        self._patch_of_geom = np.append(of_body[model.geom_bodyid], -1)

    def read(self, copies: Copies) -> Floats:
        """(E, values) what each copy feels, after a step or mj_forward; zeros where nothing touches.

        A copy whose simulation broke down feels numbers that mean nothing, the others feel as always.
        """
        felt = np.zeros((len(copies) * self._number, 3), np.float32)
        with np.errstate(all="ignore"):
            at = self._add(felt, copies)
        if self._vector:
            return felt.reshape(len(copies), *self.shape)
        norm = np.zeros(len(felt), np.float32)
        norm[at] = np.linalg.norm(felt.take(at, axis=0), axis=1)
        return norm.reshape(len(copies), *self.shape)

    def _add(self, felt: Floats, copies: Copies) -> Indices:
        """Add the contacts' forces to the points (E * points, 3); the points that may have felt some."""
        contacts = contacts_of(self._model, copies)
        if contacts is None:
            return NOWHERE
        patch = self._patch_of_geom.take(contacts.geoms)
        which, side = ((patch >= 0) & (contacts.force[:, :1] > 0)).nonzero()
        if not len(which):
            return NOWHERE
        patch, copy = patch[which, side], contacts.copy.take(which)
        place, force = self._on_bodies(contacts, copies, which, side, copy * self._bodies + self._body[patch])
        rows, points, share = self._nearby.shares(patch, place)
        at = copy.take(rows) * self._number + points
        shared = (share[:, None] * force.take(rows, axis=0)).astype(np.float32)
        for component, values in zip(felt.T, shared.T, strict=True):
            np.add.at(component, at, values)
        return at

    def _on_bodies(
        self, contacts: Contacts, copies: Copies, which: Indices, side: Indices, body: Indices
    ) -> tuple[Array, Array]:
        """p and force (P, 3) of the chosen contacts and sides, in the frames of the bodies (P,)."""
        axes = contacts.axes.take(which, axis=0) * SIGNS.take(side, axis=0)
        both = np.empty((len(which), 2, 3))
        origin = joined([data.xpos for data in copies]).take(body, axis=0)
        half_gap = 0.5 * contacts.gap_m.take(which)[:, None]
        both[:, 0] = contacts.place.take(which, axis=0) - origin + half_gap * axes[:, 0]
        both[:, 1:] = contacts.force.take(which, axis=0)[:, None] @ axes
        local = both @ joined([data.xmat for data in copies]).take(body, axis=0).reshape(-1, 3, 3)
        return local[:, 0], local[:, 1]
