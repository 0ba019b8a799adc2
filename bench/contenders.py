"""Who collects: our actor, the bare world, and Stable-Baselines3 in three ways, all on the calling thread."""

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from bench.sb3 import batched, one_by_one, ppo_of, together
from bench.scene import RUN, world_of
from bench.stand_in import LIFE, StandIn
from protocol import keys
from services.actor.service import Actor
from services.runtime.bus import Wakeup
from services.runtime.clock import RealClock
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import Context
from services.runtime.settings import RunSettings

ROLLOUT_STEPS = 128
ACTOR = "actor"


@dataclass(frozen=True)
class Took:
    """What some environment steps cost."""

    steps: int
    wall_secs: float
    cpu_secs: float


Contender = Callable[[int], Took]
"""Does at least so many environment steps, summed over the columns."""


class InProcess:
    """The actor service on the memory bus: all that the process does but Zenoh. Only its polls are timed."""

    def __init__(self, settings: RunSettings, level: int = 0) -> None:
        """`level` is the one whose blocks are at work."""
        hub, wakeup = MemoryBus(), Wakeup()
        context = Context(
            bus=hub.connect("actor-bench", wakeup),
            clock=RealClock(),
            settings=settings,
            run=RUN,
            run_dir=Path(tempfile.gettempdir()),
            life="actor-bench",
            wakeup=wakeup,
        )
        self._clock = context.clock
        self._stand_in = StandIn(hub.connect(LIFE), settings, wakeup, level)
        self.actor = Actor(context)
        context.bus.announce(keys.alive(RUN, "actor", context.life))

    def __call__(self, steps: int) -> Took:
        """See `Contender`."""
        wall_secs = cpu_secs = 0.0
        before = self._stand_in.steps
        while self._stand_in.steps - before < steps:
            wall, cpu = time.perf_counter(), time.process_time()
            self.actor.poll(self._clock.now_secs())
            wall_secs += time.perf_counter() - wall
            cpu_secs += time.process_time() - cpu
            self._stand_in.poll()
        return Took(self._stand_in.steps - before, wall_secs, cpu_secs)


def contenders_of(settings: RunSettings) -> dict[str, Contender]:
    """All of them, with `envs_per_actor` copies of the world."""
    columns = settings.actors.envs_per_actor
    return {
        ACTOR: InProcess(settings),
        "bare world loop, random actions": _bare(settings, columns),
        "SB3, encoder per copy": _rollouts(settings, one_by_one(settings, columns)),
        "SB3, one encoder call for all": _rollouts(settings, together(settings, columns)),
        "SB3 on our batched world": _rollouts(settings, batched(settings, columns)),
    }


def _bare(settings: RunSettings, columns: int) -> Contender:
    world, rng = world_of(settings, columns), np.random.default_rng(0)
    world.reset()

    def run() -> int:
        world.step(rng.uniform(-1, 1, (columns, world.action_size)).astype(np.float32))
        return columns

    return lambda steps: _timed(run, steps)


def _rollouts(settings: RunSettings, envs: object) -> Contender:
    ppo = ppo_of(settings, envs, ROLLOUT_STEPS)
    _, callback = ppo._setup_learn(1 << 30)

    def run() -> int:
        ppo.collect_rollouts(ppo.env, callback, ppo.rollout_buffer, ROLLOUT_STEPS)
        return ROLLOUT_STEPS * int(ppo.n_envs)

    return lambda steps: _timed(run, steps)


def _timed(run: Callable[[], int], steps: int) -> Took:
    wall, cpu, done = time.perf_counter(), time.process_time(), 0
    while done < steps:
        done += run()
    return Took(done, time.perf_counter() - wall, time.process_time() - cpu)
