"""`report.md`, `numbers.json`, `settings.toml` and `figures/` of a study, of what is done at any moment."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from services.launcher.report_tables import table_head, table_row
from services.launcher.run_folder import RunFolder, config_text
from services.launcher.study_figures import draw_over_steps, draw_ratios, draw_spectra
from services.launcher.study_folder import StudyFolder
from services.launcher.study_plan import Plan, StudyError, run_folder_name
from services.launcher.study_sections import (
    conditions_section,
    cost_section,
    data_section,
    growth_section,
    main_section,
    nearness_section,
    seeds_section,
    verdict_section,
)
from services.launcher.study_table import Measurements, estimates_of
from services.runtime.checkpoint import write_atomically

FIGURES = "figures"
CAPTIONS = {
    "over-steps": "Coverage of the first so many states: thin lines are seeds, strong ones their mean, "
    "dashed ones open-loop noises.",
    "spectra": "Variances of the cloud along its principal axes, by condition; thin lines are seeds.",
    "neighbour-ratios": "What TwoNN fits (eq. 29), of the first seed of each condition. The dashed line is "
    "where the largest 10 % begin.",
}
FURTHEST = (
    "The two states of each condition that lie furthest apart, of the seed that reached furthest. Only "
    "postures can be seen, not velocities; the body is drawn where its episodes begin, since states do not "
    "say where it lies."
)
Drawn = Mapping[str, str]
"""Name of a figure -> its caption."""


def write_study_report(folder: StudyFolder, report: Path) -> Path:
    """Write it all into the folder `report`; returns the path of `report.md`.

    Raises `StudyError` if no run is done, `StorageError`.
    """
    plan, steps, seeds = folder.plan()
    measurements = folder.measurements()
    if not measurements:
        raise StudyError(f"no run of {folder.path} is done yet, so there is nothing to report")
    runs = _run_folders(folder, measurements)
    drawn, troubles = _figures(report / FIGURES, plan, measurements, runs)
    lines = _lines(folder, plan, steps, seeds, measurements, runs, drawn, troubles)
    write_atomically(report / "numbers.json", _numbers(plan, steps, measurements))
    write_atomically(report / "settings.toml", config_text(next(iter(runs.values())).settings()).encode())
    path = report / "report.md"
    write_atomically(path, "\n".join(lines).encode())
    return path


def _lines(
    folder: StudyFolder,
    plan: Plan,
    steps: int,
    seeds: list[int],
    measurements: Measurements,
    runs: Mapping[str, RunFolder],
    drawn: Drawn,
    troubles: list[str],
) -> list[str]:
    estimates = estimates_of(measurements)
    sections = [
        _heading(folder, plan, steps, seeds, measurements),
        verdict_section(plan, estimates),
        main_section(plan, estimates),
        nearness_section(plan, estimates),
        _pictures(drawn, troubles),
        growth_section(plan, measurements),
        seeds_section(plan, measurements, estimates),
        conditions_section(plan),
        _notes(plan),
        cost_section(plan, measurements),
        data_section(measurements),
        _versions(runs),
        _again(plan, steps, seeds),
    ]
    return [line for section in sections for line in section]


def _heading(
    folder: StudyFolder, plan: Plan, steps: int, seeds: list[int], measurements: Measurements
) -> list[str]:
    done = sum(map(len, measurements.values()))
    wanted = len(plan.condition) * len(seeds)
    lines = [
        f"# {plan.title}",
        "",
        f"{len(plan.condition)} conditions, seeds {', '.join(map(str, seeds))}, {steps:,} environment steps "
        f"each: {done} of {wanted} runs are done. The metrics are defined in Babble's docs/coverage.md; all "
        "numbers are in [numbers.json](numbers.json).",
        "",
    ]
    if missing := folder.missing():
        lines += [f"**Missing: {', '.join(missing)}.** What follows is of the others.", ""]
    return lines


def _figures(
    figures: Path, plan: Plan, measurements: Measurements, runs: Mapping[str, RunFolder]
) -> tuple[dict[str, str], list[str]]:
    """Draw all; the captions of those that could be drawn, and why others could not."""
    draw_over_steps(figures / "over-steps.png", plan, measurements)
    draw_spectra(figures / "spectra.png", plan, measurements)
    draw_ratios(figures / "neighbour-ratios.png", plan, measurements)
    drawn = dict(CAPTIONS)
    troubles: list[str] = []
    if _drawn_furthest(figures / "furthest.png", plan, measurements, runs, troubles.append):
        drawn["furthest"] = FURTHEST
    return drawn, troubles


def _drawn_furthest(
    path: Path,
    plan: Plan,
    measurements: Measurements,
    runs: Mapping[str, RunFolder],
    complain: Callable[[str], None],
) -> bool:
    world = next(iter(runs.values())).settings().world
    try:
        from services.launcher.study_poses import draw_furthest

        return draw_furthest(path, plan, measurements, world)
    except (ImportError, ValueError) as error:
        complain(f"The furthest poses could not be pictured ({error}).")
        return False


def _pictures(drawn: Drawn, troubles: list[str]) -> list[str]:
    lines = ["## Figures", ""]
    for name, caption in drawn.items():
        lines += [f"![{caption}]({FIGURES}/{name}.png)", "", f"*{caption}*", ""]
    for trouble in troubles:
        lines += [trouble, ""]
    return lines


def _notes(plan: Plan) -> list[str]:
    if not plan.notes:
        return []
    return [
        "## What is ours, and what the source does not say",
        "",
        *(f"- {note}" for note in plan.notes),
        "",
    ]


def _versions(runs: Mapping[str, RunFolder]) -> list[str]:
    """Of the code and the packages with which the runs were begun."""
    found: dict[str, list[str]] = {}
    for run in runs.values():
        for what, version in _versions_of(run).items():
            found.setdefault(what, [])
            if version not in found[what]:
                found[what].append(version)
    lines = ["## Versions", "", "With which the runs were begun; several where they differ.", ""]
    lines += table_head(["what", "version"])
    return [*lines, *(table_row([what, ", ".join(versions)]) for what, versions in found.items()), ""]


def _versions_of(run: RunFolder) -> dict[str, str]:
    try:
        record: dict[str, Any] = json.loads((run.path / "run.json").read_bytes())
        ours, packages = record["babble"], record["packages"]
        commit = ours.get("commit") or "no git"
        changed = " with changes" if ours.get("dirty") else ""
        told = {"babble": f"{ours['version']} ({commit[:12]}{changed})", "Python": str(record["python"])}
        return told | {"platform": str(record["platform"])} | {str(k): str(v) for k, v in packages.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}


def _again(plan: Plan, steps: int, seeds: list[int]) -> list[str]:
    command = f"babble study scenarios/{plan.study}.toml"
    options = "" if steps == plan.steps else f" --steps {steps}"
    if seeds != plan.seeds:
        options += f" --seeds {','.join(map(str, seeds))}"
    first, last = plan.condition[0].id, plan.condition[-1].id
    return [
        "## Repeat, extend, doubt",
        "",
        f"- `{command}{options}` runs what is missing and writes this report; killed at any point, the same "
        "command goes on",
        f"- `{command} --seeds {max(seeds) + 1}-{max(seeds) + 3}` adds seeds, `--only {first},{last} "
        f"--steps {max(1, steps // 10)}` is a quick look in a folder of its own",
        "- `babble coverage RUN` measures one run anew, as long as its states are there",
        "- [settings.toml](settings.toml) is the first run's whole configuration; the table of conditions "
        "says what the others have otherwise",
        "- runs do not repeat bit for bit: an actor's random numbers come from the seed and from its life, "
        "and what is learned depends on the order in which messages arrive; seeds tell runs apart",
        "",
    ]


def _run_folders(folder: StudyFolder, measurements: Measurements) -> dict[str, RunFolder]:
    names = [
        run_folder_name(condition, seed) for condition, by_seed in measurements.items() for seed in by_seed
    ]
    return {name: RunFolder.find(str(folder.path / name)) for name in names}


def _numbers(plan: Plan, steps: int, measurements: Measurements) -> bytes:
    """Everything that was measured; of the parts of a curve without their spectra."""
    runs = [
        {
            "condition": condition,
            "seed": seed,
            "rows": one.rows,
            "recorded_rows": one.recorded_rows,
            "rows_by_phase": dict(one.rows_by_phase),
            "duplicates": one.duplicates,
            "gaps": one.gaps,
            "trained_secs": one.trained_secs,
            "cpu_secs": one.cpu_secs,
            "coverage": one.coverage.as_dict(),
            "curve": [
                {key: value for key, value in each.as_dict().items() if key != "variances"}
                for each in one.curve
            ],
        }
        for condition, by_seed in measurements.items()
        for seed, one in by_seed.items()
    ]
    table = {"study": plan.study, "steps": steps, "plan": plan.model_dump(mode="json"), "runs": runs}
    return json.dumps(table, indent=1).encode() + b"\n"
