"""`report.md` and `figures/` of a run folder: what was found, how well, and how to see it again."""

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from babble.scores import REACHED
from babble.worlds import WORLDS
from protocol.messages import Phase, Score
from services.launcher.evaluate import Run, RunError, Version, open_run, score_columns
from services.launcher.findings import picture, rolled_out, verdict
from services.runtime.checkpoint import write_atomically
from services.runtime.settings import RunSettings

if TYPE_CHECKING:
    from services.launcher.figures import Curve

Record = Mapping[str, Any]

HEADS = {"separation_worst": "worst", "switch_success": "switch success", "external_reward": "reward"}
CURVES = (
    ("encoder/loss", "encoder loss (ENCODE, REFINE)", "InfoNCE (nats)", {"encode", "refine"}),
    ("policy/reward_mean", "reward (GROUND, PRACTISE)", "mean reward per step", {"ground", "practise"}),
    ("policy/external_reward_mean", "the task's own reward", "mean per step", {"ground", "practise"}),
)
"""Of `metrics.jsonl`: name after the block, title, axis, and the phases in which it is fresh."""


def write_report(run_dir: Path) -> Path:
    """Write `report.md` and the figures of a run, finished or not; returns its path.

    Raises `RunError`, `SettingsError` or `StorageError`.
    """
    run = open_run(run_dir)
    events = _lines(run.folder / "events.jsonl")
    (run.folder / "figures").mkdir(exist_ok=True)
    sections = [_heading(run, events)]
    for block in run.blocks:
        sections.append(_block(run, block))
    sections += [_phases(run, events), _processor(run), _differences(run), _origin(run), _again(run)]
    path = run.folder / "report.md"
    text = "\n\n".join("\n".join(section).strip() for section in sections if section)
    write_atomically(path, text.encode() + b"\n")
    return path


def _heading(run: Run, events: Sequence[Record]) -> list[str]:
    lines = [f"# Run {run.name}: {run.settings.scenario}", ""]
    entry = WORLDS.get(run.settings.world.id)
    if entry is not None:
        lines += [f"World: {entry.id}, {entry.description}. Seed of the run: {run.settings.seed}.", ""]
    phases = [str(event.get("text", "")) for event in events if event.get("what") == "phase"]
    if not phases:
        lines.append("**This run is unfinished**: no phase has been announced yet.")
    elif not phases[-1].startswith(Phase.DONE.value):
        lines.append(
            f"**This run is unfinished**: its last phase is {phases[-1]}. "
            f"`babble up --resume {run.shown}` goes on from there."
        )
    if not run.blocks:
        lines += ["", "Nothing has been evaluated yet, so there are no scores and no figures."]
    return lines


def _block(run: Run, block: str) -> list[str]:
    """Verdict, score table and figures of one block."""
    rows = [row for row in run.scores if row.block == block]
    version = run.version(block)
    try:
        places, pictures = rolled_out(run, version)
    except RunError as error:
        places, pictures = [f"The saved models could not be rolled out: {error}."], []
    title = f"## What block {block} found" if len(run.blocks) > 1 else "## What was found"
    lines = [title, "", verdict(run, version, rows), "", *places, "", *_scores(run, version, rows), ""]
    return [*lines, *pictures, *_learning(run, block, rows)]


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
        cells += ["" if number is None else f"{number:.3f}" for number in numbers]
        lines.append(_table_row(cells))
    return lines


def _learning(run: Run, block: str, rows: Sequence[Score]) -> list[str]:
    from services.launcher import figures

    curves = _curves(block, _lines(run.folder / "metrics.jsonl"))
    path = run.folder / "figures" / f"{block}-learning.png"
    figures.draw_learning(path, rows, run.best.get(block), curves, f"{run.name}, block {block}: learning")
    losses = (
        "the encoder's loss and the policy's reward" if curves else "no losses: there is no metrics.jsonl"
    )
    return picture(f"{block}-learning", f"Scores by iteration, and {losses}.")


def _curves(block: str, metrics: Sequence[Record]) -> list["Curve"]:
    """The learners' measures over time, from their statuses; a new piece where the term changes."""
    from services.launcher.figures import Curve

    start = min((line["now_secs"] for line in metrics if "now_secs" in line), default=0.0)
    curves = []
    for name, title, label, fresh in CURVES:
        pieces: dict[Any, tuple[list[float], list[float]]] = {}
        for line in metrics:
            value = line.get("metrics", {}).get(f"{block}/{name}")
            if value is not None and line.get("phase") in fresh:
                seconds, values = pieces.setdefault(line.get("term"), ([], []))
                seconds.append(line["now_secs"] - start)
                values.append(value)
        if pieces:
            curves.append(Curve(title, label, list(pieces.values())))
    return curves


def _phases(run: Run, events: Sequence[Record]) -> list[str]:
    """Time and steps by phase; empty without events."""
    times: dict[str, list[float]] = {}
    borders = [event for event in events if event.get("what") in ("phase", "end")]
    for event, after in itertools.pairwise(borders):
        if event["what"] == "phase":
            times.setdefault(str(event["text"]).split()[0], []).append(after["secs"] - event["secs"])
    times.pop(Phase.DONE.value, None)
    if not times:
        return []
    planned = _planned_steps(run.settings)
    lines = ["## Time", "", *_table_head(["phase", "times", "seconds", "environment steps each (settings)"])]
    for phase, seconds in times.items():
        steps = f"{planned[phase]:,}" if phase in planned else "none"
        lines.append(_table_row([phase, str(len(seconds)), f"{sum(seconds):.1f}", steps]))
    total = sum(map(sum, times.values()))
    lines.append(_table_row(["all", "", f"{total:.1f}", ""]))
    return [*lines, "", "Seconds are wall-clock time between announcements, waiting included."]


def _processor(run: Run) -> list[str]:
    """CPU seconds by process, which the launcher records at the end; empty before."""
    path = run.folder / "result.json"
    used = json.loads(path.read_bytes()).get("cpu_secs", {}) if path.is_file() else {}
    if not used:
        return []
    rows = [_table_row([name, f"{secs:.1f}"]) for name, secs in used.items()]
    all_of_it = _table_row(["all", f"{sum(used.values()):.1f}"])
    return ["## CPU", "", *_table_head(["process", "CPU seconds"]), *rows, all_of_it]


def _planned_steps(settings: RunSettings) -> dict[str, int]:
    phases, legs = settings.phases, settings.evaluation
    return {
        "babble": phases.babble_steps,
        "ground": phases.ground_steps,
        "walk": phases.walk_steps,
        "practise": phases.practise_steps,
        "evaluate": 2 * legs.columns * legs.legs * legs.leg_steps,
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


def _origin(run: Run) -> list[str]:
    record = json.loads((run.folder / "run.json").read_bytes())
    rows = (_table_row([name, f"`{value}`"]) for name, value in _flat(record).items())
    return ["## Where it comes from", "", *_table_head(["what", "value"]), *rows]


def _again(run: Run) -> list[str]:
    return [
        "## See it again",
        "",
        f"- `babble score {run.shown}` rolls the saved models out in fresh worlds and scores them anew",
        f"- `babble score {run.shown} --control` does so with a policy on an untrained encoder, "
        "which must fail",
    ]


def _lines(path: Path) -> list[Record]:
    """The records of a file of JSON lines; none if it is missing. What is not a whole record is left out."""
    if not path.is_file():
        return []
    records: list[Record] = []
    for line in path.read_bytes().split(b"\n"):
        try:
            record = json.loads(line)
        except ValueError:
            continue
        if isinstance(record, dict):
            records.append(record)
    return records


def _flat(table: Mapping[str, Any], before: str = "") -> dict[str, Any]:
    """Nested tables as dotted names; sequences as lists."""
    flat: dict[str, Any] = {}
    for name, value in table.items():
        if isinstance(value, Mapping):
            flat |= _flat(value, f"{before}{name}.")
        else:
            flat[before + name] = list(value) if isinstance(value, tuple) else value
    return flat


def _table_head(names: Sequence[str]) -> list[str]:
    return [_table_row(names), _table_row(["---"] * len(names))]


def _table_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
