"""Model versions: as messages on the wire, and as files of the run folder."""

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from protocol.messages import Model
from services.runtime.checkpoint import write_atomically

ModelKind = Literal["encoder", "policy"]


def model_path(run_dir: Path, block: str, kind: str, version: int) -> Path:
    """Where a version is kept in a run folder."""
    return run_dir / "models" / block / f"{kind}-{version}.onnx"


@dataclass(frozen=True, kw_only=True)
class ModelOffer:
    """A version that a learner has to offer."""

    kind: ModelKind
    version: int
    encoder_version: int
    onnx: bytes
    keep: bool
    """True to keep it as a file: an encoder, or a policy at the end of a phase."""

    def message(self, *, run: str, term: int, block: str, life: str, fingerprint: str) -> Model:
        """The version as a message."""
        return Model(
            run=run,
            term=term,
            block=block,
            life=life,
            seq=self.version,
            model=self.kind,
            version=self.version,
            encoder_version=self.encoder_version,
            fingerprint=fingerprint,
            digest=hashlib.sha256(self.onnx).hexdigest(),
            arrays={"onnx": np.frombuffer(self.onnx, np.uint8)},
        )

    def save(self, run_dir: Path, block: str) -> None:
        """Keep the version in the run folder, if it is one to keep."""
        if self.keep:
            path = model_path(run_dir, block, self.kind, self.version)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(path, self.onnx)
