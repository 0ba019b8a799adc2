"""The numbers of a run as event files for TensorBoard; they are the rows of `scalars.parquet`."""

from pathlib import Path

from services.launcher.records import Records
from services.launcher.scalars import Scalar, scalars
from services.launcher.timeline import timeline_of
from services.runtime.checkpoint import refuse_storage
from services.runtime.errors import UserError

FOLDER = "tensorboard"
PREFIX = "events"
EARLIER = f"{PREFIX}.out.tfevents.*"


def write_events(run_dir: Path) -> Path:
    """Write `tensorboard/` in a run folder anew; returns the folder.

    A step is a millisecond since the start, of scores an iteration. Raises `UserError` without tensorboardX,
    `StorageError` if the disk refuses.
    """
    try:
        from tensorboardX.event_file_writer import EventsWriter
        from tensorboardX.proto.event_pb2 import Event
        from tensorboardX.proto.summary_pb2 import Summary
    except ModuleNotFoundError:
        raise UserError(
            "tensorboardX, which writes event files, is not installed here; install it with "
            "`.venv/bin/uv sync --locked --inexact --extra tensorboard`, or leave out --tensorboard"
        ) from None
    folder = run_dir / FOLDER
    start_secs = timeline_of(Records(run_dir / "events.jsonl")).start_secs
    try:
        folder.mkdir(exist_ok=True)
        for earlier in folder.glob(EARLIER):
            earlier.unlink()
        # Not its SummaryWriter, which takes five times as long through a queue and a thread.
        writer = EventsWriter(str(folder / PREFIX))
        try:
            for row in scalars(run_dir):
                value = Summary.Value(tag=tag_of(row), simple_value=row.value)
                told = Summary(value=[value])
                wall_secs = start_secs + (row.secs or 0.0)
                writer.write_event(Event(wall_time=wall_secs, step=step_of(row), summary=told))
        finally:
            writer.close()
    except OSError as error:
        refuse_storage(folder, error)
    return folder


def tag_of(row: Scalar) -> str:
    """The name of the curve that a number belongs to: of its block, or else of who told it."""
    whose = row.block or row.service
    return row.name if whose is None else f"{whose}/{row.name}"


def step_of(row: Scalar) -> int:
    """Where on its curve a number is."""
    if row.name.startswith("scores/"):
        return row.iteration or 0
    return max(0, round(1000 * (row.secs or 0.0)))
