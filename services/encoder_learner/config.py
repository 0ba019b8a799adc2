"""What the encoder learner takes from the run's settings."""

from dataclasses import dataclass

import numpy as np

from babble.blocks import BlockTree
from protocol.messages import Phase
from services.runtime.settings import EncoderSettings, FitSettings, RunSettings

COLLECTS = frozenset({Phase.BABBLE, Phase.WALK})
FITS = frozenset({Phase.ENCODE, Phase.REFINE})


@dataclass(frozen=True, kw_only=True)
class EncoderWorkConfig:
    """The settings of one block's encoder."""

    block: str
    observation_size: int
    latent_dim: int
    encoder: EncoderSettings
    segment_steps: int
    steps: dict[Phase, int]
    """Environment steps to collect, by phase."""
    seed: int

    def fit(self, phase: Phase) -> FitSettings:
        """The fit of a phase: coarse in time for ENCODE, fine for REFINE."""
        return self.encoder.encode if phase is Phase.ENCODE else self.encoder.refine


def work_config(settings: RunSettings, tree: BlockTree, block: str, index: int) -> EncoderWorkConfig:
    """The configuration of one block; `index` is its place in the tree, for the seed."""
    return EncoderWorkConfig(
        block=block,
        observation_size=tree.observation_size_of(block),
        latent_dim=settings.one_block(block).latent_dim,
        encoder=settings.encoder,
        segment_steps=settings.actors.segment_steps,
        steps={Phase.BABBLE: settings.phases.babble_steps, Phase.WALK: settings.phases.walk_steps},
        seed=int(np.random.SeedSequence([settings.seed, 1, index]).generate_state(1)[0]),
    )
