"""What a run's saved models can do, measured in fresh worlds from random starts; no training data is used.

The blocks of one level act at once. Those of a level above 0 act through the blocks below them, each of
which does what it does in the iteration that is kept of it.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from babble.blocks import BlockTree
from babble.breakdowns import UnstableError
from babble.levels import BlockModels, Stage, stage_of
from babble.limbs import blocks_below
from babble.parts import Part, part_of_block
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from babble.policy.together import Encodes
from babble.scores import Legs, Walk, Walker, score
from babble.worlds import World
from babble.worlds.batch import PointWorld
from protocol.messages import Score
from services.launcher.judging import measures, shortfalls
from services.launcher.scored_run import Run, RunError, Version, open_run
from services.runtime.models import model_path

__all__ = [
    "COLUMNS",
    "MODES",
    "Mode",
    "Rollout",
    "Run",
    "RunError",
    "Version",
    "evaluate",
    "latents_at",
    "load_models",
    "measures",
    "open_run",
    "roll_out",
    "rolled_out",
    "shortfalls",
]

Floats = NDArray[np.float32]
Mode = Literal["mean", "sampled"]
AnyModel = TypeVar("AnyModel", EncoderModel, PolicyModel)
MODES: tuple[Mode, ...] = ("mean", "sampled")
COLUMNS = 64
"""Fresh worlds in one evaluation, unless told otherwise."""


def evaluate(
    run: Run,
    versions: Sequence[Version],
    *,
    seed: int = 0,
    columns: int = COLUMNS,
    modes: Sequence[Mode] = MODES,
) -> list[Score]:
    """Scores of the saved models of one level's blocks, which act at once: a row per mode and block.

    Raises `RunError`.
    """
    rollouts = rolled_out(run, versions, seed=seed, columns=columns, modes=modes)
    return [row for rollout in rollouts for row in rollout.scores()]


def rolled_out(
    run: Run,
    versions: Sequence[Version],
    *,
    seed: int = 0,
    columns: int = COLUMNS,
    modes: Sequence[Mode] = MODES,
) -> Iterator["Rollout"]:
    """The saved models of one level's blocks, rolled out in each mode. Raises `RunError`."""
    models = {version.block: load_models(run, version) for version in versions}
    for mode in modes:
        yield roll_out(run, versions, models, seed=seed, columns=columns, mode=mode)


@dataclass(frozen=True)
class Rollout:
    """Legs of blocks that acted at once, from random starts in fresh worlds."""

    run: Run
    versions: Sequence[Version]
    mode: Mode
    legs: Mapping[str, Legs]
    path: Floats
    """(1 + legs * leg_rows, E, p) every posture, from the start"""
    latent: Mapping[str, Floats]
    """by block, (legs * leg_rows, E, d) what each step was taken at"""
    arrived: Mapping[str, Floats]
    """by block with children, (legs, E, n) its children's latents at the end of each leg"""
    states: NDArray[np.float64] | None
    """(legs, E, s) the bodies as MuJoCo has them after each leg; None for worlds without one. A copy whose
    episode ended with the leg has begun a new one there"""
    leg_rows: int
    """actions in a leg"""
    env_steps_per_row: int
    """for which an action is held"""
    tree: BlockTree
    models: Mapping[str, BlockModels]
    """of all blocks that acted"""
    parts: Mapping[str, Part]
    """by block, what it moves: of those that acted and of their children"""

    def scores(self) -> list[Score]:
        """A row per block; steps are environment steps."""
        return [self._score(version) for version in self.versions]

    def _score(self, version: Version) -> Score:
        legs, part = self.legs[version.block], self.parts[version.block]
        return Score(
            run=self.run.name,
            block=version.block,
            iteration=version.iteration,
            phase=version.phase,
            policy=self.mode,
            steps=legs.goal.size * self.leg_rows * self.env_steps_per_row,
            encoder_version=version.encoder,
            policy_version=version.policy,
            **score(part.cut(legs), part.diameter, part.crossing_axis, part.landmarks),
        )


def roll_out(
    run: Run,
    versions: Sequence[Version],
    models: Mapping[str, BlockModels],
    *,
    seed: int = 0,
    columns: int = COLUMNS,
    mode: Mode = "mean",
) -> Rollout:
    """Roll out any models that fit one level of the run; `versions` name them in the scores.

    The blocks below act as they are kept. Raises `RunError`.
    """
    body, tree = run.world(columns, [seed, 6, 0]), run.tree
    level = tree.level_of(versions[0].block)
    acting = _acting(run, tree, level, models)
    stage = _stage(run, body, tree, level, acting)
    walkers = {block: _walker(stage, tree, block, acting[block]) for block in stage.observed}
    leg_rows = max(1, run.settings.of_level(level).evaluation.leg_steps // stage.env_steps_per_step)
    walk = _walk(run, stage, walkers, np.random.default_rng([seed, 6, 1]), level, leg_rows, mode)
    states, arrived = _walked(run, walk, body, walkers, leg_rows)
    children = [child for block in walkers for child in tree.specs[block].children]
    return Rollout(
        run=run,
        versions=versions,
        mode=mode,
        legs=walk.legs(),
        path=np.stack(walk.path.posture),
        latent={block: np.stack(latents) for block, latents in walk.path.latent.items()},
        arrived=arrived,
        states=states,
        leg_rows=leg_rows,
        env_steps_per_row=stage.env_steps_per_step,
        tree=tree,
        models=acting,
        parts={block: part_of_block(body, tree, block) for block in [*walkers, *children]},
    )


def _acting(
    run: Run, tree: BlockTree, level: int, models: Mapping[str, BlockModels]
) -> dict[str, BlockModels]:
    """The given models of a level's blocks, and the kept ones of all blocks below. Raises `RunError`."""
    at_work = [spec.name for spec in tree.level(level)]
    if missing := [name for name in at_work if name not in models]:
        raise RunError(
            f"{run.shown} has no models of block {missing[0]} to act beside {', '.join(models)}; the "
            f"blocks of level {level} are scored together"
        )
    below = blocks_below(tree, at_work)
    kept = {name: load_models(run, run.version(name)) for name in tree.specs if name in below}
    return {**kept, **models}


def _walker(stage: Stage, tree: BlockTree, block: str, models: BlockModels) -> Walker:
    encoder = _Hearing(models.encoder) if tree.specs[block].children else models.encoder
    return Walker(encoder, models.policy, stage.observed[block], stage.driven[block])


def _stage(run: Run, body: World, tree: BlockTree, level: int, models: Mapping[str, BlockModels]) -> Stage:
    settings = run.settings
    try:
        return stage_of(
            body,
            tree,
            level,
            models,
            decision_steps=settings.decision_steps,
            subgoals={name: settings.of_block(name).policy.subgoals for name in tree.specs},
        )
    except ValueError as error:
        raise RunError(f"{run.shown} cannot be rolled out here: {error}") from None


class _Hearing:
    """The encoder of a block with children, which keeps what it was last asked about."""

    def __init__(self, encoder: Encodes) -> None:
        self.latent_dim = encoder.latent_dim
        self.last = np.zeros((0, 0), np.float32)
        """(E, n)"""
        self._encoder = encoder

    def latent(self, observation: Floats) -> Floats:
        """(E, n) -> (E, d)"""
        self.last = observation
        return self._encoder.latent(observation)


def _walk(
    run: Run,
    stage: Stage,
    walkers: Mapping[str, Walker],
    rng: np.random.Generator,
    level: int,
    leg_rows: int,
    mode: Mode,
) -> Walk:
    legs = run.settings.of_level(level).evaluation.legs
    try:
        # A sense may find only now that it has no renderer.
        return Walk(stage.world, walkers, rng, legs, leg_rows, mode, traced=True)
    except ValueError as error:
        raise RunError(f"{run.shown} cannot be rolled out here: {error}") from None


def _walked(
    run: Run, walk: Walk, body: World, walkers: Mapping[str, Walker], leg_rows: int
) -> tuple[NDArray[np.float64] | None, dict[str, Floats]]:
    """Walks to the end; the states of the bodies, and what blocks with children observe, after each leg."""
    heard = {
        block: walker.encoder for block, walker in walkers.items() if isinstance(walker.encoder, _Hearing)
    }
    states: dict[int, NDArray[np.float64]] = {}
    arrived: dict[str, dict[int, Floats]] = {block: {} for block in heard}
    try:
        while not walk.done:
            walk.advance(1)
            # Not walk.steps: when a simulation breaks down, the walk and its path begin again.
            leg, within = divmod(len(walk.path.posture) - 1, leg_rows)
            if not leg or within:
                continue
            if (state := _states(body)) is not None:
                states[leg] = state
            for block, encoder in heard.items():
                arrived[block][leg] = encoder.last
    except UnstableError as error:
        raise RunError(f"{run.shown} cannot be rolled out: {error}") from None
    in_order = {block: np.stack([ends[leg] for leg in sorted(ends)]) for block, ends in arrived.items()}
    return np.stack([states[leg] for leg in sorted(states)]) if states else None, in_order


def _states(world: World) -> NDArray[np.float64] | None:
    """(E, s) of a simulated body; None for what is none."""
    if isinstance(world, PointWorld):
        return None
    # MuJoCo takes its time, which worlds without a body do not need.
    from services.launcher.bodies import states_of

    return states_of(world)


def latents_at(tree: BlockTree, models: Mapping[str, BlockModels], block: str, observation: Floats) -> Floats:
    """(E, d) of a block where the body observes (E, n): of one with children through theirs (eq. 14)."""
    below = {child: latents_at(tree, models, child, observation) for child in tree.specs[block].children}
    return models[block].encoder.latent(tree.observation_of(block, observation, below))


def load_models(run: Run, version: Version) -> BlockModels:
    """The saved models of one iteration, their sizes checked against the run's world. Raises `RunError`."""
    tree = run.tree
    latent_dim = tree.specs[version.block].latent_dim
    path = model_path(run.folder, version.block, "encoder", version.encoder)
    encoder = _open(path, EncoderModel)
    _same(path, "observation size", encoder.observation_size, tree.observation_size_of(version.block))
    _same(path, "latent dimension", encoder.latent_dim, latent_dim)
    path = model_path(run.folder, version.block, "policy", version.policy)
    policy = _open(path, PolicyModel)
    _same(path, "latent dimension", policy.latent_dim, latent_dim)
    _same(path, "action size", policy.action_size, tree.action_size_of(version.block))
    return BlockModels(encoder, policy)


def _open(path: Path, kind: type[AnyModel]) -> AnyModel:
    try:
        return kind(path.read_bytes())
    except OSError as error:
        raise RunError(f"cannot read the model {path}: {error.strerror}") from None
    except ModelError as error:
        raise RunError(f"{path} cannot be used: {error}; restore it from a copy of the run") from None


def _same(path: Path, what: str, found: int, expected: int) -> None:
    if found != expected:
        raise RunError(
            f"{path} is a model of another run: its {what} is {found}, and this run's world needs {expected}"
        )
