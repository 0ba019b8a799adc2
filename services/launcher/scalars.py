"""All numbers of a run in one table, `scalars.parquet`, for the tools that people compare runs with.

Long form, a row per number: of `metrics.jsonl` (what learners measure and count), `scores.jsonl` and
`events.jsonl` (how often each kind of thing has happened so far). Files are read and written piece by piece.
"""

import itertools
import os
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import NamedTuple

from services.launcher.records import Records, count, moment, number, table, text
from services.launcher.timeline import MEMBER, Timeline, timeline_of
from services.runtime.checkpoint import DRAFT_SUFFIX, refuse_storage
from services.runtime.errors import UserError
from services.runtime.settings import load

FILE = "scalars.parquet"
ROWS_AT_ONCE = 1 << 16
NO_MEASURES = ("iteration", "steps")
SCORED_BY = ("mean", "sampled")


class Scalar(NamedTuple):
    """One number. Fields are None where they do not apply or are not known."""

    secs: float | None
    """since the run was first announced, by the clock on the wall"""
    term: int | None
    phase: str | None
    iteration: int | None
    block: str | None
    service: str | None
    name: str
    """such as encoder/loss, scores/mean/z_min, rss_mb, event/joined"""
    value: float


def write_scalars(run_dir: Path, run: str) -> Path:
    """Write `scalars.parquet` of a run, finished or not; returns its path.

    Raises `StorageError` if the disk refuses, `UserError` without pyarrow.
    """
    try:
        import pyarrow
        from pyarrow import parquet
    except ModuleNotFoundError:
        raise UserError(
            f"pyarrow, which writes {FILE}, is not installed here; install it with `make setup`"
        ) from None
    # Not dictionaries, which the file has of its own accord: as categories, readers refuse to search them.
    named, number_type, count_type = pyarrow.string(), pyarrow.float64(), pyarrow.int64()
    types = (number_type, count_type, named, count_type, named, named, named, number_type)
    schema = pyarrow.schema([("run", named), *zip(Scalar._fields, types, strict=True)])
    path = run_dir / FILE
    draft = path.with_name(f".{path.name}.{os.getpid()}{DRAFT_SUFFIX}")
    rows = scalars(run_dir)
    try:
        with parquet.ParquetWriter(draft, schema, compression="zstd") as writer:
            while some := list(itertools.islice(rows, ROWS_AT_ONCE)):
                columns = ([run] * len(some), *zip(*some, strict=True))
                told = map(pyarrow.array, columns, (named, *types))
                writer.write_batch(pyarrow.record_batch(list(told), schema))
        draft.replace(path)
    except OSError as error:
        refuse_storage(path, error)
    finally:
        draft.unlink(missing_ok=True)
    return path


def scalars(run_dir: Path) -> Iterator[Scalar]:
    """The numbers of a run folder; what cannot be read is left out."""
    events = Records(run_dir / "events.jsonl")
    timeline = timeline_of(events)
    yield from _of_metrics(Records(run_dir / "metrics.jsonl"), timeline)
    yield from _of_scores(Records(run_dir / "scores.jsonl"), timeline, _levels(run_dir))
    yield from _of_events(events, timeline)


def _of_metrics(metrics: Records, timeline: Timeline) -> Iterator[Scalar]:
    start_secs = timeline.start_secs or None
    for line in metrics:
        now_secs, term = moment(line, "now_secs"), count(line, "term")
        if now_secs is None:
            continue
        start_secs = now_secs if start_secs is None else start_secs
        announced = None if term is None else timeline.terms.get(term)
        iteration = None if announced is None else announced.iteration
        secs, phase, service = now_secs - start_secs, text(line, "phase"), text(line, "service")
        for kind in ("metrics", "totals"):
            for name, value in table(line, kind).items():
                block, _, measure = name.rpartition("/") if kind == "totals" else name.partition("/")
                if not measure:
                    block, measure = "", name
                yield Scalar(secs, term, phase, iteration, block or None, service, measure, value)


def _levels(run_dir: Path) -> dict[str, int]:
    """Block -> its level; empty where the settings cannot be read."""
    try:
        settings = load(run_dir / "config.toml")
        return {block: level for level, blocks in enumerate(settings.levels) for block in blocks}
    except UserError:
        return {}


def _of_scores(scores: Records, timeline: Timeline, levels: Mapping[str, int]) -> Iterator[Scalar]:
    """Told at the end of the evaluation that found them."""
    ends = {
        (told.level, told.iteration, str(told.evaluates)): (span.end_secs, told.term)
        for span in timeline.spans
        if (told := span.announced).evaluates is not None
    }
    for row in scores:
        iteration, phase, policy = count(row, "iteration"), text(row, "phase"), text(row, "policy")
        if iteration is None or policy not in SCORED_BY:
            continue
        level = levels.get(str(text(row, "block")), 0)
        running_secs, term = ends.get((level, iteration, str(phase)), (None, None))
        secs = None if running_secs is None else timeline.wall(running_secs)
        numbers = {name: number(row, name) for name in row if name not in NO_MEASURES and name.isprintable()}
        numbers |= {f"landmark/{name}": value for name, value in table(row, "landmarks").items()}
        for name, value in numbers.items():
            if value is not None:
                place = (secs, term, phase, iteration, text(row, "block"), "policy_learner")
                yield Scalar(*place, f"scores/{policy}/{name}", value)


def _of_events(events: Records, timeline: Timeline) -> Iterator[Scalar]:
    counts: Counter[tuple[str, str | None]] = Counter()
    for event in events:
        secs, what, words = moment(event, "secs"), text(event, "what"), text(event, "text")
        if secs is None or what is None:
            continue
        member = MEMBER.match(words or "")
        service = member.group(2) if member is not None and what in ("joined", "lost") else None
        counts[what, service] += 1
        begun, so_far = secs - timeline.start_secs, counts[what, service]
        yield Scalar(begun, None, None, None, None, service, f"event/{what}", so_far)
