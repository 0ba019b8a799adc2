"""What the processes of a run would say to a dashboard: made up, seeded, and of any shape that is wished."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from protocol import keys
from protocol.messages import ALL_BLOCKS, Phase, PhaseAnnounced, Progress, Score, Status, View
from services.runtime.settings import BlockSettings, RunSettings, WorldSettings

Floats = NDArray[np.float32]

RUN = "made-up"
TRAIL_STEPS = 60
STEPS_PER_VIEW = 20
GOAL_STEPS = 100
SPEED = 400
"""environment steps per second of each actor"""


def settings_of(
    *latent_dims: int, world: str = "Cuboid", recording_mb: int = 512, **parameters: object
) -> RunSettings:
    """Settings of a run with a block for each dimension: block, or block-0, block-1..."""
    names = ["block"] if len(latent_dims) == 1 else [f"block-{i}" for i in range(len(latent_dims))]
    blocks = [BlockSettings(name=n, latent_dim=d) for n, d in zip(names, latent_dims, strict=True)]
    table = RunSettings(
        scenario="made-up", block=blocks, world=WorldSettings(id=world, parameters=parameters)
    )
    return table.model_copy(update={"view": table.view.model_copy(update={"recording_mb": recording_mb})})


def announced(phase: Phase, term: int, iteration: int = 0, iterations: int = 4) -> PhaseAnnounced:
    """The coordinator's word."""
    return PhaseAnnounced(
        run=RUN,
        term=term,
        block=ALL_BLOCKS,
        life="coordinator-1",
        seq=term,
        phase=phase,
        iteration=iteration,
        iterations=iterations,
        blocks={},
    )


class MadeUpActor:
    """Latents that wander to goals, with softmax as encoders have it."""

    def __init__(self, index: int, block: BlockSettings, columns: int, seed: int) -> None:
        self.life = f"actor-{index:08x}"
        self._block = block
        self._rng = np.random.default_rng([seed, index, block.latent_dim])
        self._logits = self._rng.normal(size=(columns, block.latent_dim))
        self._goal = self._rng.integers(block.latent_dim, size=columns)
        self._trail = [self._latent()[0]]
        self._step = int(self._rng.integers(GOAL_STEPS))
        self._seq = 0

    def view(self, *, goals: bool = True) -> View:
        """Where it is some steps later."""
        for _ in range(STEPS_PER_VIEW):
            self._walk()
        latent = self._latent()
        trail = np.array(self._trail, np.float32)
        arrays: dict[str, Floats] = {"latent": latent, "trail": trail, "posture": _posture(latent)}
        arrays["path"] = _posture(trail)
        if goals:
            arrays["goal"] = np.eye(self._block.latent_dim, dtype=np.float32)[self._goal]
        self._seq += 1
        return view_of(self.life, self._block.name, arrays, seq=self._seq, env_step=self._step)

    def _walk(self) -> None:
        self._step += 1
        if self._step % GOAL_STEPS == 0:
            self._goal = self._rng.integers(self._block.latent_dim, size=len(self._goal))
        wished = 5.0 * np.eye(self._block.latent_dim)[self._goal]
        noise = self._rng.normal(scale=0.28, size=self._logits.shape)
        self._logits += 0.05 * (wished - self._logits) + noise
        self._trail = [*self._trail[-TRAIL_STEPS + 1 :], self._latent()[0]]

    def _latent(self) -> Floats:
        grown = np.exp(self._logits - self._logits.max(axis=1, keepdims=True))
        return np.asarray(grown / grown.sum(axis=1, keepdims=True), np.float32)


def _posture(latent: Floats) -> Floats:
    """A place in the cuboid (1.5 x 1 x 0.5) for each latent (n, d)."""
    place = np.stack([latent[:, 0] - latent[:, -1], latent[:, 1] - 0.5, 0.2 * latent[:, 0]], axis=1)
    return np.asarray(place * 0.7, np.float32)


def view_of(life: str, block: str, arrays: dict[str, Floats], *, seq: int = 0, env_step: int = 0) -> View:
    """A latent view."""
    return View(
        run=RUN, term=3, block=block, life=life, seq=seq, view="latent", env_step=env_step, arrays=arrays
    )


class Feed:
    """All processes of a run: some actors, two learners and a coordinator."""

    def __init__(self, settings: RunSettings, *, actors: int = 3, columns: int = 8, seed: int = 0) -> None:
        self._settings = settings
        self._rng = np.random.default_rng(seed)
        self.actors = [
            [MadeUpActor(index, block, columns, seed) for block in settings.block] for index in range(actors)
        ]
        self._steps = [0.0] * actors
        self._updates = 0
        self._seq = 0

    @property
    def lives(self) -> list[tuple[str, str]]:
        """(service, life) of everybody."""
        others = [(s, f"{s}-1") for s in ("coordinator", "encoder_learner", "policy_learner")]
        return [*others, *(("actor", actor[0].life) for actor in self.actors)]

    def views(self) -> Iterator[View]:
        """What all actors show."""
        for actor in self.actors:
            for of_block in actor:
                yield of_block.view()

    def statuses(self, phase: Phase, term: int, secs: float = 1.0) -> Iterator[Status]:
        """What all say after some more time of a phase."""
        self._seq += 1
        self._updates += 1
        for index, actor in enumerate(self.actors):
            self._steps[index] += secs * SPEED * float(self._rng.uniform(0.9, 1.1))
            totals = {"env_steps": int(self._steps[index]), "segments": self._seq}
            yield self._status("actor", actor[0].life, phase, term, totals=totals, queue_depth=index % 3)
        metrics, totals = self._learned(), {"updates": self._updates}
        block = self._settings.block[0].name
        work = Progress(block=block, done=self._updates * 400, wanted=100_000, unit="steps")
        for service in ("encoder_learner", "policy_learner"):
            yield self._status(
                service, f"{service}-1", phase, term, totals=totals, progress=[work],
                metrics={name: value for name, value in metrics.items() if name.split("/")[1] in service},
                versions={f"encoder/{block}": 2, f"policy/{block}": self._updates},
            )  # fmt: skip
        yield self._status(
            "coordinator", "coordinator-1", phase, term, waiting_for="waiting for policy_learner"
        )

    def scores(self, iteration: int, phase: Phase, term: int) -> Status:
        """What an evaluation found."""
        rows = [
            Score(
                run=RUN, block=block.name, iteration=iteration, phase=phase, separation=0.5 + 0.1 * iteration,
                separation_worst=0.4 + 0.1 * iteration, z_min=0.6 + 0.08 * iteration, z_goal=0.7,
                switch_success=0.8, policy="mean", steps=8000,
            )
            for block in self._settings.block
        ]  # fmt: skip
        return self._status("policy_learner", "policy_learner-1", Phase.EVALUATE, term, scores=rows)

    def _learned(self) -> dict[str, float]:
        age, noise = self._updates / 30, self._rng.normal(scale=0.03, size=12)
        found: dict[str, float] = {}
        for block in self._settings.block:
            encoder, policy = f"{block.name}/encoder", f"{block.name}/policy"
            found |= {
                f"{encoder}/loss": 3 * np.exp(-age) + 1.2 + noise[0],
                f"{encoder}/accuracy": 1 - 0.8 * np.exp(-age) + 0.3 * noise[1],
                f"{encoder}/alignment": 0.1 + 0.2 * np.exp(-age) + 0.2 * noise[2],
                f"{encoder}/uniformity": -1.5 + np.exp(-age) + noise[3],
                f"{policy}/loss": 0.4 * np.exp(-age) + noise[4],
                f"{policy}/policy_loss": -0.02 + 0.3 * noise[5],
                f"{policy}/value_loss": 0.8 * np.exp(-age) + 0.1 + noise[6],
                f"{policy}/approx_kl": 0.02 + 0.1 * abs(noise[7]),
                f"{policy}/clip_fraction": 0.15 + noise[8],
                f"{policy}/explained_variance": 1 - np.exp(-age),
                f"{policy}/entropy": 8 - age,
                f"{policy}/reward_mean": -1 + 0.9 * (1 - np.exp(-age)) + noise[9],
                f"{policy}/lag_mean": 0.4 + noise[10],
                f"{policy}/lag_max": 1.0,
            }
        return found

    def _status(self, service: str, life: str, phase: Phase, term: int, **fields: object) -> Status:
        metrics = {"cpu_secs": self._seq * 0.7, "rss_mb": 120.0 + len(service)}
        header = {"run": RUN, "term": term, "block": ALL_BLOCKS, "life": life, "seq": self._seq}
        metrics |= dict(fields.pop("metrics", {}))  # type: ignore[call-overload]
        return Status.model_validate(
            {**header, "service": service, "phase": phase, "metrics": metrics, **fields}
        )


def key_of(message: View | Status | PhaseAnnounced) -> tuple[str, str]:
    """(kind, key) under which a message is published."""
    return message.kind, keys.of(message)
