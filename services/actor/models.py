"""The newest models an actor holds; latest wins, and a model of another interface never enters."""

from collections.abc import Iterable
from dataclasses import dataclass

from babble.limbs import BlockModels
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from protocol.latest import LatestModel
from protocol.messages import Model, ModelFloor


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

    def __init__(self, blocks: Iterable[str]) -> None:
        self._held = {block: Held() for block in blocks}
        self._latest = LatestModel()
        self.unusable = 0
        """Models that ONNX Runtime or the interface refused."""
        self.last_error = ""

    def admit(self, model: Model) -> bool:
        """Hold a model if it is newer and usable."""
        held = self._held.get(model.block)
        if held is None or not self._latest.admit(model):
            return False
        onnx = model.arrays["onnx"].tobytes()
        try:
            if model.model == "encoder":
                held = Held(EncoderModel(onnx), model.version, held.policy, held.policy_version)
            else:
                held = Held(held.encoder, held.encoder_version, PolicyModel(onnx), model.version)
        except ModelError as error:
            self.unusable += 1
            self.last_error = f"{model.model} version {model.version} of {model.block}: {error}"
            return False
        self._held[model.block] = held
        return True

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
