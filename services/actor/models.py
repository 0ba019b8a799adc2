"""The newest models an actor holds; latest wins, and a model of another interface never enters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from babble.blocks import BlockTree
from babble.limbs import BlockModels
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from protocol.latest import LatestModel
from protocol.messages import Model, ModelFloor

AnyModel = TypeVar("AnyModel", EncoderModel, PolicyModel)


@dataclass(frozen=True)
class Held:
    """What a block acts with."""

    encoder: EncoderModel | None = None
    encoder_version: int = 0
    policy: PolicyModel | None = None
    policy_version: int = 0

    def meets(self, floor: ModelFloor) -> bool:
        """True if both models are at least of the floor's versions (0 asks for none)."""
        return self.encoder_version >= floor.encoder and self.policy_version >= floor.policy

    def models(self) -> BlockModels:
        """What it acts with. Raises RuntimeError while one of the two is missing."""
        if self.encoder is None or self.policy is None:
            raise RuntimeError("a block was asked to act before it held an encoder and a policy")
        return BlockModels(self.encoder, self.policy)


class ModelShelf:
    """Per block, the newest encoder and policy."""

    def __init__(self, tree: BlockTree) -> None:
        self._tree = tree
        self._held = {block: Held() for block in tree.specs}
        self._latest = LatestModel()
        self.unusable = 0
        """Models that ONNX Runtime refused, of other sizes than the block's, or that give no numbers."""
        self.last_error = ""

    def admit(self, model: Model) -> bool:
        """Hold a model if it is newer and usable."""
        held = self._held.get(model.block)
        if held is None or not self._latest.admit(model):
            return False
        onnx = model.arrays["onnx"].tobytes()
        try:
            if model.model == "encoder":
                encoder = _tried(EncoderModel(onnx), self._encoder_sizes(model.block))
                held = Held(encoder, model.version, held.policy, held.policy_version)
            else:
                policy = _tried(PolicyModel(onnx), self._policy_sizes(model.block))
                held = Held(held.encoder, held.encoder_version, policy, model.version)
        except ModelError as error:
            self.unusable += 1
            self.last_error = f"{model.model} version {model.version} of {model.block}: {error}"
            return False
        self._held[model.block] = held
        return True

    def _encoder_sizes(self, block: str) -> dict[str, int]:
        return {
            "observation": self._tree.observation_size_of(block),
            "latent": self._tree.specs[block].latent_dim,
        }

    def _policy_sizes(self, block: str) -> dict[str, int]:
        latent_dim, actions = self._tree.specs[block].latent_dim, self._tree.action_size_of(block)
        return {"latent": latent_dim, "goal": latent_dim, "mean": actions, "log_std": actions}

    @property
    def stale(self) -> int:
        """Models that were not newer than the newest heard."""
        return self._latest.stale

    def of(self, block: str) -> Held:
        """What the block acts with now."""
        return self._held[block]

    def versions(self) -> dict[str, int]:
        """The versions held, as `Status.versions` names them."""
        encoders = {f"encoder/{block}": held.encoder_version for block, held in self._held.items()}
        policies = {f"policy/{block}": held.policy_version for block, held in self._held.items()}
        return {name: version for name, version in (encoders | policies).items() if version}


def _tried(model: AnyModel, sizes: Mapping[str, int]) -> AnyModel:
    """The model, once it has computed something. Raises `ModelError` for other sizes or no numbers."""
    if found := [name for name, size in model.sizes.items() if size != sizes[name]]:
        name = found[0]
        raise ModelError(f"its {name} has the size {model.sizes[name]}, and the block's has {sizes[name]}")
    outputs = model.run(**{name: np.zeros((1, size), np.float32) for name, size in model.inputs.items()})
    if not all(np.isfinite(output).all() for output in outputs):
        raise ModelError("it gives something else than numbers")
    return model
