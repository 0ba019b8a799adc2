"""MIMo's own package, stepped on demand: `<its python> bench/mimo_package.py posed|collapsed|off`.

Runs in the package's own interpreter with its pinned versions and imports nothing of this repository.
For each number of environment steps on a line of its input it answers with a line of JSON, the CPU
seconds they took; its first line says how many sensor points there are.

collapsed: the package as it is. It lays out its sensor points before any geom has a pose, so that all
    points of a body fall on one spot. posed: repaired by one mj_forward before. off: without touch.
"""

import json
import sys
import time

import mujoco
from mimoEnv.envs.dummy import MIMoDummyEnv

WARM_UP_STEPS = 200
"""It falls from 0.4 m; by now it lies on the floor."""


class Posed(MIMoDummyEnv):
    """With geoms that have a pose before sensor points are laid out on them."""

    def touch_setup(self, touch_params):
        """See the base class."""
        mujoco.mj_forward(self.model, self.data)
        super().touch_setup(touch_params)


def main(how: str) -> None:
    """Answer until the input ends."""
    kind = Posed if how == "posed" else MIMoDummyEnv
    env = kind(vision_params=None, **({"touch_params": None} if how == "off" else {}))
    env.reset(seed=0)
    points = env.touch.get_touch_obs().shape[0] if env.touch else 0
    took_secs(env, WARM_UP_STEPS)
    print(json.dumps({"points": points, "mujoco": mujoco.__version__}), flush=True)
    for line in sys.stdin:
        print(json.dumps({"cpu_secs": took_secs(env, int(line))}), flush=True)


def took_secs(env: MIMoDummyEnv, steps: int) -> float:
    """CPU seconds of so many steps with random actions, which are drawn before."""
    actions = [env.action_space.sample() for _ in range(steps)]
    began = time.process_time()
    for action in actions:
        env.step(action)
    return time.process_time() - began


if __name__ == "__main__":
    main(sys.argv[1])
