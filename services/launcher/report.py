"""`report.md` and `figures/` of a run folder: what was found, how well, and how to see it again.

At any moment of a run's life: what is not there yet, or cannot be read, is said and left out.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from babble.worlds import WORLDS
from services.launcher.recorded import NOTHING_LEARNED, report_section
from services.launcher.records import table
from services.launcher.report_blocks import learning, only_block
from services.launcher.report_levels import level_section, tree_summary
from services.launcher.report_tables import table_head, table_row
from services.launcher.report_time import time_section
from services.launcher.scalars import write_scalars
from services.launcher.scored_run import Run
from services.launcher.survey import Survey, survey_of
from services.runtime.checkpoint import write_atomically
from services.runtime.errors import UserError
from services.runtime.settings import BlockSettings, LevelSettings, RunSettings

BRIEF_BYTES = 32 * 10**6
"""Of longer `metrics.jsonl` (five hours) a report without rollouts makes no table: it takes over a second."""


def write_report(run_dir: Path, *, rollouts: bool = True) -> Path:
    """Write `report.md`, its figures and `scalars.parquet` of a run at any moment; returns the report's path.

    Without `rollouts` the saved models are not tried in fresh worlds, which takes most of the time: then
    there are no figures of where goals lead, and of runs that took many hours no table of numbers.
    Raises `UserError` for what is no run folder, settings that cannot be read, and a disk that refuses.
    """
    survey = survey_of(run_dir)
    run = survey.run
    sections = [_heading(survey)]
    if len(run.settings.block) == 1:
        sections += [only_block(survey, block, rollouts=rollouts) for block in run.blocks]
    else:
        # What is sought is found at the top.
        sections += [level_section(survey, level, rollouts=rollouts) for level in reversed(run.levels)]
    measured = survey.curves.blocks
    sections += [learning(survey, b.name) for b in run.settings.block if _is_new(run, measured, b.name)]
    sections += [
        report_section(run.folder, run.shown, run.settings),
        time_section(survey),
        _processor(survey),
        _numbers(run, brief=not rollouts),
        _differences(run),
    ]
    sections += [_origin(survey), _again(run)]
    path = run.folder / "report.md"
    text = "\n\n".join("\n".join(section).strip() for section in sections if section)
    write_atomically(path, text.encode() + b"\n")
    return path


def _is_new(run: Run, measured: Mapping[str, Any], block: str) -> bool:
    """Something was measured of it before it was ever evaluated."""
    return block in measured and block not in run.blocks


def _heading(survey: Survey) -> list[str]:
    run, timeline = survey.run, survey.timeline
    lines = [f"# Run {run.name}: {run.settings.scenario}", ""]
    entry = WORLDS.get(run.settings.world.id)
    if entry is not None:
        lines += [f"World: {entry.id}, {entry.description}. Seed of the run: {run.settings.seed}.", ""]
    if not timeline.done:
        lines.append(_unfinished(survey))
    if run.settings.phases.open_loop:
        lines += ["", f"{_capital(NOTHING_LEARNED)}: actors babble, and what they do is recorded."]
    elif not run.blocks:
        lines += ["", "Nothing has been evaluated yet, so there are no scores."]
    elif len(run.settings.block) > 1:
        lines += ["", f"**{_capital(tree_summary(run))}.**"]
    if survey.troubles:
        lines += ["", "Not everything could be read:", "", *(f"- {trouble}" for trouble in survey.troubles)]
    return lines


def _capital(words: str) -> str:
    return f"{words[0].upper()}{words[1:]}"


def _unfinished(survey: Survey) -> str:
    newest, shown = survey.timeline.newest, survey.run.shown
    if survey.going_on:
        where = f"its phase is {newest}" if newest else "no phase has been announced yet"
        return f"**This run is still going on**: {where}. `babble report {shown}` writes this anew."
    if not newest:
        return "**This run is unfinished**: no phase has been announced yet."
    resume = f"`babble up --resume {shown}` goes on from there."
    return f"**This run is unfinished**: its last phase is {newest}. {resume}"


def _processor(survey: Survey) -> list[str]:
    """CPU seconds by process, which the launcher records at the end; empty before."""
    used = table(survey.result, "cpu_secs")
    if not used:
        return []
    rows = [table_row([name, f"{secs:.1f}"]) for name, secs in used.items()]
    all_of_it = table_row(["all", f"{sum(used.values()):.1f}"])
    return ["## CPU", "", *table_head(["process", "CPU seconds"]), *rows, all_of_it]


def _numbers(run: Run, *, brief: bool) -> list[str]:
    """Where all numbers are, which is written here too; where it takes long, only if there is time for it."""
    metrics = run.folder / "metrics.jsonl"
    if brief and metrics.is_file() and metrics.stat().st_size > BRIEF_BYTES:
        return ["## Numbers", "", f"`babble report {run.shown}` writes all that was measured as a table."]
    try:
        path = write_scalars(run.folder, run.name)
    except UserError as error:
        return ["## Numbers", "", f"There is no table of all numbers: {error}."]
    read = f'pandas.read_parquet("{run.shown}/{path.name}")'
    return [
        "## Numbers",
        "",
        f"`{path.name}` has all that was measured, a row per number, to compare runs with: `{read}` "
        f"or `polars.read_parquet`. `babble report {run.shown} --tensorboard` writes it for TensorBoard.",
    ]


def _differences(run: Run) -> list[str]:
    """The settings that are not the defaults."""
    defaults = RunSettings(scenario=run.settings.scenario).model_dump()
    entry = WORLDS.get(run.settings.world.id)
    defaults["world"] = {"id": run.settings.world.id, "parameters": entry.defaults if entry else {}}
    tables = {"block": BlockSettings().model_dump(), "level": LevelSettings().model_dump()}
    defaults["block"] = [{**tables["block"], "name": block.name} for block in run.settings.block]
    defaults["level"] = [tables["level"] for _ in run.settings.level]
    usual = _flat(defaults)
    changed = {
        name: value for name, value in _flat(run.settings.model_dump()).items() if usual.get(name) != value
    }
    lines = ["## Settings that differ from the defaults", ""]
    if not changed:
        return [*lines, "None."]
    return [
        *lines,
        *table_head(["setting", "value"]),
        *(table_row([f"`{n}`", f"`{v}`"]) for n, v in changed.items()),
    ]


def _origin(survey: Survey) -> list[str]:
    rows = (table_row([name, f"`{value}`"]) for name, value in _flat(survey.record).items())
    return ["## Where it comes from", "", *table_head(["what", "value"]), *rows]


def _again(run: Run) -> list[str]:
    lines = [
        "## See it again",
        "",
        f"- `babble view {run.shown}` replays the recording of the dashboard in a browser, if there is one",
    ]
    if run.settings.recording.every_steps:
        lines.append(f"- `babble coverage {run.shown}` says what was explored, of the recorded states")
    if run.settings.phases.open_loop:
        return lines
    lines.append(
        f"- `babble score {run.shown}` rolls the saved models out in fresh worlds and scores them anew"
    )
    if len(run.settings.block) > 1:
        return lines
    control = f"- `babble score {run.shown} --control` does so with a policy on an untrained encoder, "
    return [*lines, f"{control}which must fail"]


def _flat(tree: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as dotted names, those of a list by their name or number; sequences as lists."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{name}.")
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            for index, each in enumerate(value):
                flat |= _flat(each, f"{before}{name}.{each.get('name', index)}.")
        else:
            flat[before + name] = list(value) if isinstance(value, tuple) else value
    return flat
