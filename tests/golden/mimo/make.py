"""The golden values of MIMo's body, and the program that takes them from the published models.

Run `python -m tests.golden.mimo.make` where `../shared/mimo/reference` exists. It writes one file for each of
the two bodies: every figure of the compiled model, and what 1,000 random commands do to it.

The trajectory is kept as states 100 steps apart. A test that starts from each and compares with the next
covers all 1,000 steps, and the last digits in which machines differ never have time to grow.
"""

from pathlib import Path

import mujoco
import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).parent
REFERENCE = Path(__file__).parents[3].parent / "shared" / "mimo" / "reference"
SCENES = {
    "mitten": "roll_over_c.xml",
    "five_finger": "benchmarkv2_scene.xml",
    "mitten without chest": "benchmark_scene.xml",
}
"""The published scene of each body."""
GOLDEN = ("mitten", "five_finger")
"""The bodies whose values are committed."""

STEPS = 1000
WINDOW = 100
DROP_M = 0.4
"""How high the body's root starts; the scenes put it there or on the floor."""

NAMED = ("body", "joint", "geom", "site", "camera", "actuator", "sensor", "tendon", "equality")
FIGURES = {
    "body": "parentid pos quat mass inertia ipos iquat",
    "jnt": "type bodyid pos axis limited range stiffness solimp solref",
    "qpos": "spring",
    "dof": "damping armature frictionloss",
    "geom": "type bodyid size pos quat contype conaffinity condim friction solimp solref margin",
    "site": "bodyid pos",
    "cam": "bodyid pos quat fovy",
    "actuator": "trntype trnid gear ctrlrange forcerange user gainprm biasprm",
    "sensor": "type objid adr",
    "tendon": "range limited",
    "wrap": "objid prm",
    "eq": "type obj1id obj2id active0 data solimp solref",
    "exclude": "signature",
    "pair": "geom1 geom2 dim friction solimp solref",
}
OPTIONS = (
    "timestep",
    "gravity",
    "iterations",
    "tolerance",
    "impratio",
    "solver",
    "cone",
    "integrator",
    "jacobian",
)

Arrays = dict[str, NDArray[np.generic]]


def published(body: str) -> mujoco.MjModel:
    """The published model, compiled without its textures, which take a gigabyte."""
    spec = mujoco.MjSpec.from_file(str(REFERENCE / SCENES[body]))
    for material in spec.materials:
        material.textures = [""] * len(material.textures)
    for texture in list(spec.textures):
        spec.delete(texture)
    return spec.compile()


def figures(model: mujoco.MjModel) -> Arrays:
    """Names, figures and solver settings of a compiled model.

    Names come as one text per kind of thing. One of the scenes calls the free joint `mimo_orientation`.
    """
    found: Arrays = {}
    for kind in NAMED:
        count = {"joint": model.njnt, "camera": model.ncam, "actuator": model.nu, "equality": model.neq}.get(
            kind
        )
        count = getattr(model, f"n{kind}") if count is None else count
        names = (getattr(model, kind)(number).name for number in range(count))
        text = "\n".join("mimo_location" if name == "mimo_orientation" else name for name in names)
        found[f"names of {kind}"] = np.array(text)
    for kind, fields in FIGURES.items():
        found.update({f"{kind}_{field}": getattr(model, f"{kind}_{field}") for field in fields.split()})
    found.update({f"option {name}": np.asarray(getattr(model.opt, name)) for name in OPTIONS})
    return found


def commands(motors: int) -> NDArray[np.float64]:
    """(STEPS, motors) random commands, the same everywhere."""
    return np.random.default_rng(46).uniform(-1, 1, (STEPS, motors))


def start(model: mujoco.MjModel) -> mujoco.MjData:
    """The model as it is when the commands begin."""
    data = mujoco.MjData(model)
    free = model.jnt_qposadr[model.body_jntadr[model.body("mimo_location").id]]
    data.qpos[free + 2] = DROP_M
    return data


def trajectory(model: mujoco.MjModel) -> Arrays:
    """The states at every WINDOW-th step, first and last included, and the sensors' values with them."""
    data = start(model)
    kept = [_kept(data)]
    for step, command in enumerate(commands(model.nu), start=1):
        data.ctrl = command
        mujoco.mj_step(model, data)
        if step % WINDOW == 0:
            kept.append(_kept(data))
    return {f"run {name}": np.array([state[name] for state in kept]) for name in kept[0]}


def _kept(data: mujoco.MjData) -> dict[str, NDArray[np.float64]]:
    names = ("qpos", "qvel", "qacc_warmstart", "sensordata")
    return {name: getattr(data, name).copy() for name in names}


def resume(model: mujoco.MjModel, golden: Arrays, window: int) -> mujoco.MjData:
    """Start from a golden state and follow the commands to the next."""
    data = mujoco.MjData(model)
    data.qpos, data.qvel = golden["run qpos"][window], golden["run qvel"][window]
    data.qacc_warmstart = golden["run qacc_warmstart"][window]
    for command in commands(model.nu)[window * WINDOW : (window + 1) * WINDOW]:
        data.ctrl = command
        mujoco.mj_step(model, data)
    return data


def load(body: str) -> Arrays:
    """The committed golden values."""
    with np.load(FOLDER / f"{body}.npz") as file:
        return dict(file)


if __name__ == "__main__":
    for body in GOLDEN:
        model = published(body)
        np.savez_compressed(FOLDER / f"{body}.npz", **figures(model), **trajectory(model))
