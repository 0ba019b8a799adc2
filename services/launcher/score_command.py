"""`babble score RUN`: what the saved models of a run can do, recomputed in fresh worlds."""

import argparse
import sys
from collections.abc import Iterable, Sequence

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from babble.noise import Noise, make_noise
from babble.scores import REACHED
from babble.worlds import World
from protocol.messages import Phase, Score
from services.launcher.evaluate import (
    COLUMNS,
    MODES,
    Models,
    Run,
    RunError,
    Version,
    evaluate,
    measures,
    open_run,
    roll_out,
    score_columns,
    shortfalls,
)
from services.runtime.settings import RunSettings

LEARNER_PACKAGES = frozenset({"torch", "stable_baselines3", "onnx"})
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
    parser.add_argument("--json", action="store_true", help="one JSON object per row")
    parser.add_argument("--seed", type=_count, default=0, metavar="S", help="of the fresh worlds (default 0)")
    parser.add_argument(
        "--columns", type=_positive, default=COLUMNS, help=f"fresh worlds (default {COLUMNS})"
    )


def run(arguments: argparse.Namespace) -> int:
    """Score a run; returns the exit code: 0, or 1 if the control passed. Raises `UserError`s."""
    opened = open_run(arguments.run)
    return _control(opened, arguments) if arguments.control else _score(opened, arguments)


def _score(opened: Run, arguments: argparse.Namespace) -> int:
    blocks = opened.blocks or [opened.settings.block[0].name]
    chosen = {block: opened.version(block, arguments.iteration) for block in blocks}
    only = arguments.best or arguments.iteration is not None
    together = [list(chosen.values())] if only else opened.iterations()
    rows = [
        row
        for versions in together
        for row in evaluate(opened, versions, seed=arguments.seed, columns=arguments.columns)
    ]
    if arguments.json:
        _print_json(rows)
        return 0
    console = _console()
    _say(console, _heading(opened, arguments, "saved models"))
    for block in chosen:
        mine = [row for row in rows if row.block == block]
        console.print(_table(mine, opened.best.get(block), "" if len(chosen) == 1 else f"block {block}"))
    for version in chosen.values():
        _say(console, _verdict(opened, version, rows))
    _say(console, " ".join([LEGEND, *_further_legends(rows)]))
    return 0


def _control(opened: Run, arguments: argparse.Namespace) -> int:
    control = Version(
        block=opened.settings.block[0].name, iteration=0, phase=Phase.GROUND, encoder=0, policy=0
    )
    models = {control.block: _train_control(opened, control.block, arguments.seed)}
    rolled = [
        roll_out(opened, [control], models, seed=arguments.seed, columns=arguments.columns, mode=mode)
        for mode in MODES
    ]
    rows = [row for rollout in rolled for row in rollout.scores()]
    console = _console(stderr=arguments.json)
    if arguments.json:
        _print_json(rows)
    else:
        _say(console, _heading(opened, arguments, "an untrained encoder and a policy trained on it"))
        console.print(_table(rows, None, ""))
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


def _train_control(opened: Run, block: str, seed: int) -> Models:
    """A policy trained on an untrained encoder with the run's own settings and budget. Raises `RunError`."""
    try:
        from babble.control import train_on_untrained_encoder
    except ModuleNotFoundError as error:
        if error.name not in LEARNER_PACKAGES:
            raise
        raise RunError(
            f"the control trains a policy and needs {error.name}, which is not installed here; "
            "install it with `make setup`, or `.venv/bin/uv sync --locked --inexact --extra learner`"
        ) from None
    settings, phases = opened.settings, opened.settings.phases
    world = opened.world(settings.policy.rollout_columns, [seed, 6, 2])
    _check_whole_body(opened, world)
    ppo = settings.policy.model_dump(exclude={"rollout_columns", "max_policy_lag"})
    try:
        # The body may break down, and a sense may find only now that it has no renderer.
        encoder, policy = train_on_untrained_encoder(
            world,
            settings.one_block(block).latent_dim,
            noise=_babbling(settings, world, seed),
            walk_steps=phases.babble_steps,
            train_steps=phases.ground_steps + phases.iterations * phases.practise_steps,
            goal_period_steps=settings.goals.period_steps,
            encoder_hidden=tuple(settings.encoder.hidden),
            vision_features=settings.encoder.vision_features,
            seed=seed,
            steps=settings.actors.segment_steps,
            reward_form=settings.goals.reward,
            **settings.goals.model_dump(include={"sparse_radius", "goal_weight", "external_weight"}),
            **ppo,
        )
    except ValueError as error:
        raise RunError(f"the control of {opened.shown} cannot be trained here: {error}") from None
    return Models(encoder, policy)


def _babbling(settings: RunSettings, world: World, seed: int) -> Noise:
    return make_noise(
        settings.babbling.kind,
        scale=settings.babbling.scale,
        columns=world.columns,
        size=world.action_size,
        rng=np.random.default_rng([seed, 6, 3]),
        correlation=settings.babbling.correlation,
        hold_steps=settings.babbling.hold_steps,
    )


def _check_whole_body(opened: Run, world: World) -> None:
    tree = opened.tree(world)
    (spec, *others) = tree.specs.values()
    senses = np.array_equal(tree.observed(spec.name), np.arange(world.observation_size))
    moves = np.array_equal(tree.driven(spec.name), np.arange(world.action_size))
    if others or not senses or not moves:
        raise RunError(
            f"{opened.shown}: the control is for runs of one block that senses and moves the whole body; "
            f"this one has {', '.join(tree.specs)}"
        )


def _print_json(rows: Iterable[Score]) -> None:
    for row in rows:
        print(row.model_dump_json())


def _console(stderr: bool = False) -> Console:
    return Console(stderr=stderr, highlight=False)


def _say(console: Console, text: str) -> None:
    """Text as it is: no markup, and no line breaks of ours where no terminal needs them."""
    console.print(text, markup=False, soft_wrap=not console.is_terminal)


def _heading(opened: Run, arguments: argparse.Namespace, what: str) -> str:
    world, legs = opened.settings.world.id, opened.settings.evaluation
    return (
        f"run {opened.name} ({world}): {what}, rolled out in {arguments.columns} fresh worlds from random "
        f"starts, {legs.legs} legs of {legs.leg_steps} steps, seed {arguments.seed}"
    )


def _table(rows: Sequence[Score], best: int | None, title: str) -> Table:
    table = Table(
        title=title or None,
        box=box.SIMPLE_HEAD if sys.stdout.isatty() else None,
        padding=(0, 1, 0, 0),
        show_edge=False,
        pad_edge=False,
    )
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


def _further_legends(rows: Sequence[Score]) -> list[str]:
    names = ", ".join(dict.fromkeys(name for row in rows for name in row.landmarks))
    rewarded = any(row.external_reward is not None for row in rows)
    return [
        *([LANDMARKS_LEGEND.format(names=names)] if names else []),
        *([REWARD_LEGEND] if rewarded else []),
    ]


def _verdict(opened: Run, version: Version, rows: Iterable[Score]) -> str:
    key = (version.block, version.iteration, "mean")
    row = next(row for row in rows if (row.block, row.iteration, row.policy) == key)
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
