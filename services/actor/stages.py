"""What the blocks of a term act on and how: from the settings and the models held to a way of acting."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from babble.legs import Witness
from babble.levels import Stage, stage_of
from babble.limbs import blocks_below
from babble.noise import Noise, make_noise
from babble.policy.goals import Clock, GoalClock, PointClock, RandomGoals, WalkClock
from babble.worlds import WORLDS
from protocol.messages import Phase
from services.actor.config import Body
from services.actor.models import ModelShelf
from services.actor.ways import Cast, PractiseWay, RandomWay, WalkWay, Way
from services.runtime.settings import RunSettings


@dataclass(frozen=True)
class Term:
    """One phase of one level of a run's blocks."""

    phase: Phase
    blocks: tuple[str, ...]
    """the blocks at work, all of one level"""
    settings: RunSettings
    """of the whole run"""

    @classmethod
    def of(cls, phase: Phase, blocks: Iterable[str], settings: RunSettings) -> "Term":
        """A term in which these blocks are at work, in any order."""
        return cls(phase, tuple(sorted(blocks)), settings)

    @property
    def level(self) -> int:
        """The level of the blocks at work."""
        return self.settings.level_of(self.blocks[0])

    @property
    def level_settings(self) -> RunSettings:
        """The run's settings as they hold at this level."""
        return self.settings.of_level(self.level)

    @property
    def env_steps(self) -> int:
        """Environment steps in one step of the stage."""
        return self.settings.rows_env_steps(self.blocks[0], self.phase)


def staged(term: Term, body: Body, shelf: ModelShelf, witness: Witness) -> Stage:
    """The stage of a term, with the models held of the blocks below. Raises RuntimeError if one is not."""
    tree = body.tree
    below = sorted(blocks_below(tree, term.blocks))
    forms = {block: term.settings.of_block(block).policy.subgoals for block in (*below, *term.blocks)}
    if term.phase is Phase.BABBLE:
        # Random goals are vertices, whatever form the policy gives to its own.
        forms |= dict.fromkeys(term.blocks, "one-hot")
    return stage_of(
        body.world,
        tree,
        term.level,
        {block: shelf.of(block).models() for block in below},
        decision_steps=term.settings.decision_steps,
        steps_per_action=term.env_steps,
        subgoals=forms,
        witness=witness,
    )


def way_of(term: Term, body: Body, stage: Stage, shelf: ModelShelf, rng: np.random.Generator) -> Way:
    """The way of acting in a phase that trains or collects."""
    cast = Cast(stage, {block: body.layouts[block].pack for block in term.blocks})
    if term.phase is Phase.BABBLE:
        return RandomWay(cast, {block: _noise(term, body, block, rng) for block in term.blocks})
    if term.phase is Phase.WALK:
        hold = term.settings.decision_steps[term.level] // term.env_steps
        return WalkWay(cast, shelf, _clocks(term, body, rng), rng, hold_steps=hold)
    external = term.level_settings.goals.external_weight != 0
    return PractiseWay(cast, shelf, _clocks(term, body, rng), rng, external=external)


def _clocks(term: Term, body: Body, rng: np.random.Generator) -> dict[str, Clock]:
    """The goals of each block at work."""
    goals, columns = term.level_settings.goals, body.world.columns
    walks = term.phase is Phase.WALK
    period = (goals.walk_steps_per_goal if walks else goals.period_steps) // term.env_steps
    dims = {block: body.tree.specs[block].latent_dim for block in term.blocks}
    if goals.kind == "random":
        held = None if has_episodes(term.settings) else period
        return {block: PointClock(columns, dim, held, rng) for block, dim in dims.items()}
    clock = WalkClock if walks else GoalClock
    return {block: clock(columns, dim, period, rng) for block, dim in dims.items()}


def has_episodes(settings: RunSettings) -> bool:
    """Whether the run's world begins anew after so many steps."""
    given = settings.world.parameters
    return bool((WORLDS[settings.world.id].maker.defaults() | given).get("episode_steps", 0))


def _noise(term: Term, body: Body, block: str, rng: np.random.Generator) -> Noise:
    babbling = term.settings.of_block(block).babbling
    children = body.tree.specs[block].children
    if children:
        least, most = babbling.subgoal_steps
        return RandomGoals(
            [body.tree.specs[child].latent_dim for child in children],
            body.world.columns,
            rng,
            least_steps=least,
            most_steps=most,
            env_steps=term.env_steps,
        )
    return make_noise(
        **babbling.drawn, columns=body.world.columns, size=body.tree.action_size_of(block), rng=rng
    )
