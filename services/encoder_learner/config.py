"""What the encoder learner takes from the run's settings."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from babble.blocks import BlockTree
from babble.encoder.network import weight_bytes
from babble.memory import bytes_per_step
from babble.observations import Layout, Senses, part_of
from protocol.keys import MAX_FRAME_BYTES
from protocol.messages import Phase
from services.runtime.settings import EncoderSettings, FitSettings, RunSettings, SettingsError

COLLECTS = frozenset({Phase.BABBLE, Phase.WALK})
FITS = frozenset({Phase.ENCODE, Phase.REFINE})

MOST_BYTES = 8 * 10**9
"""What the held experience may take, with the copy of it that each checkpoint makes."""
COPIES = 2
HEADER_BYTES = 64 << 10
"""More than enough for what a frame and an ONNX file hold besides the weights."""


@dataclass(frozen=True, kw_only=True)
class EncoderWorkConfig:
    """The settings of one block's encoder."""

    block: str
    senses: Senses
    """what it observes, or one vector of its children's latents"""
    latent_dim: int
    encoder: EncoderSettings
    segment_steps: int
    """rows of a segment"""
    steps: dict[Phase, int]
    """Environment steps to collect, by phase."""
    steps_per_row: dict[Phase, int]
    """Environment steps that one row of a segment stands for, by phase."""
    level: int
    """Only the blocks of one level collect at a time."""
    seed: int

    def rows(self, phase: Phase) -> int:
        """Rows to collect: the steps of the phase, rounded up."""
        return -(-self.steps[phase] // self.steps_per_row[phase])

    def fit(self, phase: Phase) -> FitSettings:
        """The fit of a phase: coarse in time for ENCODE, fine for REFINE; of no updates without CLTT."""
        fit = self.encoder.encode if phase is Phase.ENCODE else self.encoder.refine
        return fit if self.encoder.contrastive else fit.model_copy(update={"updates": 0})


def work_config(
    settings: RunSettings, tree: BlockTree, senses: Senses, block: str, index: int
) -> EncoderWorkConfig:
    """The configuration of one block; `senses` are the world's, `index` its place in the tree, for the seed.

    Raises `SettingsError` for a block that observes part of an image.
    """
    own = settings.of_block(block)
    return EncoderWorkConfig(
        block=block,
        senses=_senses_of(tree, senses, block),
        latent_dim=settings.one_block(block).latent_dim,
        encoder=own.encoder,
        segment_steps=own.actors.segment_steps,
        steps={Phase.BABBLE: own.phases.babble_steps, Phase.WALK: own.phases.walk_steps},
        steps_per_row={phase: settings.rows_env_steps(block, phase) for phase in COLLECTS},
        level=tree.level_of(block),
        seed=int(np.random.SeedSequence([settings.seed, 1, index]).generate_state(1)[0]),
    )


def check_memory(configs: Sequence[EncoderWorkConfig]) -> None:
    """Raises `SettingsError` where the experience of a level's blocks would take more than `MOST_BYTES`."""
    for level in sorted({config.level for config in configs}):
        held = {config.block: _held_bytes(config) for config in configs if config.level == level}
        needed = COPIES * sum(held.values())
        if needed > MOST_BYTES:
            most = max(held, key=lambda block: held[block])
            raise SettingsError(
                f"the encoder learner would need {needed / 1e9:.1f} GB to hold and checkpoint the experience "
                f"of a phase (most for block {most!r}), over its limit of {MOST_BYTES / 1e9:.0f} GB; lower "
                "phases.babble_steps and phases.walk_steps, or the resolution of the world's senses"
            )


def check_models(configs: Iterable[EncoderWorkConfig]) -> None:
    """Raises `SettingsError` where a block's encoder would be larger than a frame may be."""
    for config in configs:
        encoder = config.encoder
        needed = weight_bytes(
            config.senses, config.latent_dim, encoder.hidden, vision_features=encoder.vision_features
        )
        if needed > MAX_FRAME_BYTES - HEADER_BYTES:
            raise SettingsError(
                f"the encoder of block {config.block} would have {needed / 1e6:,.1f} MB, and a frame holds "
                f"{MAX_FRAME_BYTES / 1e6:.1f} MB; lower encoder.hidden or "
                "encoder.vision_features, or the resolution of the world's senses"
            )


def _held_bytes(config: EncoderWorkConfig) -> int:
    """Of the longer of the two phases that collect."""
    return max(config.rows(phase) for phase in COLLECTS) * bytes_per_step(Layout(config.senses))


def _senses_of(tree: BlockTree, senses: Senses, block: str) -> Senses:
    if tree.specs[block].children:
        return {"latent": (tree.observation_size_of(block),)}
    try:
        return part_of(senses, tree.observed(block))
    except ValueError as error:
        raise SettingsError(f"block {block!r}: {error}") from None
