"""`report.md` and `figures/` of a run folder: what was found, how well, and how to see it again.

At any moment of a run's life: what is not there yet, or cannot be read, is said and left out.
"""

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from babble.scores import REACHED
from babble.worlds import WORLDS
from protocol.messages import Phase, Score
from services.launcher.evaluate import Run, RunError, Version, score_columns
from services.launcher.findings import rolled_out, verdict
from services.launcher.records import table
from services.launcher.scalars import write_scalars
from services.launcher.survey import Survey, survey_of
from services.launcher.timeline import Timeline
from services.runtime.checkpoint import write_atomically
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings

BRIEF_BYTES = 32 * 10**6
"""Of longer `metrics.jsonl` (five hours) a report without rollouts makes no table: it takes over a second."""
HEADS = {"separation_worst": "worst", "switch_success": "switch success", "external_reward": "reward"}


def write_report(run_dir: Path, *, rollouts: bool = True) -> Path:
    """Write `report.md`, its figures and `scalars.parquet` of a run at any moment; returns the report's path.

    Without `rollouts` the saved models are not tried in fresh worlds, which takes most of the time: then
    there are no figures of where goals lead, and of runs that took many hours no table of numbers.
    Raises `UserError` for what is no run folder, settings that cannot be read, and a disk that refuses.
    """
    survey = survey_of(run_dir)
    run = survey.run
    sections = [_heading(survey)]
    for block in run.blocks:
        sections.append(_block(survey, block, rollouts=rollouts))
    measured = survey.curves.blocks
    sections += [_learning(survey, b.name, []) for b in run.settings.block if _is_new(run, measured, b.name)]
    sections += [_phases(survey), _processor(survey), _numbers(run, brief=not rollouts), _differences(run)]
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
    if not run.blocks:
        lines += ["", "Nothing has been evaluated yet, so there are no scores."]
    if survey.troubles:
        lines += ["", "Not everything could be read:", "", *(f"- {trouble}" for trouble in survey.troubles)]
    return lines


def _unfinished(survey: Survey) -> str:
    newest, shown = survey.timeline.newest, survey.run.shown
    if survey.going_on:
        where = f"its phase is {newest}" if newest else "no phase has been announced yet"
        return f"**This run is still going on**: {where}. `babble report {shown}` writes this anew."
    if not newest:
        return "**This run is unfinished**: no phase has been announced yet."
    resume = f"`babble up --resume {shown}` goes on from there."
    return f"**This run is unfinished**: its last phase is {newest}. {resume}"


def _block(survey: Survey, block: str, *, rollouts: bool) -> list[str]:
    """Verdict, score table and figures of one block."""
    run = survey.run
    rows = [row for row in run.scores if row.block == block]
    lines = [f"## What block {block} found" if len(run.blocks) > 1 else "## What was found", ""]
    pictures: list[str] = []
    try:
        version = run.version(block)
    except RunError as error:
        # What is kept was not measured, as far as can be read.
        version = run.version(block, max(run.versions(block)))
        lines += [f"What is kept is not known here: {error}.", ""]
    lines += [verdict(run, version, rows), ""]
    if rollouts:
        try:
            places, pictures = rolled_out(run, version)
        except RunError as error:
            places = [f"The saved models could not be rolled out: {error}."]
        lines += [*places, ""]
    else:
        lines += [f"The saved models were not rolled out here; `babble report {run.shown}` does that.", ""]
    return [*lines, *_scores(run, version, rows), "", *pictures, *_learning(survey, block, rows)]


def _scores(run: Run, version: Version, rows: Iterable[Score]) -> list[str]:
    rows = sorted(rows, key=lambda row: (row.iteration, row.policy))
    landmarks = list(dict.fromkeys(name for row in rows for name in row.landmarks))
    asked = (
        f"z_min and each of {', '.join(landmarks)}"
        if landmarks
        else "separation, z_min and, where there are two halves, crossing"
    )
    columns = score_columns(rows)
    lines = [
        f"Scores during the run; success is {asked} of {REACHED} or more:",
        "",
        *_table_head(["iteration", "after", "actions", *(HEADS.get(name, name) for name in columns)]),
    ]
    for index, row in enumerate(rows):
        best = " (best)" if row.iteration == run.best.get(version.block) else ""
        cells = [f"{row.iteration}{best}", row.phase.value, row.policy]
        numbers = [values[index] for values in columns.values()]
        cells += ["" if value is None else f"{value:.3f}" for value in numbers]
        lines.append(_table_row(cells))
    return lines


def _learning(survey: Survey, block: str, rows: Sequence[Score]) -> list[str]:
    from services.launcher import learning_figure
    from services.launcher.figures import picture

    run, curves = survey.run, survey.curves
    path = run.folder / "figures" / f"{block}-learning.png"
    title = f"{run.name}, block {block}: learning"
    learning_figure.draw_learning(path, block, rows, run.best.get(block), curves, survey.timeline, title)
    told = ["Scores by iteration"] if rows else [f"What the learners measured of block {block}"]
    if not curves.of(block):
        told.append("no losses: there are none in metrics.jsonl")
    elif rows:
        told.append("what the learners measured, over the time in the phases in which they learned")
    return picture(f"{block}-learning", f"{', and '.join(told)}.")


def _phases(survey: Survey) -> list[str]:
    """Time and steps by phase; empty without events."""
    from services.launcher import timeline_figure
    from services.launcher.figures import picture

    timeline, run = survey.timeline, survey.run
    if not timeline.spans:
        return []
    timeline_figure.draw_timeline(run.folder / "figures" / "timeline.png", timeline, f"{run.name}: phases")
    times: dict[Phase, list[float]] = {}
    for span in timeline.spans:
        times.setdefault(span.announced.phase, []).append(span.secs)
    planned = _planned_steps(run.settings)
    lines = ["## Time", "", *picture("timeline", "The phases over the time for which the run was running.")]
    lines += _table_head(["phase", "times", "seconds", "environment steps each (settings)"])
    for phase, seconds in times.items():
        steps = f"{planned[phase]:,}" if phase in planned else "none"
        lines.append(_table_row([phase.value, str(len(seconds)), f"{sum(seconds):.1f}", steps]))
    lines.append(_table_row(["all", "", f"{sum(map(sum, times.values())):.1f}", ""]))
    waited_secs = sum(end - begin for begin, end in timeline.waits)
    waiting = (
        f"waiting included: {waited_secs:.1f} s for processes that were not there" if waited_secs else ""
    )
    lines += ["", f"Seconds are wall-clock time between announcements{', ' if waiting else ''}{waiting}."]
    return [*lines, *_restarts(timeline)]


def _restarts(timeline: Timeline) -> list[str]:
    stopped_secs = [restart.stopped_secs for restart in timeline.restarts if restart.stopped_secs]
    again = len(timeline.restarts) - len(stopped_secs)
    told = []
    if stopped_secs:
        resumed = f"It was resumed {_times(len(stopped_secs))}"
        told.append(f"{resumed}; the {sum(stopped_secs):.0f} s in between are left out.")
    if again:
        told.append(f"The coordinator was started again {_times(again)} on the way.")
    if timeline.stalls:
        told.append(f"It stalled {_times(len(timeline.stalls))}; `events.jsonl` says who waited for whom.")
    return ["", " ".join(told)] if told else []


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _processor(survey: Survey) -> list[str]:
    """CPU seconds by process, which the launcher records at the end; empty before."""
    used = table(survey.result, "cpu_secs")
    if not used:
        return []
    rows = [_table_row([name, f"{secs:.1f}"]) for name, secs in used.items()]
    all_of_it = _table_row(["all", f"{sum(used.values()):.1f}"])
    return ["## CPU", "", *_table_head(["process", "CPU seconds"]), *rows, all_of_it]


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


def _planned_steps(settings: RunSettings) -> dict[Phase, int]:
    phases, legs = settings.phases, settings.evaluation
    return {
        Phase.BABBLE: phases.babble_steps,
        Phase.GROUND: phases.ground_steps,
        Phase.WALK: phases.walk_steps,
        Phase.PRACTISE: phases.practise_steps,
        Phase.EVALUATE: 2 * legs.columns * legs.legs * legs.leg_steps,
    }


def _differences(run: Run) -> list[str]:
    """The settings that are not the defaults."""
    defaults = RunSettings(scenario=run.settings.scenario).model_dump()
    entry = WORLDS.get(run.settings.world.id)
    defaults["world"] = {"id": run.settings.world.id, "parameters": entry.defaults if entry else {}}
    usual = _flat(defaults)
    changed = {
        name: value for name, value in _flat(run.settings.model_dump()).items() if usual.get(name) != value
    }
    lines = ["## Settings that differ from the defaults", ""]
    if not changed:
        return [*lines, "None."]
    return [
        *lines,
        *_table_head(["setting", "value"]),
        *(_table_row([f"`{n}`", f"`{v}`"]) for n, v in changed.items()),
    ]


def _origin(survey: Survey) -> list[str]:
    rows = (_table_row([name, f"`{value}`"]) for name, value in _flat(survey.record).items())
    return ["## Where it comes from", "", *_table_head(["what", "value"]), *rows]


def _again(run: Run) -> list[str]:
    return [
        "## See it again",
        "",
        f"- `babble view {run.shown}` replays the recording of the dashboard in a browser, if there is one",
        f"- `babble score {run.shown}` rolls the saved models out in fresh worlds and scores them anew",
        f"- `babble score {run.shown} --control` does so with a policy on an untrained encoder, "
        "which must fail",
    ]


def _flat(tree: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as dotted names; sequences as lists."""
    flat: dict[str, Any] = {}
    for name, value in tree.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{name}.")
        else:
            flat[before + name] = list(value) if isinstance(value, tuple) else value
    return flat


def _table_head(names: Sequence[str]) -> list[str]:
    return [_table_row(names), _table_row(["---"] * len(names))]


def _table_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
