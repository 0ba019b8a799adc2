"""What a run's saved models can do, measured in fresh worlds from random starts; no training data is used.

Only what a run folder holds is needed: `run.json`, `config.toml`, `scores.jsonl` (which versions each
iteration had) and `models/`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from babble.blocks import BlockError, BlockTree
from babble.breakdowns import UnstableError
from babble.landmarks import Landmark
from babble.policy.act import EncoderModel, ModelError, PolicyModel
from babble.scores import REACHED, Legs, Walk, Walker, landmarks_of, score
from babble.worlds import World, WorldError, make
from babble.worlds.batch import PointWorld
from protocol.messages import Phase, Score
from services.launcher.run_folder import RunFolder
from services.runtime.errors import UserError
from services.runtime.models import model_path
from services.runtime.settings import RunSettings

Floats = NDArray[np.float32]
Mode = Literal["mean", "sampled"]
AnyModel = TypeVar("AnyModel", EncoderModel, PolicyModel)
MODES: tuple[Mode, ...] = ("mean", "sampled")
COLUMNS = 64
"""Fresh worlds in one evaluation, unless told otherwise."""


class RunError(UserError):
    """A run folder that cannot be scored; the text is one sentence for a person."""


@dataclass(frozen=True, kw_only=True)
class Version:
    """The models of one block after one iteration."""

    block: str
    iteration: int
    phase: Phase
    encoder: int
    policy: int


@dataclass(frozen=True)
class Models:
    """An encoder and a policy trained on it."""

    encoder: EncoderModel
    policy: PolicyModel


@dataclass(frozen=True, kw_only=True)
class Run:
    """A run folder as `babble up` left it, or as far as it got."""

    folder: Path
    shown: str
    """The folder as a person here would type it."""
    name: str
    settings: RunSettings
    scores: tuple[Score, ...]
    """What was measured during the run, in its order."""
    best: Mapping[str, int]
    """The iteration that each block keeps; empty before the first evaluation."""

    @property
    def blocks(self) -> list[str]:
        """The blocks that were evaluated, in the order of the settings."""
        evaluated = {row.block for row in self.scores}
        return [block.name for block in self.settings.block if block.name in evaluated]

    def versions(self, block: str) -> dict[int, Version]:
        """The evaluated iterations of a block, in ascending order."""
        return {
            row.iteration: Version(
                block=block,
                iteration=row.iteration,
                phase=row.phase,
                encoder=row.encoder_version,
                policy=row.policy_version,
            )
            for row in sorted(self.scores, key=lambda row: row.iteration)
            if row.block == block
        }

    def version(self, block: str, iteration: int | None = None) -> Version:
        """One iteration of a block: the kept one, or else the newest, if none is named. Raises `RunError`."""
        known = self.versions(block)
        if not known:
            raise RunError(
                f"{self.shown} has no evaluated models of block {block} yet; let the run reach its first "
                f"evaluation (`babble up --resume {self.shown}`)"
            )
        wanted = self.best.get(block, max(known)) if iteration is None else iteration
        if wanted not in known:
            there = ", ".join(map(str, known))
            raise RunError(f"{self.shown} has no iteration {wanted} of block {block}; it has {there}")
        return known[wanted]

    def iterations(self) -> list[list[Version]]:
        """The versions of each iteration, which acted at the same time, in ascending order."""
        by_block = [self.versions(block) for block in self.blocks]
        numbers = sorted({number for versions in by_block for number in versions})
        return [[versions[number] for versions in by_block if number in versions] for number in numbers]

    def world(self, columns: int, seed: Sequence[int]) -> World:
        """Fresh copies of the run's world. Raises `RunError`."""
        try:
            return make(self.settings.world.id, self.settings.world.parameters, columns, seed)
        except WorldError as error:
            raise RunError(f"{self.shown}/config.toml: {error}") from None

    def tree(self, world: World) -> BlockTree:
        """The run's blocks on that world. Raises `RunError`."""
        try:
            return BlockTree.of(self.settings.block, world.observation_size, world.action_size)
        except BlockError as error:
            raise RunError(f"{self.shown}/config.toml: {error}") from None


def open_run(where: str | Path) -> Run:
    """The run in a folder, or of that name under runs/.

    Raises `RunFolderError`, `SettingsError` or `RunError`.
    """
    found = RunFolder.find(str(where))
    return Run(
        folder=found.path,
        shown=found.shown,
        name=found.run,
        settings=found.settings(),
        scores=_read_scores(found.path),
        best=read_best(found.path),
    )


def evaluate(
    run: Run,
    versions: Sequence[Version],
    *,
    seed: int = 0,
    columns: int = COLUMNS,
    modes: Sequence[Mode] = MODES,
) -> list[Score]:
    """Scores of the saved models of level-0 blocks that act at once, a row per mode and block.

    Raises `RunError`.
    """
    models = {version.block: load_models(run, version) for version in versions}
    return [
        row
        for mode in modes
        for row in roll_out(run, versions, models, seed=seed, columns=columns, mode=mode).scores()
    ]


@dataclass(frozen=True)
class Rollout:
    """Legs of blocks that acted at once, from random starts in fresh worlds."""

    run: Run
    versions: Sequence[Version]
    mode: Mode
    legs: Mapping[str, Legs]
    path: Floats
    """(1 + legs * leg_steps, E, p) every posture, from the start"""
    latent: Mapping[str, Floats]
    """by block, (legs * leg_steps, E, d) what each step was taken at"""
    states: NDArray[np.float64] | None
    """(legs, E, s) the bodies as MuJoCo has them after each leg; None for worlds without one. A copy whose
    episode ended with the leg has begun a new one there"""
    diameter: float
    crossing_axis: int | None
    landmarks: tuple[Landmark, ...]

    def scores(self) -> list[Score]:
        """A row per block."""
        return [
            Score(
                run=self.run.name,
                block=version.block,
                iteration=version.iteration,
                phase=version.phase,
                policy=self.mode,
                steps=self.legs[version.block].goal.size * self.run.settings.evaluation.leg_steps,
                encoder_version=version.encoder,
                policy_version=version.policy,
                **score(self.legs[version.block], self.diameter, self.crossing_axis, self.landmarks),
            )
            for version in self.versions
        ]


def roll_out(
    run: Run,
    versions: Sequence[Version],
    models: Mapping[str, Models],
    *,
    seed: int = 0,
    columns: int = COLUMNS,
    mode: Mode = "mean",
) -> Rollout:
    """Roll out any models that fit the run; `versions` name them in the scores. Raises `RunError`."""
    world = run.world(columns, [seed, 6, 0])
    tree = run.tree(world)
    if missing := [spec.name for spec in tree.level(0) if spec.name not in models]:
        raise RunError(
            f"{run.shown} has no models of block {missing[0]} to act beside {', '.join(models)}; the "
            "blocks of level 0 are scored together"
        )
    walkers = {
        name: Walker(held.encoder, held.policy, tree.observed(name), tree.driven(name))
        for name, held in models.items()
    }
    walk, states = _walked(run, world, walkers, np.random.default_rng([seed, 6, 1]), mode)
    return Rollout(
        run=run,
        versions=versions,
        mode=mode,
        legs=walk.legs(),
        path=np.stack(walk.path.posture),
        latent={block: np.stack(latents) for block, latents in walk.path.latent.items()},
        states=states,
        diameter=world.diameter,
        crossing_axis=world.crossing_axis,
        landmarks=landmarks_of(world, tree),
    )


def _walked(
    run: Run, world: World, walkers: Mapping[str, Walker], rng: np.random.Generator, mode: Mode
) -> tuple[Walk, NDArray[np.float64] | None]:
    """A whole walk, and the states of the bodies after each leg."""
    plan = run.settings.evaluation
    try:
        # A sense may find only now that it has no renderer.
        walk = Walk(world, walkers, rng, plan.legs, plan.leg_steps, mode, traced=True)
    except ValueError as error:
        raise RunError(f"{run.shown} cannot be rolled out here: {error}") from None
    states: dict[int, NDArray[np.float64]] = {}
    try:
        while not walk.done:
            walk.advance(1)
            # Not walk.steps: when a simulation breaks down, the walk and its path begin again.
            leg, within = divmod(len(walk.path.posture) - 1, plan.leg_steps)
            if leg and not within and (state := _states(world)) is not None:
                states[leg] = state
    except UnstableError as error:
        raise RunError(f"{run.shown} cannot be rolled out: {error}") from None
    return walk, np.stack([states[leg] for leg in sorted(states)]) if states else None


def _states(world: World) -> NDArray[np.float64] | None:
    """(E, s) of a simulated body; None for what is none."""
    if isinstance(world, PointWorld):
        return None
    # MuJoCo takes its time, which worlds without a body do not need.
    from services.launcher.bodies import states_of

    return states_of(world)


def load_models(run: Run, version: Version) -> Models:
    """The saved models of one iteration, their sizes checked against the run's world. Raises `RunError`."""
    tree = run.tree(run.world(1, [0]))
    if tree.specs[version.block].children:
        raise RunError(f"block {version.block} has children, and blocks above level 0 are not scored yet")
    latent_dim = tree.specs[version.block].latent_dim
    path = model_path(run.folder, version.block, "encoder", version.encoder)
    encoder = _open(path, EncoderModel)
    _same(path, "observation size", encoder.observation_size, tree.observation_size_of(version.block))
    _same(path, "latent dimension", encoder.latent_dim, latent_dim)
    path = model_path(run.folder, version.block, "policy", version.policy)
    policy = _open(path, PolicyModel)
    _same(path, "latent dimension", policy.latent_dim, latent_dim)
    _same(path, "action size", policy.action_size, tree.action_size_of(version.block))
    return Models(encoder, policy)


def measures(row: Score) -> dict[str, float]:
    """What success is asked of.

    Where the body has landmarks, z_min and each landmark; elsewhere separation, z_min and, where there
    are two halves, crossing. services/coordinator/best.py decides by the same.
    """
    if row.landmarks:
        return {"z_min": row.z_min, **row.landmarks}
    crossing = {} if row.crossing is None else {"crossing": row.crossing}
    return {"separation": row.separation, "z_min": row.z_min, **crossing}


def score_columns(rows: Sequence[Score]) -> dict[str, list[float | None]]:
    """Measure -> its value in each row; a measure that no row has is left out."""
    fields = ("separation", "separation_worst", "z_min", "z_goal", "switch_success", "crossing")
    landmarks = list(dict.fromkeys(name for row in rows for name in row.landmarks))
    columns = {name: [getattr(row, name) for row in rows] for name in fields}
    columns |= {name: [row.landmarks.get(name) for row in rows] for name in landmarks}
    columns["external_reward"] = [row.external_reward for row in rows]
    return {name: values for name, values in columns.items() if any(value is not None for value in values)}


def shortfalls(row: Score) -> list[str]:
    """What keeps a row from counting as success, for a person: "z_min 0.83 < 0.9"; empty when it is one."""
    return [
        f"{name} {_below_bar(value)} < {REACHED}" for name, value in measures(row).items() if value < REACHED
    ]


def _below_bar(value: float) -> str:
    """The value with as many digits as it takes to see that it is below the bar."""
    texts = (f"{value:.{digits}f}" for digits in (2, 3, 4, 6))
    return next((text for text in texts if float(text) < REACHED), repr(value))


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


def _read_scores(folder: Path) -> tuple[Score, ...]:
    """The rows of `scores.jsonl`; a last line without its end is still being written."""
    path = folder / "scores.jsonl"
    lines = path.read_bytes().split(b"\n")[:-1] if path.is_file() else []
    rows = []
    for number, line in enumerate(lines, start=1):
        try:
            rows.append(Score.model_validate_json(line))
        except ValidationError:
            raise RunError(f"{path}: line {number} is not a score; restore the file from a copy") from None
    return tuple(rows)


def read_best(folder: Path) -> dict[str, int]:
    """Block -> the iteration that is kept; empty before the first. Raises `RunError`."""
    path = folder / "best.json"
    if not path.is_file():
        return {}
    try:
        table = json.loads(path.read_bytes())
        return {str(block): int(row["iteration"]) for block, row in table.items()}
    except (ValueError, TypeError, KeyError, AttributeError):
        raise RunError(f"{path} is damaged; `babble up --resume {folder}` writes it anew") from None
