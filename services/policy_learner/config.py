"""What the policy learner takes from the run's settings."""

from dataclasses import dataclass

import numpy as np

from babble.blocks import BlockTree
from babble.parts import Part
from protocol.messages import Phase
from services.runtime.settings import EvaluationSettings, GoalSettings, PolicySettings, RunSettings

PRACTISES = frozenset({Phase.GROUND, Phase.PRACTISE})


@dataclass(frozen=True, kw_only=True)
class PolicyWorkConfig:
    """The settings of one block's policy."""

    run: str
    block: str
    latent_dim: int
    action_size: int
    posture_size: int
    """of the whole body's posture, which legs carry"""
    part: Part
    """that the block moves, and is scored by"""
    policy: PolicySettings
    goals: GoalSettings
    evaluation: EvaluationSettings
    segment_steps: int
    """rows of a segment"""
    steps: dict[Phase, int]
    """Environment steps of training, by phase."""
    steps_per_row: dict[Phase, int]
    """Environment steps that one row of a segment, a decision, stands for, by phase."""
    seed: int

    def updates(self, phase: Phase) -> int:
        """PPO updates of a phase: its steps in whole rollouts, rounded up."""
        return -(-self.steps[phase] // self.rollout_steps(phase))

    def rollout_steps(self, phase: Phase) -> int:
        """Environment steps of one PPO update."""
        return self.segment_steps * self.policy.rollout_columns * self.steps_per_row[phase]

    @property
    def external(self) -> bool:
        """Whether the policy is trained on the task's own reward too."""
        return self.goals.external_weight != 0


def work_config(
    settings: RunSettings,
    tree: BlockTree,
    block: str,
    index: int,
    *,
    run: str,
    posture_size: int,
    part: Part,
) -> PolicyWorkConfig:
    """The configuration of one block; `index` is its place in the tree, for the seed."""
    own = settings.of_block(block)
    return PolicyWorkConfig(
        run=run,
        block=block,
        latent_dim=settings.one_block(block).latent_dim,
        action_size=tree.action_size_of(block),
        posture_size=posture_size,
        part=part,
        policy=own.policy,
        goals=own.goals,
        evaluation=own.evaluation,
        segment_steps=own.actors.segment_steps,
        steps={Phase.GROUND: own.phases.ground_steps, Phase.PRACTISE: own.phases.practise_steps},
        steps_per_row={phase: settings.rows_env_steps(block, phase) for phase in PRACTISES},
        seed=int(np.random.SeedSequence([settings.seed, 2, index]).generate_state(1)[0]),
    )
