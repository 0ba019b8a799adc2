"""How the blocks of a level act and what they record, phase by phase (thesis 3.3, 3.5)."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from babble.legs import Seen
from babble.levels import Stage
from babble.noise import Coloured, Noise
from babble.policy.goals import Clock
from babble.policy.together import Drawn, Encoders, Policies
from babble.worlds.batch import Step
from services.actor.models import Held, ModelShelf

Floats = NDArray[np.float32]
Record = dict[str, NDArray[np.generic]]
PolicyMode = Literal["random", "sampled", "mean"]
Pack = Callable[[Floats], Record]
"""A block's observations (E, n) as the arrays that travel; babble.observations.Layout.pack."""


class Way(Protocol):
    """The way in which all blocks of a level act in a phase."""

    policy: PolicyMode
    seen: Mapping[str, Seen | None]
    """By block, the latent and the goal (E, d) that `act` last acted on; None without a latent."""

    def held(self, block: str) -> Held:
        """The models of the current segment."""

    def begin_segment(self) -> None:
        """Take the newest models; called at the border of each segment."""

    def note_progress(self, progress: float) -> None:
        """Hear which share of the term is over, in [0, 1]."""

    def act(self, observation: Floats) -> Floats:
        """The action (E, a) of all blocks on the stage's observation (E, n)."""

    def record(self, observation: Floats, step: Step, episode: NDArray[np.int32]) -> dict[str, Record]:
        """What this step, from the observation (E, n), adds to each block's segment."""


@dataclass(frozen=True)
class Cast:
    """The blocks of a level on their stage, and what each of them sends of what it observes."""

    stage: Stage
    packs: Mapping[str, Pack]

    def seen_by(self, observation: Floats) -> dict[str, Floats]:
        """What each block observes of (E, n)."""
        return {block: observation[:, part] for block, part in self.stage.observed.items()}

    def joined(self, actions: Mapping[str, Floats]) -> Floats:
        """The action (E, a) of all blocks together; what no block drives stays at 0."""
        world = self.stage.world
        action = np.zeros((world.columns, world.action_size), np.float32)
        for block, part in actions.items():
            action[:, self.stage.driven[block]] = part
        return action

    def packed(self, observation: Floats, episode: NDArray[np.int32]) -> dict[str, Record]:
        """The observation and its episode, of each block."""
        observed = self.seen_by(observation).items()
        return {block: {**self.packs[block](part), "episode": episode} for block, part in observed}


class RandomWay:
    """BABBLE: a random walk, whatever is observed; for blocks with children, their goals at random."""

    policy: PolicyMode = "random"

    def __init__(self, cast: Cast, noises: Mapping[str, Noise]) -> None:
        self.seen: Mapping[str, Seen | None] = dict.fromkeys(noises)
        self._cast = cast
        self._noises = noises

    def held(self, block: str) -> Held:
        """Nothing: a random walk needs no model."""
        return Held()

    def begin_segment(self) -> None:
        """Nothing to take."""

    def note_progress(self, progress: float) -> None:
        """Tell the noises whose colour goes with it."""
        for noise in self._noises.values():
            if isinstance(noise, Coloured):
                noise.progress = progress

    def act(self, observation: Floats) -> Floats:
        """The next noise."""
        return self._cast.joined({block: noise.sample() for block, noise in self._noises.items()})

    def record(self, observation: Floats, step: Step, episode: NDArray[np.int32]) -> dict[str, Record]:
        """The observation and its episode."""
        return self._cast.packed(observation, episode)


class _ModelWay:
    """What the ways with models share."""

    policy: PolicyMode = "sampled"

    def __init__(
        self,
        cast: Cast,
        shelf: ModelShelf,
        clocks: Mapping[str, Clock],
        rng: np.random.Generator,
    ) -> None:
        self.seen: Mapping[str, Seen | None] = {}
        self._cast = cast
        self._shelf = shelf
        self._clocks = clocks
        self._rng = rng
        self._held: dict[str, Held] = {}
        self._encoders = Encoders({})
        self._policies = Policies({})

    def held(self, block: str) -> Held:
        """The models of the current segment."""
        return self._held[block]

    def begin_segment(self) -> None:
        """Take the newest models. The collector begins no segment without them."""
        newest = {block: self._shelf.of(block) for block in self._clocks}
        if newest == self._held:
            return
        self._held = newest
        models = {block: held.models() for block, held in newest.items()}
        encoders = {block: each.encoder for block, each in models.items()}
        if encoders != self._encoders.models:
            # Policies are new far more often, and joining takes as long as some steps.
            self._encoders = Encoders(encoders)
        self._policies = Policies({block: each.policy for block, each in models.items()})

    def note_progress(self, progress: float) -> None:
        """Nothing: models act alike from beginning to end."""

    def _goals(self) -> dict[str, Floats]:
        """The goals of the moment."""
        return {block: clock.goal for block, clock in self._clocks.items()}

    def _latents(self, observation: Floats) -> dict[str, Floats]:
        return self._encoders.latents(self._cast.seen_by(observation))

    def _drawn(self, latents: Mapping[str, Floats], goals: Mapping[str, Floats]) -> dict[str, Drawn]:
        """Sampled actions towards the goals."""
        self.seen = {block: (latents[block], goal) for block, goal in goals.items()}
        return self._policies.act(latents, goals, self._rng, "sampled")


class WalkWay(_ModelWay):
    """WALK: from goal to goal with sampled actions, for the encoder to see the way."""

    def __init__(
        self,
        cast: Cast,
        shelf: ModelShelf,
        clocks: Mapping[str, Clock],
        rng: np.random.Generator,
        *,
        hold_steps: int = 1,
    ) -> None:
        """An action is held for `hold_steps` steps of the stage: blocks with children decide less often."""
        super().__init__(cast, shelf, clocks, rng)
        self._hold_steps = hold_steps
        self._steps = 0
        self._action = np.zeros(0, np.float32)

    def act(self, observation: Floats) -> Floats:
        """Sampled actions towards the goals of the moment."""
        if self._steps % self._hold_steps == 0:
            drawn = self._drawn(self._latents(observation), self._goals())
            self._action = self._cast.joined({block: action for block, (action, _) in drawn.items()})
        self._steps += 1
        return self._action

    def record(self, observation: Floats, step: Step, episode: NDArray[np.int32]) -> dict[str, Record]:
        """The observation and its episode."""
        ended = step.terminated | step.truncated
        for clock in self._clocks.values():
            clock.tick(ended)
        return self._cast.packed(observation, episode)


class PractiseWay(_ModelWay):
    """GROUND and PRACTISE: sampled actions, recorded for PPO with the behaviour's log-probabilities."""

    def __init__(
        self,
        cast: Cast,
        shelf: ModelShelf,
        clocks: Mapping[str, Clock],
        rng: np.random.Generator,
        *,
        external: bool,
    ) -> None:
        """`external`: the task's own reward is recorded too, for the policy to be trained on."""
        super().__init__(cast, shelf, clocks, rng)
        self._external = external
        self._latent: dict[str, Floats] | None = None
        self._goal: dict[str, Floats] = {}
        self._acted: dict[str, Drawn] = {}

    def begin_segment(self) -> None:
        """Take the newest models; the latents of the border are encoded anew with them."""
        super().begin_segment()
        self._latent = None

    def act(self, observation: Floats) -> Floats:
        """Sampled actions towards the goals of the moment."""
        if self._latent is None:
            self._latent = self._latents(observation)
        self._goal = self._goals()
        self._acted = self._drawn(self._latent, self._goal)
        return self._cast.joined({block: action for block, (action, _) in self._acted.items()})

    def record(self, observation: Floats, step: Step, episode: NDArray[np.int32]) -> dict[str, Record]:
        """One transition; a goal switch is a truncation under the old goal (eq. 11, facts section 1)."""
        latents, arrived = self._latent, self._latents(step.observation)
        assert latents is not None
        terminated, ended = step.terminated.astype(np.uint8), step.terminated | step.truncated
        records: dict[str, Record] = {}
        for block, clock in self._clocks.items():
            action, log_prob = self._acted[block]
            records[block] = {
                "latent": latents[block],
                "next_latent": arrived[block],
                "goal": self._goal[block],
                "action": action,
                "log_prob": log_prob,
                "truncated": (clock.tick(ended) | step.truncated).astype(np.uint8),
                "terminated": terminated,
            }
            if self._external:
                records[block]["external_reward"] = step.external_reward
        self._latent = None if ended.any() else arrived
        return records
