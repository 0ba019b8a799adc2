"""When a simulation has broken down, and how to let one run that might."""

import mujoco

UNSTABLE = 1e10
"""MuJoCo's own bound (mjMAXVAL) of a position or velocity that means anything."""
BEGINNINGS = 20
"""An episode is begun so often before the world gives up: each draws another beginning."""


def is_broken(data: mujoco.MjData) -> bool:
    """True if velocities are not finite or out of bounds."""
    return not data.qvel.dot(data.qvel) < UNSTABLE**2


def run(model: mujoco.MjModel, data: mujoco.MjData, steps: int) -> None:
    """So many physics steps under the forces that there are; fewer if the simulation breaks down.

    A broken body touches itself everywhere: a step of it takes some thousand times as long as one of a whole.
    """
    for _ in range(steps):
        mujoco.mj_step(model, data)
        if is_broken(data):
            return
