"""What the policy learner takes from the run's settings."""

from dataclasses import dataclass

import numpy as np

from babble.blocks import BlockTree
from babble.landmarks import Landmark
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
    diameter: float
    crossing_axis: int | None
    landmarks: tuple[Landmark, ...]
    """that the block is scored by"""
    policy: PolicySettings
    goals: GoalSettings
    evaluation: EvaluationSettings
    segment_steps: int
    steps: dict[Phase, int]
    """Environment steps of training, by phase."""
    seed: int

    def updates(self, phase: Phase) -> int:
        """PPO updates of a phase: its steps in whole rollouts, rounded up."""
        return -(-self.steps[phase] // self.rollout_steps)

    @property
    def rollout_steps(self) -> int:
        """Environment steps of one PPO update."""
        return self.segment_steps * self.policy.rollout_columns

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
    diameter: float,
    crossing_axis: int | None,
    landmarks: tuple[Landmark, ...] = (),
) -> PolicyWorkConfig:
    """The configuration of one block; `index` is its place in the tree, for the seed."""
    return PolicyWorkConfig(
        run=run,
        block=block,
        latent_dim=settings.one_block(block).latent_dim,
        action_size=tree.action_size_of(block),
        posture_size=posture_size,
        diameter=diameter,
        crossing_axis=crossing_axis,
        landmarks=landmarks,
        policy=settings.policy,
        goals=settings.goals,
        evaluation=settings.evaluation,
        segment_steps=settings.actors.segment_steps,
        steps={Phase.GROUND: settings.phases.ground_steps, Phase.PRACTISE: settings.phases.practise_steps},
        seed=int(np.random.SeedSequence([settings.seed, 2, index]).generate_state(1)[0]),
    )
