"""The end of a block's learning: it becomes its best version for good, whatever its checkpoint holds."""

from collections.abc import Mapping
from pathlib import Path

from protocol.messages import Frozen
from services.runtime.errors import CheckpointError
from services.runtime.models import model_path
from services.runtime.work import Work, version_of


def freeze(works: Mapping[str, Work], frozen: Mapping[str, Frozen], run_dir: Path) -> None:
    """Make each of these works, by block, offer at least the version that the run froze its block at.

    A work that has it already is left alone. Others become the kept file of the version that was best: one
    that has trained on past it, and one whose checkpoint is of before it. Raises `CheckpointError` where that
    file is missing or no model.
    """
    for block, at in frozen.items():
        work = works.get(block)
        if work is None:
            continue
        version, best = (at.encoder, at.of_encoder) if work.kind == "encoder" else (at.policy, at.of_policy)
        if version_of(work) >= version:
            continue
        path = model_path(run_dir, block, work.kind, best)
        try:
            work.freeze(version, path.read_bytes())
        except (OSError, ValueError) as error:
            why = error.strerror if isinstance(error, OSError) else error
            raise CheckpointError(
                f"the run acts with {work.kind} {best} of block {block}, which is trained no more, and its "
                f"file {path} cannot be used ({why}); restore it from a backup or start a new run"
            ) from None
