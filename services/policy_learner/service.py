"""The policy learner as a process: one `PolicyWork` per block in the shell of a learner."""

import torch

from babble.blocks import BlockTree
from babble.scores import landmarks_of
from babble.worlds import make
from babble.worlds.batch import World
from services.policy_learner.config import work_config
from services.policy_learner.work import PolicyWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import RunSettings, SettingsError

SERVICE = "policy_learner"


def build(context: Context) -> Learner:
    """The policy learner of a run, resumed from its checkpoint if there is one.

    Raises `SettingsError` for a world or blocks that cannot be.
    """
    torch.set_num_threads(1)
    settings = context.settings
    world, tree = _world_and_tree(settings)
    works = [
        PolicyWork(
            work_config(
                settings,
                tree,
                block.name,
                index,
                run=context.run,
                posture_size=world.posture_size,
                diameter=world.diameter,
                crossing_axis=world.crossing_axis,
                landmarks=landmarks_of(world, tree),
            )
        )
        for index, block in enumerate(settings.block)
    ]
    interface = interface_of(settings, senses=world.senses, action_size=world.action_size)
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())


def _world_and_tree(settings: RunSettings) -> tuple[World, BlockTree]:
    try:
        world = make(settings.world.id, settings.world.parameters, columns=1, seed=0)
        return world, BlockTree.of(settings.block, world.observation_size, world.action_size)
    except (ValueError, TypeError) as error:
        raise SettingsError(str(error)) from None
