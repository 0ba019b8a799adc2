"""How one block acts and what it records, phase by phase (thesis 3.3)."""

from collections.abc import Callable
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from babble.legs import Seen
from babble.noise import Noise
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.goals import GoalClock, WalkClock
from babble.worlds.batch import Step
from services.actor.models import Held, ModelShelf

Floats = NDArray[np.float32]
Record = dict[str, NDArray[np.generic]]
PolicyMode = Literal["random", "sampled", "mean"]
Pack = Callable[[Floats], Record]
"""A block's observations (E, n) as the arrays that travel; babble.observations.Layout.pack."""


class Way(Protocol):
    """One block's way of acting in a phase."""

    policy: PolicyMode
    held: Held
    """The models of the current segment."""
    seen: Seen | None
    """The latent and the goal (E, d) that `act` last acted on; None without a latent."""

    def begin_segment(self) -> None:
        """Take the newest models; called at the border of each segment."""

    def act(self, observation: Floats) -> Floats:
        """The block's action (E, a) on its observation (E, n)."""

    def record(self, observation: Floats, arrived: Floats, step: Step, episode: NDArray[np.int32]) -> Record:
        """What this step adds to the segment; `arrived` is the block's observation after it."""


class RandomWay:
    """BABBLE: a random walk, whatever is observed."""

    policy: PolicyMode = "random"
    held = Held()
    seen: Seen | None = None

    def __init__(self, noise: Noise, pack: Pack) -> None:
        self._noise = noise
        self._pack = pack

    def begin_segment(self) -> None:
        """Nothing: a random walk needs no model."""

    def act(self, observation: Floats) -> Floats:
        """The next noise."""
        return self._noise.sample()

    def record(self, observation: Floats, arrived: Floats, step: Step, episode: NDArray[np.int32]) -> Record:
        """The observation and its episode."""
        return {**self._pack(observation), "episode": episode}


class _ModelWay:
    """What the ways with models share."""

    policy: PolicyMode = "sampled"

    def __init__(
        self, block: str, shelf: ModelShelf, clock: GoalClock | WalkClock, rng: np.random.Generator
    ) -> None:
        self.held = Held()
        self.seen: Seen | None = None
        self._block = block
        self._shelf = shelf
        self._clock = clock
        self._rng = rng

    def begin_segment(self) -> None:
        """Take the newest models. The collector begins no segment without them."""
        self.held = self._shelf.of(self._block)

    def _models(self) -> tuple[EncoderModel, PolicyModel]:
        if self.held.encoder is None or self.held.policy is None:
            raise RuntimeError(f"block {self._block} was asked to act before it held an encoder and a policy")
        return self.held.encoder, self.held.policy


class WalkWay(_ModelWay):
    """WALK: from vertex to vertex with sampled actions, for the encoder to see the way."""

    def __init__(
        self, block: str, shelf: ModelShelf, clock: WalkClock, rng: np.random.Generator, pack: Pack
    ) -> None:
        super().__init__(block, shelf, clock, rng)
        self._pack = pack

    def act(self, observation: Floats) -> Floats:
        """Sampled actions towards the vertex of the moment."""
        encoder, policy = self._models()
        latent, goal = self.seen = encoder.latent(observation), self._clock.goal
        action, _ = policy.act(latent, goal, self._rng, mode="sampled")
        return action

    def record(self, observation: Floats, arrived: Floats, step: Step, episode: NDArray[np.int32]) -> Record:
        """The observation and its episode."""
        self._clock.tick()
        return {**self._pack(observation), "episode": episode}


class PractiseWay(_ModelWay):
    """GROUND and PRACTISE: sampled actions, recorded for PPO with the behaviour's log-probabilities."""

    def __init__(
        self,
        block: str,
        shelf: ModelShelf,
        clock: GoalClock | WalkClock,
        rng: np.random.Generator,
        *,
        external: bool,
    ) -> None:
        """`external`: the task's own reward is recorded too, for the policy to be trained on."""
        super().__init__(block, shelf, clock, rng)
        self._external = external
        self._latent: Floats | None = None
        self._goal = clock.goal
        self._action = self._log_prob = np.zeros(0, np.float32)

    def begin_segment(self) -> None:
        """Take the newest models; the latent of the border is encoded anew with them."""
        super().begin_segment()
        self._latent = None

    def act(self, observation: Floats) -> Floats:
        """Sampled actions towards the goal of the moment."""
        encoder, policy = self._models()
        if self._latent is None:
            self._latent = encoder.latent(observation)
        self._goal = self._clock.goal
        self.seen = self._latent, self._goal
        self._action, self._log_prob = policy.act(self._latent, self._goal, self._rng, mode="sampled")
        return self._action

    def record(self, observation: Floats, arrived: Floats, step: Step, episode: NDArray[np.int32]) -> Record:
        """One transition; a goal switch is a truncation under the old goal (eq. 11, facts section 1)."""
        encoder, _ = self._models()
        next_latent = encoder.latent(arrived)
        switched = self._clock.tick()
        record: Record = {
            "latent": np.asarray(self._latent),
            "next_latent": next_latent,
            "goal": self._goal,
            "action": self._action,
            "log_prob": self._log_prob,
            "truncated": (switched | step.truncated).astype(np.uint8),
            "terminated": step.terminated.astype(np.uint8),
        }
        if self._external:
            record["external_reward"] = step.external_reward
        ended = step.terminated | step.truncated
        self._latent = None if ended.any() else next_latent
        return record
