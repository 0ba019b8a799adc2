"""The encoder learner as a process: one `EncoderWork` per block in the shell of a learner."""

import torch

from babble.blocks import BlockTree
from babble.worlds import make
from babble.worlds.batch import World
from services.encoder_learner.config import check_memory, work_config
from services.encoder_learner.work import EncoderWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import RunSettings, SettingsError

SERVICE = "encoder_learner"


def build(context: Context) -> Learner:
    """The encoder learner of a run, resumed from its checkpoint if there is one.

    Raises `SettingsError` for a world or blocks that cannot be, or experience that memory cannot hold.
    """
    torch.set_num_threads(1)
    settings = context.settings
    world, tree = _world_and_tree(settings)
    configs = [
        work_config(settings, tree, world.senses, block.name, index)
        for index, block in enumerate(settings.block)
    ]
    check_memory(configs)
    works = [EncoderWork(config) for config in configs]
    interface = interface_of(settings, senses=world.senses, action_size=world.action_size)
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())


def _world_and_tree(settings: RunSettings) -> tuple[World, BlockTree]:
    try:
        world = make(settings.world.id, settings.world.parameters, columns=1, seed=0)
        return world, BlockTree.of(settings.block, world.observation_size, world.action_size)
    except (ValueError, TypeError) as error:
        raise SettingsError(str(error)) from None
