"""A run folder, read for its scores: which versions each iteration had, and which one each block keeps.

Needed are `run.json`, `config.toml` and, as soon as there are any, `scores.jsonl` and `best.json`.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from pydantic import ValidationError

from babble.blocks import BlockError, BlockTree
from babble.bodies import tree_of
from babble.worlds import World, WorldError, make
from protocol.messages import Phase, Score
from services.launcher.run_folder import RunFolder
from services.runtime.errors import UserError
from services.runtime.settings import RunSettings


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

    @property
    def levels(self) -> dict[int, list[str]]:
        """The blocks that were evaluated, by level, from the lowest up; no level without any."""
        evaluated = self.blocks
        by_level = {
            level: [block for block in evaluated if block in names]
            for level, names in enumerate(self.settings.levels)
        }
        return {level: blocks for level, blocks in by_level.items() if blocks}

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

    def kept_scores(self) -> dict[str, Score]:
        """By block that was evaluated, what was measured of its kept iteration. Raises `RunError`."""
        kept = {block: self.version(block).iteration for block in self.blocks}
        rows = sorted(self.scores, key=lambda row: row.policy, reverse=True)  # of both, mean is the last
        return {row.block: row for row in rows if row.iteration == kept[row.block]}

    def iterations(self) -> list[list[Version]]:
        """The versions that acted at the same time, level by level, each in ascending order.

        An iteration that not all blocks of its level have been evaluated in yet is left out.
        """
        return [versions for level in self.levels for versions in self._iterations(level)]

    def _iterations(self, level: int) -> list[list[Version]]:
        by_block = [self.versions(block) for block in self.settings.levels[level]]
        together = set.intersection(*(set(versions) for versions in by_block))
        return [[versions[number] for versions in by_block] for number in sorted(together)]

    def world(self, columns: int, seed: Sequence[int]) -> World:
        """Fresh copies of the run's world. Raises `RunError`."""
        try:
            return make(self.settings.world.id, self.settings.world.parameters, columns, seed)
        except WorldError as error:
            raise RunError(f"{self.shown}/config.toml: {error}") from None

    @cached_property
    def tree(self) -> BlockTree:
        """The run's blocks on its world. Raises `RunError`."""
        try:
            return tree_of(self.settings.block, self.world(1, [0]))
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
