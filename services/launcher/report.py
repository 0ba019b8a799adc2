"""`report.md` and `figures/` of a run folder: what was found, how well, and how to see it again."""

import itertools
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from babble.policy.act import EncoderModel
from babble.scores import REACHED
from babble.worlds import WORLDS
from babble.worlds.batch import PointWorld
from protocol.messages import Phase, Score
from services.launcher.evaluate import (
    Rollout,
    Run,
    RunError,
    Version,
    load_models,
    open_run,
    roll_out,
    shortfalls,
)
from services.runtime.checkpoint import write_atomically
from services.runtime.settings import RunSettings

if TYPE_CHECKING:
    from services.launcher.figures import Curve, Ends

Record = Mapping[str, Any]

PLACES = {
    "Cuboid": "both ends of the long diagonal",
    "Ellipsoid": "both ends of the long axis",
    "Dumbbell": "the outer ends of both lobes",
}
"""What a Composer with two vertices should find (thesis 4.1)."""
CURVES = (
    ("encoder/loss", "encoder loss (ENCODE, REFINE)", "InfoNCE (nats)", {"encode", "refine"}),
    ("policy/reward_mean", "reward (GROUND, PRACTISE)", "mean reward per step", {"ground", "practise"}),
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
        places, pictures = _rolled_out(run, version)
    except RunError as error:
        places, pictures = [f"The saved models could not be rolled out: {error}."], []
    title = f"## What block {block} found" if len(run.blocks) > 1 else "## What was found"
    lines = [title, "", _verdict(run, version, rows), "", *places, "", *_scores(run, version, rows), ""]
    return [*lines, *pictures, *_learning(run, block, rows)]


def _verdict(run: Run, version: Version, rows: Iterable[Score]) -> str:
    row = next(row for row in rows if row.iteration == version.iteration)
    missing = shortfalls(row)
    world, two = run.settings.world.id, run.settings.one_block(version.block).latent_dim == 2
    place = PLACES.get(world, "two far ends of the world") if two else "far ends of the world, one per goal,"
    found = "were found" if not missing else "were not found"
    crossed = "" if row.crossing is None else f", crossing {row.crossing:.2f}"
    measured = f"separation {row.separation:.2f}, z_min {row.z_min:.2f}{crossed}"
    kept = f"The best iteration is {version.iteration} ({measured}, {row.policy} actions)"
    sentence = f"{place[0].upper()}{place[1:]} {found}"
    why = f": {', '.join(missing)}" if missing else ""
    return f"**{sentence}{why}.** {kept}."


def _rolled_out(run: Run, version: Version) -> tuple[list[str], list[str]]:
    """Where each goal ends in fresh worlds, in words, and the figures of it."""
    beside = [run.version(block, version.iteration) for block in run.blocks]
    models = {each.block: load_models(run, each) for each in beside}
    rollout = roll_out(run, beside, models)
    encoder = models[version.block].encoder
    ends = _ends(rollout, version.block, encoder.latent_dim)
    means = [ends.posture[ends.goal == goal].mean(axis=0) for goal in range(ends.latent_dim)]
    places = ["In fresh worlds, from random starts and with mean actions:", ""]
    for goal, mean in enumerate(means):
        mine = ends.posture[ends.goal == goal]
        off = float(np.linalg.norm(mine - mean, axis=1).mean())
        places.append(f"- goal {goal} ends at {_point(mean)}, on average within {off:.2f} of it")
    for one, other in itertools.combinations(range(ends.latent_dim), 2):
        apart = float(np.linalg.norm(means[one] - means[other]))
        share = f"{apart / rollout.diameter:.0%} of the diameter {rollout.diameter:.2f}"
        places.append(f"- the ends of goals {one} and {other} are {apart:.2f} apart: {share}")
    (anew,) = [row for row in rollout.scores() if row.block == version.block]
    places += ["", f"Scores of these rollouts: separation {anew.separation:.3f}, z_min {anew.z_min:.3f}."]
    return places, _pictures(run, version, encoder, ends)


def _ends(rollout: Rollout, block: str, latent_dim: int) -> "Ends":
    from services.launcher.figures import Ends

    legs, path = rollout.legs[block], rollout.path
    steps = rollout.run.settings.evaluation.leg_steps
    ways = np.stack([path[leg * steps : (leg + 1) * steps + 1] for leg in range(1, len(legs.goal))])
    size = path.shape[2]
    return Ends(
        goal=legs.goal[1:].reshape(-1),
        posture=legs.posture[1:].reshape(-1, size),
        way=ways.swapaxes(1, 2).reshape(-1, steps + 1, size),
        first_goal=legs.goal[0],
        first_way=path[: steps + 1].swapaxes(0, 1),
        latent_dim=latent_dim,
    )


def _pictures(run: Run, version: Version, encoder: EncoderModel, ends: "Ends") -> list[str]:
    from services.launcher import figures

    world = run.world(1, [0, 6, 4])
    if not isinstance(world, PointWorld) or ends.latent_dim > figures.MOST_VERTICES:
        what = f"the world {world.id}" if not isinstance(world, PointWorld) else f"{ends.latent_dim} vertices"
        return [f"There is no drawing of {what} yet.", ""]
    block = version.block
    name = f"{run.settings.world.id}, block {block}, iteration {version.iteration}"
    seen = run.tree(world).observed(block)
    points = world.uniform_points(figures.MAP_POINTS, np.random.default_rng(0))
    folder = run.folder / "figures"
    figures.draw_world(folder / f"{block}-world.png", world.body, ends, f"{name}: where goals lead")
    latent = encoder.latent(points[:, seen])
    figures.draw_latent(folder / f"{block}-latent.png", world.body, points, latent, f"{name}: the latent map")
    return [
        *_picture(
            f"{block}-world",
            "The world, the points reached per goal in fresh worlds (mean actions), and some of the ways: "
            "from a random start (dotted), and from one end to the other.",
        ),
        *_picture(
            f"{block}-latent",
            "The latent over the world: points spread uniformly, in two slices through the middle. The "
            "marks are the points of the whole world, not only of the slice, where a component is largest.",
        ),
    ]


def _scores(run: Run, version: Version, rows: Sequence[Score]) -> list[str]:
    crossing = any(row.crossing is not None for row in rows)
    names = ["iteration", "after", "actions", "separation", "worst", "z_min", "z_goal", "switch success"]
    lines = [
        "Scores during the run; success is separation, z_min and, where there are two halves, crossing of "
        f"{REACHED} or more:",
        "",
        *_table_head([*names, *(["crossing"] if crossing else [])]),
    ]
    for row in sorted(rows, key=lambda row: (row.iteration, row.policy)):
        numbers = [row.separation, row.separation_worst, row.z_min, row.z_goal, row.switch_success]
        if crossing:
            numbers.append(row.crossing or 0.0)
        best = " (best)" if row.iteration == run.best.get(version.block) else ""
        cells = [f"{row.iteration}{best}", row.phase.value, row.policy, *(f"{n:.3f}" for n in numbers)]
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
    return _picture(f"{block}-learning", f"Scores by iteration, and {losses}.")


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


def _picture(name: str, caption: str) -> list[str]:
    return [f"![{caption}](figures/{name}.png)", "", f"*{caption}*", ""]


def _point(position: Iterable[float]) -> str:
    return f"({', '.join(f'{value:.2f}' for value in position)})"


def _table_head(names: Sequence[str]) -> list[str]:
    return [_table_row(names), _table_row(["---"] * len(names))]


def _table_row(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"
