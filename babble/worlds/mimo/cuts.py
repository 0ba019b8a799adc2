"""Parts of the body by themselves: an arm, a hand, a finger, held by the world.

A cut is made from figures, so it keeps those of what it keeps and never holds the rest.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Literal

import mujoco

from babble.patterns import matching, nearest
from babble.worlds.mimo.anatomy import BodyFigures, Figures
from babble.worlds.mimo.body import ROOT, infant, turn
from babble.worlds.mimo.tables import Vector

__all__ = ["FINGERS", "arm", "cut", "finger", "hand", "part"]

Side = Literal["left", "right"]
Finger = Literal["ff", "mf", "rf", "lf", "th"]
FINGERS: tuple[Finger, ...] = ("ff", "mf", "rf", "lf", "th")
"""first (index), middle, ring, little finger, thumb"""

BASES = {"lf": "lfmetacarpal", "th": "thbase"}
FORWARD_DEG = (0.0, 90.0, 0.0)


def cut(
    figures: Figures,
    *,
    root: str,
    joints: Sequence[str] | None = None,
    contacts: bool = True,
    turn_deg: Vector = (0.0, 0.0, 0.0),
) -> mujoco.MjSpec:
    """The body `root` and what hangs on it, its origin held at the world's.

    turn_deg: how it is held, as rotations about its own x, then y, then z; unturned, arms and hands point
        upward, with the palm to the right or the left as on the child.
    joints: patterns (`robot:right_ff_*`) of the joints that stay; the others are stiff at angle 0. None: all.
    contacts: without them nothing touches anything.
    What stays: the motors, locks and torque sensors of the joints that stay, tendons over such joints alone,
    and the pairs of bodies that never meet. Raises ValueError for a body or a pattern that names nothing.
    """
    spec = infant(part(figures, root=root, joints=joints, contacts=contacts), free=False)
    turn(spec.body(ROOT), turn_deg)
    return spec


def arm(figures: Figures, *, side: Side = "right", contacts: bool = True) -> mujoco.MjSpec:
    """One arm and hand with all their joints, held at the shoulder, stretched out forward."""
    return cut(figures, root=f"{side}_upper_arm", contacts=contacts, turn_deg=FORWARD_DEG)


def hand(figures: Figures, *, side: Side = "right", contacts: bool = True) -> mujoco.MjSpec:
    """One hand whose palm is held, fingers up: all joints but the wrist's."""
    wrist = {joint.name for joint in _named(figures, f"{side}_hand").joints}
    rest = [joint for joint in _joints(_subtree(figures, f"{side}_hand")) if joint not in wrist]
    return cut(figures, root=f"{side}_hand", joints=rest, contacts=contacts)


def finger(
    figures: Figures,
    *,
    finger: Finger = "ff",
    side: Side = "right",
    contacts: bool = True,
    on_hand: bool = False,
) -> mujoco.MjSpec:
    """One finger with all its joints, pointing up.

    on_hand: with the rest of the hand, held still, to look at or to close upon.
    """
    base = f"{side}_{BASES.get(finger, f'{finger}knuckle')}"
    return cut(
        figures,
        root=f"{side}_hand" if on_hand else base,
        joints=_joints(_subtree(figures, base)),
        contacts=contacts,
    )


def part(figures: Figures, *, root: str, joints: Sequence[str] | None, contacts: bool) -> Figures:
    """The figures of a cut; see `cut`."""
    kept = _subtree(figures, root)
    stay = _matching(_joints(kept), joints, root)
    bodies = tuple(_trimmed(body, stay, contacts) for body in kept)
    bodies = (replace(bodies[0], parent=ROOT, pos=(0.0, 0.0, 0.0), turn_deg=(0.0, 0.0, 0.0)), *bodies[1:])
    names = {body.name for body in bodies}
    sensors = {body.torque for body in bodies if body.joints}
    geoms = {geom.name for body in bodies for geom in body.geoms}
    return replace(
        figures,
        bodies=bodies,
        motors=tuple(motor for motor in figures.motors if motor.joint in stay),
        tendons=tuple(tendon for tendon in figures.tendons if tendon.weights.keys() <= stay),
        locks=tuple(joint for joint in figures.locks if joint in stay),
        torques=tuple(torque for torque in figures.torques if torque in sensors),
        frictionless=tuple(pair for pair in figures.frictionless if contacts and geoms.issuperset(pair)),
        excludes=tuple(pair for pair in figures.excludes if names.issuperset(pair)) + _held_parents(bodies),
    )


def _named(figures: Figures, name: str) -> BodyFigures:
    bodies = {body.name: body for body in figures.bodies}
    if name not in bodies:
        raise ValueError(f"the infant has no body {name!r} to cut out; {nearest(bodies, name, 'body')}")
    return bodies[name]


def _subtree(figures: Figures, root: str) -> list[BodyFigures]:
    """The root and all that hangs on it; figures list parents before children."""
    kept = [_named(figures, root)]
    for body in figures.bodies:
        if any(body.parent == above.name for above in kept):
            kept.append(body)
    return kept


def _joints(bodies: Iterable[BodyFigures]) -> list[str]:
    return [joint.name for body in bodies for joint in body.joints]


def _matching(joints: list[str], patterns: Sequence[str] | None, root: str) -> set[str]:
    if patterns is None:
        return set(joints)
    return {joints[index] for index in matching(joints, patterns, f"joint of {root}")}


def _trimmed(body: BodyFigures, joints: set[str], contacts: bool) -> BodyFigures:
    geoms = body.geoms if contacts else tuple(replace(geom, contacts=(0, 0)) for geom in body.geoms)
    return replace(body, joints=tuple(j for j in body.joints if j.name in joints), geoms=geoms)


def _held_parents(bodies: Sequence[BodyFigures]) -> tuple[tuple[str, str], ...]:
    """Bodies and the parents that they turn on, where the parent stands still.

    MuJoCo never lets a body meet its parent, except a parent fixed to the world: left to it, a finger would
    jam against its own palm.
    """
    still = {ROOT}
    pairs = []
    for body in bodies:
        if body.parent in still:
            if not body.joints:
                still.add(body.name)
            elif body.parent != ROOT:
                pairs.append((body.parent, body.name))
    return tuple(pairs)
