"""`python -m bench.sb3_run --copies 16 --how fork`: one training run of Stable-Baselines3, as a process.

Prints one line of JSON: seconds and CPU seconds of `learn`, and CPU seconds of the process and its
workers since they began. CPU time is read while the workers live, for not all of them are our children.
"""

import argparse
import json
import time
from collections.abc import Sequence

import psutil
import torch
from stable_baselines3.common.vec_env import DummyVecEnv, SubprocVecEnv, VecEnv

from bench.sb3 import copies, ppo_of
from bench.sb3_worlds import Latents
from bench.scene import cuboid, encoder_of
from services.runtime.settings import RunSettings

HOW = ("one-process", "fork", "forkserver", "spawn")


def main(argv: Sequence[str] | None = None) -> None:
    """Train for the scenario's number of rollouts and say what it cost."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--copies", type=int, required=True)
    parser.add_argument("--how", choices=HOW, required=True)
    parser.add_argument("--rollouts", type=int, required=True)
    given = parser.parse_args(argv)
    torch.set_num_threads(1)
    settings = cuboid()
    rollout = settings.actors.segment_steps * settings.policy.rollout_columns
    envs = Latents(
        _copies(settings, given.copies, given.how), encoder_of(settings), settings.goals.period_steps
    )
    ppo = ppo_of(settings, envs, rollout // given.copies)
    began_secs, began_cpu_secs = time.monotonic(), _cpu_secs()
    ppo.learn(given.rollouts * rollout)
    found = {
        "learn_secs": time.monotonic() - began_secs,
        "learn_cpu_secs": _cpu_secs() - began_cpu_secs,
        "cpu_secs": _cpu_secs(),
        "steps": ppo.num_timesteps,
        "epochs": ppo._n_updates,
    }
    envs.close()
    print(json.dumps(found), flush=True)


def _copies(settings: RunSettings, number: int, how: str) -> VecEnv:
    makers = copies(settings, number)
    return DummyVecEnv(makers) if how == "one-process" else SubprocVecEnv(makers, start_method=how)


def _cpu_secs() -> float:
    me = psutil.Process()
    times = [process.cpu_times() for process in (me, *me.children(recursive=True))]
    return sum(taken.user + taken.system for taken in times)


if __name__ == "__main__":
    main()
