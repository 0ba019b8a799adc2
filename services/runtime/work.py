"""What a learner's shell asks of the learning inside it, one `Work` per block."""

from collections.abc import Mapping, Sequence
from typing import Protocol

from protocol.messages import PhaseAnnounced, Progress, Score, Segment
from services.runtime.intake import Want
from services.runtime.models import ModelKind, ModelOffer


class Work(Protocol):
    """One block's learning, without wire or disk, and whatever the clock says."""

    block: str
    kind: ModelKind
    """What it learns."""

    def begin(self, announced: PhaseAnnounced) -> None:
        """Start the work of a new term (none, if the phase is another learner's)."""

    def take(self, segment: Segment) -> bool:
        """Use a segment of this term; False if it is of no use (stale).

        Raises ValueError for arrays that cannot be learned from.
        """

    def advance(self) -> bool:
        """Do a bounded quantum of work; False if there is nothing to do now."""

    def wanted_columns(self) -> int:
        """Columns of experience still wanted in this term."""

    def request(self) -> tuple[Want, int]:
        """How actors should act for it, and the least policy version to act with."""

    def progress(self) -> Progress | None:
        """How far it is in this term; None if the term is not its own."""

    def model(self) -> ModelOffer | None:
        """The newest version, if any."""

    def scores(self) -> Sequence[Score]:
        """What this term's evaluation found."""

    def metrics(self) -> Mapping[str, float]:
        """The newest measurements, by name."""

    def totals(self) -> Mapping[str, int]:
        """Totals since the run began, by name."""

    def freeze(self, version: int, onnx: bytes) -> None:
        """Learn no more: offer this model under this version from now on, also after a restart.

        Raises ValueError for bytes that are not a model of this block.
        """

    def state(self) -> bytes:
        """Everything that a restart needs."""

    def restore(self, state: bytes) -> None:
        """Become what `state()` described."""


def version_of(work: Work) -> int:
    """The newest version that it offers; 0 before the first."""
    offer = work.model()
    return 0 if offer is None else offer.version


def share_of(work: Work) -> float:
    """How much of what it wants of actors in this term it holds, in [0, 1]; 0 if it wants nothing of them."""
    progress = work.progress()
    if progress is None or progress.unit == "updates":
        return 0.0
    return min(1.0, progress.done / max(1, progress.wanted))
