"""What the encoder learner takes from the run's settings."""

from collections.abc import Iterable
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
    steps: dict[Phase, int]
    """Environment steps to collect, by phase."""
    seed: int

    def fit(self, phase: Phase) -> FitSettings:
        """The fit of a phase: coarse in time for ENCODE, fine for REFINE."""
        return self.encoder.encode if phase is Phase.ENCODE else self.encoder.refine


def work_config(
    settings: RunSettings, tree: BlockTree, senses: Senses, block: str, index: int
) -> EncoderWorkConfig:
    """The configuration of one block; `senses` are the world's, `index` its place in the tree, for the seed.

    Raises `SettingsError` for a block that observes part of an image.
    """
    return EncoderWorkConfig(
        block=block,
        senses=_senses_of(tree, senses, block),
        latent_dim=settings.one_block(block).latent_dim,
        encoder=settings.encoder,
        segment_steps=settings.actors.segment_steps,
        steps={Phase.BABBLE: settings.phases.babble_steps, Phase.WALK: settings.phases.walk_steps},
        seed=int(np.random.SeedSequence([settings.seed, 1, index]).generate_state(1)[0]),
    )


def check_memory(configs: Iterable[EncoderWorkConfig]) -> None:
    """Raises `SettingsError` where the experience of all blocks would take more than `MOST_BYTES`."""
    held = {
        config.block: max(config.steps.values()) * bytes_per_step(Layout(config.senses)) for config in configs
    }
    needed = COPIES * sum(held.values())
    if needed > MOST_BYTES:
        most = max(held, key=lambda block: held[block])
        raise SettingsError(
            f"the encoder learner would need {needed / 1e9:.1f} GB to hold and checkpoint the experience of "
            f"a phase (most for block {most!r}), over its limit of {MOST_BYTES / 1e9:.0f} GB; lower "
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


def _senses_of(tree: BlockTree, senses: Senses, block: str) -> Senses:
    if tree.specs[block].children:
        return {"latent": (tree.observation_size_of(block),)}
    try:
        return part_of(senses, tree.observed(block))
    except ValueError as error:
        raise SettingsError(f"block {block!r}: {error}") from None
