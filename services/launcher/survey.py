"""Reading a run folder at any moment of its life: what is torn or damaged is left out, and told."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from protocol.messages import Score
from services.launcher.curves import Curves, read_curves
from services.launcher.records import Records
from services.launcher.run_folder import RunFolder
from services.launcher.scored_run import Run, RunError, read_best
from services.launcher.timeline import Timeline, timeline_of
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings


@dataclass(frozen=True, kw_only=True)
class Survey:
    """What a run folder holds, as far as it can be read."""

    run: Run
    timeline: Timeline
    curves: Curves
    record: Mapping[str, Any]
    """`run.json`"""
    result: Mapping[str, Any]
    """`result.json`; empty before the run is completed"""
    going_on: bool
    """a launcher holds the folder"""
    troubles: Sequence[str]
    """what could not be read, a sentence each"""


def survey_of(run_dir: Path) -> Survey:
    """Read all but the models. Raises `UserError` for what is no run folder, or without its settings."""
    found, troubles = RunFolder.find(str(run_dir)), list[str]()
    folder, settings = found.path, found.settings()
    metrics, events = Records(folder / "metrics.jsonl"), Records(folder / "events.jsonl")
    scores = Records(folder / "scores.jsonl")
    curves = read_curves(metrics)
    timeline = timeline_of(events, curves.alive_secs, open_loop=settings.phases.open_loop)
    rows = _scores_of(scores, settings, troubles)
    troubles += [records.trouble for records in (metrics, events, scores) if records.trouble]
    try:
        best = read_best(folder)
    except RunError as error:
        best = {}
        troubles.append(f"{error}.")
    run = Run(folder=folder, shown=found.shown, name=found.run, settings=settings, scores=rows, best=best)
    return Survey(
        run=run,
        timeline=timeline,
        curves=curves,
        record=_table_in(folder / "run.json", troubles),
        result=_table_in(folder / "result.json", troubles),
        going_on=_is_going_on(found),
        troubles=troubles,
    )


def _scores_of(records: Records, settings: RunSettings, troubles: list[str]) -> tuple[Score, ...]:
    known, rows, strange = {block.name for block in settings.block}, list[Score](), 0
    for record in records:
        try:
            # As JSON: in it an enumeration is a text.
            row = Score.model_validate_json(json.dumps(record))
        except ValidationError:
            strange += 1
            continue
        if row.block in known:
            rows.append(row)
        else:
            strange += 1
    if strange:
        troubles.append(f"{strange} of the records in `scores.jsonl` are no scores of this run; left out.")
    return tuple(rows)


def _table_in(path: Path, troubles: list[str]) -> Mapping[str, Any]:
    """The table in a JSON file; empty if there is none."""
    try:
        found = json.loads(path.read_bytes())
        if isinstance(found, Mapping):
            return found
        troubles.append(f"`{path.name}` holds no table and is left out.")
    except FileNotFoundError:
        pass
    except (OSError, ValueError, RecursionError) as error:
        troubles.append(f"`{path.name}` could not be read ({error}) and is left out.")
    return {}


def _is_going_on(found: RunFolder) -> bool:
    try:
        return found.in_use()
    except UserError:
        return False
