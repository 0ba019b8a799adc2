"""`babble score RUN`: what the saved models of a run can do, recomputed in fresh worlds."""

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from rich import box
from rich.console import Console
from rich.table import Table

from babble.scores import REACHED
from protocol.messages import Score
from services.launcher.child_ends import ChildEnds, child_ends, table_of
from services.launcher.evaluate import COLUMNS, rolled_out
from services.launcher.judging import measures, score_columns, shortfalls, tree_words
from services.launcher.score_control import control_rows
from services.launcher.scored_run import Run, RunError, Version, open_run

HEADS = {
    "separation": "sep",
    "separation_worst": "worst",
    "switch_success": "switch",
    "crossing": "cross",
    "external_reward": "reward",
}
LEGEND = (
    "sep: mean distance between consecutive ends / diameter; worst: the least one; z_min: mean of the "
    "goal's latent component at the ends, worst goal; z_goal: over all goals; switch: share of legs with "
    f"z_goal >= {REACHED}; cross: share of goal switches that changed sides; mean, sampled: the policy's "
    "actions."
)
LANDMARKS_LEGEND = "{names}: share of legs to the vertex that stands for it which ended at that posture."
REWARD_LEGEND = "reward: the task's own, per step in the second half of the legs."
POSTURES_LEGEND = (
    "Where a child ends: its vertex, the mean of that component of its latent, and the landmark where most "
    "legs end, with their share."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble score`."""
    parser.add_argument("run", metavar="RUN", help="a run folder, or the name of one under runs/")
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--iteration", type=_count, metavar="I", help="this iteration only")
    which.add_argument("--best", action="store_true", help="the best iteration only")
    which.add_argument("--all", action="store_true", help="all iterations (default)")
    which.add_argument(
        "--control",
        action="store_true",
        help="train a policy on an untrained encoder instead and score that; code 1 if it passes",
    )
    parser.add_argument(
        "--json",
        action="store_true",
        help='one JSON object per row; of blocks with children also one, with the key "goals", per iteration',
    )
    parser.add_argument("--seed", type=_count, default=0, metavar="S", help="of the fresh worlds (default 0)")
    parser.add_argument(
        "--columns", type=_positive, default=COLUMNS, help=f"fresh worlds (default {COLUMNS})"
    )


def run(arguments: argparse.Namespace) -> int:
    """Score a run; returns the exit code: 0, or 1 if the control passed. Raises `UserError`s."""
    opened = open_run(arguments.run)
    if opened.settings.phases.open_loop:
        raise RunError(
            f"nothing was learned in {opened.shown} (open loop), so there is nothing to score; "
            f"see what it explored with `babble coverage {opened.shown}`"
        )
    return _control(opened, arguments) if arguments.control else _score(opened, arguments)


@dataclass
class _Found:
    """What rollouts of the saved models found."""

    rows: list[Score] = field(default_factory=list)
    postures: list[ChildEnds] = field(default_factory=list)
    """of blocks with children, where their children ended; by mean actions"""

    def row(self, version: Version) -> Score:
        """By mean actions."""
        key = (version.block, version.iteration, "mean")
        return next(row for row in self.rows if (row.block, row.iteration, row.policy) == key)


def _score(opened: Run, arguments: argparse.Namespace) -> int:
    chosen = _chosen(opened, arguments.iteration)
    only = arguments.best or arguments.iteration is not None
    together = _by_level(opened, chosen) if only else opened.iterations()
    found = _Found()
    for versions in together:
        for rollout in rolled_out(opened, versions, seed=arguments.seed, columns=arguments.columns):
            found.rows += rollout.scores()
            if rollout.mode == "mean":
                found.postures += [ends for each in versions if (ends := child_ends(rollout, each))]
    if arguments.json:
        _print_json(found.rows)
        for ends in found.postures:
            print(json.dumps(ends.json()))
        return 0
    scored = [version for version in chosen if version.block in {row.block for row in found.rows}]
    _show(opened, arguments, scored, found)
    return 0


def _chosen(opened: Run, iteration: int | None) -> list[Version]:
    """One iteration of each block, level by level; of a named one, those that have it. Raises `RunError`."""
    blocks = [block for names in opened.levels.values() for block in names]
    blocks = blocks or [opened.settings.block[0].name]
    if iteration is not None:
        blocks = [block for block in blocks if iteration in opened.versions(block)] or blocks[:1]
    return [opened.version(block, iteration) for block in blocks]


def _by_level(opened: Run, chosen: Sequence[Version]) -> list[list[Version]]:
    """Those that act at once."""
    levels = [[each for each in chosen if each.block in blocks] for blocks in opened.levels.values()]
    return [versions for versions in levels if versions]


def _show(opened: Run, arguments: argparse.Namespace, scored: Sequence[Version], found: _Found) -> None:
    """Tables, verdicts and legends, grouped by level where there is a tree of blocks."""
    console, is_tree = _console(), len(opened.settings.block) > 1
    _say(console, _heading(opened, arguments, "saved models"))
    for version in scored:
        block, rows = version.block, [row for row in found.rows if row.block == version.block]
        if is_tree:
            _say(console, f"level {opened.settings.level_of(block)}, block {block}")
        console.print(_table(rows, opened.best.get(block)))
    for version in scored:
        _say(console, _verdict(opened, version, found.row(version)))
    for ends in found.postures:
        _show_postures(console, ends, whole=ends.version in scored)
    if is_tree:
        names = [block.name for block in opened.settings.block]
        _say(console, tree_words(names, {version.block: found.row(version) for version in scored}))
    _say(console, " ".join([LEGEND, *_further_legends(found)]))


def _show_postures(console: Console, ends: ChildEnds, *, whole: bool) -> None:
    """Which postures a block's goals are: all of it, or only how far they differ."""
    what = f"block {ends.version.block}, iteration {ends.version.iteration}, mean actions"
    if whole:
        _say(console, f"{what}: where its children end, by goal")
        cells = table_of(ends)
        widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
        for row in cells:
            padded = (cell.ljust(width) for cell, width in zip(row, widths, strict=True))
            _say(console, "  ".join(padded).rstrip())
    _say(console, f"{what}: {'; '.join(ends.words())}")


def _control(opened: Run, arguments: argparse.Namespace) -> int:
    rows = control_rows(opened, seed=arguments.seed, columns=arguments.columns)
    console = _console(stderr=arguments.json)
    if arguments.json:
        _print_json(rows)
    else:
        _say(console, _heading(opened, arguments, "an untrained encoder and a policy trained on it"))
        console.print(_table(rows, None))
    mean = rows[0]
    if missing := shortfalls(mean):
        _say(console, f"the control fails, as it must: {', '.join(missing)}")
        return 0
    passed = ", ".join(f"{name} {value:.2f}" for name, value in measures(mean).items())
    _say(
        console,
        f"the control passes ({passed}), so with this seed such scores prove nothing in this world",
    )
    return 1


def _print_json(rows: Iterable[Score]) -> None:
    for row in rows:
        print(row.model_dump_json())


def _console(stderr: bool = False) -> Console:
    return Console(stderr=stderr, highlight=False)


def _say(console: Console, text: str) -> None:
    """Text as it is: no markup, and no line breaks of ours where no terminal needs them."""
    console.print(text, markup=False, soft_wrap=not console.is_terminal)


def _heading(opened: Run, arguments: argparse.Namespace, what: str) -> str:
    world = opened.settings.world.id
    by_level = [opened.settings.of_level(level).evaluation for level in opened.levels or [0]]
    legs = [f"{told.legs} legs of {told.leg_steps} steps" for told in by_level]
    named = [f"{words} on level {level}" for words, level in zip(legs, opened.levels, strict=False)]
    return (
        f"run {opened.name} ({world}): {what}, rolled out in {arguments.columns} fresh worlds from random "
        f"starts, {', '.join(named) if len(set(legs)) > 1 else legs[0]}, seed {arguments.seed}"
    )


def _table(rows: Sequence[Score], best: int | None) -> Table:
    table = _plain_table()
    columns = score_columns(rows)
    for name in ("iter", "policy", *(HEADS.get(name, name) for name in columns), ""):
        table.add_column(name, justify="left" if name in ("policy", "") else "right", no_wrap=True)
    for index, row in enumerate(rows):
        is_best = row.iteration == best
        table.add_row(
            str(row.iteration) if row.policy_version else "-",
            row.policy,
            *("-" if values[index] is None else f"{values[index]:.3f}" for values in columns.values()),
            "best" if is_best else "",
            style="bold" if is_best else None,
        )
    return table


def _plain_table() -> Table:
    return Table(
        box=box.SIMPLE_HEAD if sys.stdout.isatty() else None,
        padding=(0, 1, 0, 0),
        show_edge=False,
        pad_edge=False,
    )


def _further_legends(found: _Found) -> list[str]:
    names = ", ".join(dict.fromkeys(name for row in found.rows for name in row.landmarks))
    rewarded = any(row.external_reward is not None for row in found.rows)
    return [
        *([LANDMARKS_LEGEND.format(names=names)] if names else []),
        *([REWARD_LEGEND] if rewarded else []),
        *([POSTURES_LEGEND] if found.postures else []),
    ]


def _verdict(opened: Run, version: Version, row: Score) -> str:
    missing = shortfalls(row)
    bars = ", ".join(measures(row))
    found = f"not reached: {', '.join(missing)}" if missing else f"reached: {bars} >= {REACHED}"
    best = "best " if opened.best.get(version.block) == version.iteration else ""
    places = "".join(f"; {name} is goal {goal}" for name, goal in row.landmark_vertices.items())
    return f"block {version.block}, {best}iteration {version.iteration}, mean actions: {found}{places}"


def _count(text: str) -> int:
    number = int(text)
    if number < 0:
        raise argparse.ArgumentTypeError(f"must be 0 or more, got {text}")
    return number


def _positive(text: str) -> int:
    if (number := _count(text)) < 1:
        raise argparse.ArgumentTypeError(f"must be 1 or more, got {text}")
    return number
