"""Actors of a tree of blocks, made up: parents set their children's goals, and latents follow from below."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from protocol.messages import View
from services.runtime.levels import levels_of
from services.runtime.settings import BlockSettings, RunSettings
from tests.unit.dashboard_feed import TRAIL_STEPS, settings_of, view_of

Floats = NDArray[np.float32]

FINGERS = ("thumb", "index", "middle", "ring", "little")
HAND: Mapping[str, Sequence[str]] = {"hand": FINGERS}
BODY: Mapping[str, Sequence[str]] = {
    **{f"{side}_hand": [f"{side}_{finger}" for finger in FINGERS] for side in ("left", "right")},
    **{f"{side}_arm": [f"{side}_shoulder", f"{side}_hand"] for side in ("left", "right")},
    "body": ["left_arm", "right_arm", "left_leg", "right_leg", "head", "trunk"],
}
"""21 blocks, of four levels"""
MASTER_STEPS = 25
DECISION_STEPS = 10
STEPS_PER_VIEW = 4


def tree_settings(children: Mapping[str, Sequence[str]], **latent_dims: int) -> RunSettings:
    """Settings of a run with these blocks, the parents last; d = 2 where nothing else is said."""
    names = dict.fromkeys([*(child for each in children.values() for child in each), *children])
    blocks = [
        BlockSettings(name=name, latent_dim=latent_dims.get(name, 2), children=list(children.get(name, [])))
        for name in names
    ]
    depth = len(levels_of(blocks))
    table = settings_of(2).model_dump(exclude_unset=True)
    table |= {
        "block": [block.model_dump() for block in blocks],
        "level": [{"decision_steps": 1}] + [{"decision_steps": DECISION_STEPS}] * (depth - 1),
    }
    return RunSettings.model_validate(table)


class TreeActor:
    """One column; each vertex of a parent stands for goals of its children, and it is near if they are."""

    def __init__(self, settings: RunSettings, index: int = 0, seed: int = 0) -> None:
        self.life = f"actor-{index:08x}"
        self._settings = settings
        self._rng = np.random.default_rng([seed, index])
        self._blocks = {block.name: block for block in settings.block}
        self._codes = {
            block.name: [self._code(block, vertex) for vertex in range(block.latent_dim)]
            for block in settings.block
        }
        self._logits = {block.name: self._rng.normal(size=block.latent_dim) for block in settings.block}
        self._trails: dict[str, list[Floats]] = {name: [] for name in self._blocks}
        self.goals = {block.name: 0 for block in settings.block}
        self._steps = self._seq = 0

    def views(self, level: int) -> Iterator[View]:
        """What it shows while this level acts, some steps later: of all blocks of it and below."""
        for _ in range(STEPS_PER_VIEW):
            self._walk(level)
        for names in self._settings.levels[: level + 1]:
            for name in names:
                latent = self._latent(name)
                goal = np.eye(len(latent), dtype=np.float32)[self.goals[name]]
                trail = np.array(self._trails[name][-TRAIL_STEPS:], np.float32)
                arrays = {"latent": latent[None], "goal": goal[None], "trail": trail}
                self._seq += 1
                yield view_of(self.life, name, arrays, seq=self._seq, env_step=self._steps)

    def _walk(self, level: int) -> None:
        self._steps += 1
        if self._steps % MASTER_STEPS == 1:
            for name in self._settings.levels[level]:
                self.goals[name] = int(self._rng.integers(self._blocks[name].latent_dim))
        if self._steps % DECISION_STEPS == 1:
            for names in reversed(self._settings.levels[1 : level + 1]):
                for name in names:
                    self.goals |= self._codes[name][self.goals[name]]
        for names in self._settings.levels[: level + 1]:
            for name in names:
                self._logits[name] = self._nearer(name)
                self._trails[name].append(self._latent(name))

    def _nearer(self, name: str) -> NDArray[np.float64]:
        block = self._blocks[name]
        if not block.children:
            wished = 5.0 * np.eye(block.latent_dim)[self.goals[name]]
            return (
                self._logits[name]
                + 0.2 * (wished - self._logits[name])
                + 0.2 * self._rng.normal(size=block.latent_dim)
            )
        fits = [
            np.mean([self._latent(child)[goal] for child, goal in code.items()]) for code in self._codes[name]
        ]
        return 6.0 * np.array(fits)

    def _latent(self, name: str) -> Floats:
        grown = np.exp(self._logits[name] - self._logits[name].max())
        return np.asarray(grown / grown.sum(), np.float32)

    def _code(self, block: BlockSettings, vertex: int) -> dict[str, int]:
        flips = self._rng.random(len(block.children)) < 0.2
        return {
            child: (vertex + int(flip)) % self._blocks[child].latent_dim
            for child, flip in zip(block.children, flips, strict=True)
        }
