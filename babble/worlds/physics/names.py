"""What the joints, actuators, sensors, bodies and cameras of a model are called."""

from collections.abc import Iterable

import mujoco

KINDS = {
    "joint": mujoco.mjtObj.mjOBJ_JOINT,
    "actuator": mujoco.mjtObj.mjOBJ_ACTUATOR,
    "sensor": mujoco.mjtObj.mjOBJ_SENSOR,
    "body": mujoco.mjtObj.mjOBJ_BODY,
    "camera": mujoco.mjtObj.mjOBJ_CAMERA,
}
_COUNTS = {"joint": "njnt", "actuator": "nu", "sensor": "nsensor", "body": "nbody", "camera": "ncam"}


def names_of(model: mujoco.MjModel, kind: str) -> list[str]:
    """The names of all objects of a kind of `KINDS`, "" for one without a name."""
    count = getattr(model, _COUNTS[kind])
    return [mujoco.mj_id2name(model, KINDS[kind], index) or "" for index in range(count)]


def labels(model: mujoco.MjModel, kind: str, indices: Iterable[int]) -> tuple[str, ...]:
    """The names of these objects of a kind of `KINDS`; the number, as text, of one without a name."""
    names = names_of(model, kind)
    return tuple(names[index] or str(index) for index in indices)
