"""What is benchmarked: the cuboid as shipped or another world, with models as learners publish them."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import tomli_w

from babble.blocks import BlockTree
from babble.bodies import make_body
from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.observations import part_of
from babble.policy.export import export_policy
from babble.policy.ppo import GoalPPO
from babble.worlds import make
from babble.worlds.batch import World
from services.runtime.models import ModelOffer
from services.runtime.settings import RunSettings, load, parse

ROOT = Path(__file__).resolve().parents[1]
RUN = "bench"


def cuboid(**sections: dict[str, Any]) -> RunSettings:
    """The shipped scenario; each keyword replaces a section of it."""
    return load(ROOT / "scenarios" / "cuboid.toml", **sections)


def in_world(id: str, parameters: dict[str, Any], **sections: dict[str, Any]) -> RunSettings:
    """The defaults of all settings, in a world."""
    return parse({"scenario": RUN, "world": {"id": id, "parameters": parameters}, **sections}, origin="bench")


def write_run_folder(folder: Path, settings: RunSettings) -> None:
    """What the processes of a run read when they start."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "run.json").write_text(json.dumps({"run": RUN}))
    (folder / "config.toml").write_text(tomli_w.dumps(settings.model_dump(mode="json", exclude_none=True)))


def world_of(settings: RunSettings, columns: int) -> World:
    """That many copies of the run's world."""
    return make(settings.world.id, settings.world.parameters, columns=columns, seed=0)


def body_of(settings: RunSettings) -> tuple[World, BlockTree]:
    """One copy of the run's world, and the blocks on it."""
    return make_body(settings.world.id, settings.world.parameters, settings.block, columns=1, seed=0)


def encoder_of(settings: RunSettings, block: str | None = None) -> Encoder:
    """An untrained encoder of a block's sizes; what it computes does not change what it costs."""
    world, tree = body_of(settings)
    spec = tree.specs[block or settings.block[0].name]
    senses = {"latent": (tree.observation_size_of(spec.name),)} if spec.children else world.senses
    observed = senses if spec.children else part_of(senses, tree.observed(spec.name))
    return Encoder(observed, spec.latent_dim, hidden=settings.encoder.hidden, seed=settings.seed)


def offers_of(settings: RunSettings) -> Mapping[str, Sequence[ModelOffer]]:
    """By block, version 1 of the encoder and of the policy."""
    _, tree = body_of(settings)
    return {block: _offers(settings, tree, block) for block in tree.specs}


def _offers(settings: RunSettings, tree: BlockTree, block: str) -> Sequence[ModelOffer]:
    ppo = GoalPPO(
        tree.specs[block].latent_dim,
        tree.action_size_of(block),
        hidden=tuple(settings.policy.hidden),
        log_std=settings.policy.log_std,
        seed=settings.seed,
    )
    encoder = export_encoder(encoder_of(settings, block), block)
    return [
        ModelOffer(kind="encoder", version=1, encoder_version=1, onnx=encoder, keep=False),
        ModelOffer(kind="policy", version=1, encoder_version=1, onnx=export_policy(ppo, block), keep=False),
    ]
