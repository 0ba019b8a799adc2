"""EVALUATE: legs from random starts in fresh worlds; what is trained on is left where it is."""

import numpy as np

from babble.breakdowns import Breakdowns
from babble.legs import Legs, Walk, Walker, Witness
from services.actor.collect import Finished
from services.actor.config import Body
from services.actor.models import Held, ModelShelf
from services.actor.stages import Term, staged
from services.actor.ways import PolicyMode, Record


class EvaluationCollector:
    """All legs of one set of fresh columns at a time, all blocks at once; a `Collector`."""

    def __init__(
        self,
        term: Term,
        body: Body,
        shelf: ModelShelf,
        rng: np.random.Generator,
        *,
        breakdowns: Breakdowns,
        witness: Witness,
    ) -> None:
        """Raises RuntimeError if models of the blocks below are not held."""
        self.mode: PolicyMode = "mean"
        """of the next walk; one that has begun goes on as it began"""
        self._term = term
        self._stage = staged(term, body, shelf, witness)
        self._shelf = shelf
        self._plan = term.level_settings.evaluation
        self._rng = rng
        self._breakdowns = breakdowns
        self._walk: Walk | None = None
        self._walk_mode: PolicyMode = "mean"
        self._held: dict[str, Held] = {}
        self._steps = 0
        """of the stage; those of attempts that broke down count too"""

    @property
    def env_steps(self) -> int:
        """See `Collector.env_steps`."""
        return self._columns * self._stage.env_steps(self._steps)

    def at_border(self) -> bool:
        """True between two walks."""
        return self._walk is None

    def note_progress(self, progress: float) -> None:
        """See `Collector.note_progress`; walks are the same from the first to the last."""

    def advance(self, steps: int) -> list[Finished]:
        """Walk on for up to `steps` steps; the legs of all blocks once all of them are walked."""
        if self._walk is None:
            self._walk = self._begin()
        walk, before = self._walk, self._walk.steps
        done = walk.advance(steps)
        self._steps += walk.steps - before
        if not done:
            return []
        self._walk = None
        return [self._finish(block, legs) for block, legs in walk.legs().items()]

    @property
    def _columns(self) -> int:
        return self._stage.world.columns

    @property
    def _leg_steps(self) -> int:
        """Steps of the stage in one leg."""
        return self._plan.leg_steps // self._stage.env_steps_per_step

    def _begin(self) -> Walk:
        if self.mode == "random":
            raise RuntimeError("an evaluation acts by the policy, never at random")
        self._held = {block: self._shelf.of(block) for block in self._term.blocks}
        self._walk_mode = self.mode
        return Walk(
            self._stage.world,
            {block: self._walker(block, held) for block, held in self._held.items()},
            self._rng,
            self._plan.legs,
            self._leg_steps,
            self.mode,
            breakdowns=self._breakdowns,
            witness=self._stage.witness,
        )

    def _walker(self, block: str, held: Held) -> Walker:
        models = held.models()
        return Walker(models.encoder, models.policy, self._stage.observed[block], self._stage.driven[block])

    def _finish(self, block: str, legs: Legs) -> Finished:
        steps = self._plan.legs * self._leg_steps
        arrays: Record = {
            "start_posture": np.asarray(legs.start_posture),
            "posture": legs.posture,
            "latent": legs.latent,
            "goal": legs.goal,
        }
        if legs.external_reward is not None:
            arrays["external_reward"] = legs.external_reward
        if legs.side is not None:
            arrays["side"] = legs.side
        return Finished(
            block=block,
            arrays=arrays,
            policy=self._walk_mode,
            encoder_version=self._held[block].encoder_version,
            policy_version=self._held[block].policy_version,
            steps=steps,
            columns=self._columns,
            # With attempts that broke down, so that the gap can be seen.
            first_step=self._steps - steps,
        )
