"""EVALUATE: legs from random starts in fresh worlds; what is trained on is left where it is."""

import numpy as np

from babble.breakdowns import Breakdowns
from babble.legs import Legs, Walk, Walker, Witness
from services.actor.collect import Finished
from services.actor.config import Body
from services.actor.models import Held, ModelShelf
from services.actor.ways import PolicyMode, Record
from services.runtime.settings import RunSettings


class EvaluationCollector:
    """All legs of one set of fresh columns at a time, all blocks at once; a `Collector`."""

    def __init__(
        self,
        body: Body,
        blocks: list[str],
        shelf: ModelShelf,
        settings: RunSettings,
        rng: np.random.Generator,
        breakdowns: Breakdowns,
        witness: Witness,
    ) -> None:
        self.env_steps = 0
        self.mode: PolicyMode = "mean"
        """of the next walk; one that has begun goes on as it began"""
        self._body = body
        self._blocks = blocks
        self._shelf = shelf
        self._settings = settings.evaluation
        self._rng = rng
        self._breakdowns = breakdowns
        self._witness = witness
        self._walk: Walk | None = None
        self._walk_mode: PolicyMode = "mean"
        self._held: dict[str, Held] = {}

    def at_border(self) -> bool:
        """True between two walks."""
        return self._walk is None

    def advance(self, steps: int) -> list[Finished]:
        """Walk on for up to `steps` steps; the legs of all blocks once all of them are walked."""
        if self._walk is None:
            self._walk = self._begin()
        walk, before = self._walk, self._walk.steps
        done = walk.advance(steps)
        self.env_steps += (walk.steps - before) * self._body.world.columns
        if not done:
            return []
        self._walk = None
        return [self._finish(block, legs) for block, legs in walk.legs().items()]

    def _begin(self) -> Walk:
        if self.mode == "random":
            raise RuntimeError("an evaluation acts by the policy, never at random")
        self._held = {block: self._shelf.of(block) for block in self._blocks}
        self._walk_mode = self.mode
        return Walk(
            self._body.world,
            {block: self._walker(block, held) for block, held in self._held.items()},
            self._rng,
            self._settings.legs,
            self._settings.leg_steps,
            self.mode,
            breakdowns=self._breakdowns,
            witness=self._witness,
        )

    def _walker(self, block: str, held: Held) -> Walker:
        if held.encoder is None or held.policy is None:
            raise RuntimeError(f"block {block} was evaluated before it held an encoder and a policy")
        tree = self._body.tree
        return Walker(held.encoder, held.policy, tree.observed(block), tree.driven(block))

    def _finish(self, block: str, legs: Legs) -> Finished:
        steps = self._settings.legs * self._settings.leg_steps
        arrays: Record = {
            "start_posture": np.asarray(legs.start_posture),
            "posture": legs.posture,
            "latent": legs.latent,
            "goal": legs.goal,
        }
        if legs.external_reward is not None:
            arrays["external_reward"] = legs.external_reward
        columns = self._body.world.columns
        return Finished(
            block=block,
            arrays=arrays,
            policy=self._walk_mode,
            encoder_version=self._held[block].encoder_version,
            policy_version=self._held[block].policy_version,
            steps=steps,
            columns=columns,
            # Attempts that broke down count too, so that the gap can be seen.
            first_step=self.env_steps // columns - steps,
        )
