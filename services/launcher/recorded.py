"""What a run has recorded of its actors' states, in words: while it goes on, and from its folder."""

from collections.abc import Mapping
from pathlib import Path

from babble.recording import STATES, Recording, RecordingError
from services.launcher.report_tables import table_head, table_row
from services.runtime.settings import RunSettings

NOTHING_LEARNED = "nothing is learned in an open loop, so there are no scores"
NOTHING_RECORDED = "nothing has been recorded yet"


def counts_words(totals: Mapping[str, int]) -> str:
    """The recorder's totals as it tells them; empty before its first word."""
    if "rows" not in totals:
        return ""
    words = f"{totals['rows']:,} rows in {_files_words(totals.get('files', 0), totals.get('bytes', 0))}"
    gaps = totals.get("gaps", 0)
    return f"{words}; {gaps:,} rows are missing" if gaps else words


def outcome_words(folder: Path, shown: str, settings: RunSettings) -> list[str]:
    """Sentences on what a run recorded, where it is and how to see it; none of a run that does not record."""
    learned = [NOTHING_LEARNED] if settings.phases.open_loop else []
    if not settings.recording.every_steps:
        return learned
    if not _parts(folder):
        return [*learned, NOTHING_RECORDED]
    try:
        recording = Recording.open(folder)
    except RecordingError as error:
        return [*learned, str(error)]
    what = f"{recording.rows:,} rows of {len(recording.state_names)} state components"
    return [
        *learned,
        f"{what} are in {shown}/{STATES} ({_on_disk(folder)})",
        f"see what was explored with: babble coverage {shown}",
    ]


def report_section(folder: Path, shown: str, settings: RunSettings) -> list[str]:
    """The section of a report; empty for a run that does not record."""
    if not settings.recording.every_steps:
        return []
    lines = ["## What was recorded", ""]
    if not _parts(folder):
        return [*lines, "Nothing yet."]
    try:
        return [*lines, *_recorded(folder, shown)]
    except RecordingError as error:
        return [*lines, f"It cannot be read: {error}."]


def _recorded(folder: Path, shown: str) -> list[str]:
    """Raises `RecordingError`."""
    recording = Recording.open(folder)
    audit = recording.audit()
    n = recording.every_steps
    every = "each environment step" if n == 1 else f"one in {n:,} environment steps"
    states, actors = len(recording.state_names), _count(len(audit.actors), "actor")
    read = " or ".join(
        (
            f'`pandas.read_parquet("{shown}/{STATES}")`',
            f'`polars.read_parquet("{shown}/{STATES}/**/*.parquet", hive_partitioning=True)`',
        )
    )
    return [
        f"`{STATES}/` has a row for {every} of each world: {recording.rows:,} rows of "
        f"{states} state components, by {actors}, in {_on_disk(folder)}. "
        f"Rows that are there twice: {audit.duplicates:,}; rows that are missing: {audit.gaps:,}.",
        "",
        *table_head(["phase", "rows"]),
        *(table_row([phase, f"{count:,}"]) for phase, count in audit.rows_by_phase.items()),
        "",
        f"To read it: {read}. `babble coverage {shown}` says what was explored.",
    ]


def _parts(folder: Path) -> list[Path]:
    return list(folder.glob(f"{STATES}/*/part-*.parquet"))


def _on_disk(folder: Path) -> str:
    parts = _parts(folder)
    return _files_words(len(parts), sum(path.stat().st_size for path in parts))


def _files_words(count: int, size_bytes: int) -> str:
    return f"{_count(count, 'file')}, {size_bytes / 1e6:,.1f} MB"


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
