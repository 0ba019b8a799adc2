"""What the recorder takes from the run's settings."""

from dataclasses import dataclass

from babble.blocks import BlockTree
from babble.policy.goals import RewardForm
from babble.worlds.batch import World
from services.runtime.settings import RunSettings


@dataclass(frozen=True, kw_only=True)
class BlockColumns:
    """The columns of one block."""

    name: str
    latent_dim: int
    reward: RewardForm
    """of its level"""
    sparse_radius: float


@dataclass(frozen=True, kw_only=True)
class RecorderConfig:
    """What is recorded of a run, and how."""

    run: str
    scenario: str
    seed: int
    every_steps: int
    """a row for every n-th environment step"""
    group_rows: int
    """so many rows, and at most one segment's more, are held before they become files"""
    state_names: tuple[str, ...]
    rewarded: bool
    """the world has a task, and so a reward of its own"""
    blocks: tuple[BlockColumns, ...]
    acting: tuple[str, ...]
    """the blocks of level 0, which an open loop is about"""
    wanted_steps: int | None
    """environment steps of an open loop, of all columns together; None in a run that learns"""
    segment_steps: int
    """environment steps per column of one whole segment"""


def recorder_config(settings: RunSettings, run: str, tree: BlockTree, world: World) -> RecorderConfig:
    """The configuration of a run that records. Raises `SettingsError` for a tree that is none."""
    goals = {block.name: settings.of_block(block.name).goals for block in settings.block}
    return RecorderConfig(
        run=run,
        scenario=settings.scenario,
        seed=settings.seed,
        every_steps=settings.recording.every_steps,
        group_rows=settings.recording.group_rows,
        state_names=world.state_names,
        rewarded=world.rewarded,
        blocks=tuple(
            BlockColumns(
                name=spec.name,
                latent_dim=spec.latent_dim,
                reward=goals[spec.name].reward,
                sparse_radius=goals[spec.name].sparse_radius,
            )
            for spec in tree.specs.values()
        ),
        acting=settings.levels[0],
        wanted_steps=settings.of_level(0).phases.babble_steps if settings.phases.open_loop else None,
        segment_steps=settings.actors.segment_steps * settings.recording.every_steps,
    )
