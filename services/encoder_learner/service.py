"""The encoder learner as a process: one `EncoderWork` per block in the shell of a learner."""

import torch

from babble.blocks import BlockTree
from babble.worlds import make
from services.encoder_learner.config import work_config
from services.encoder_learner.work import EncoderWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context

SERVICE = "encoder_learner"


def build(context: Context) -> Learner:
    """The encoder learner of a run, resumed from its checkpoint if there is one."""
    torch.set_num_threads(1)
    settings = context.settings
    world = make(settings.world.id, settings.world.parameters, columns=1, seed=0)
    tree = BlockTree.of(settings.block, world.observation_size, world.action_size)
    works = [
        EncoderWork(work_config(settings, tree, block.name, index))
        for index, block in enumerate(settings.block)
    ]
    interface = interface_of(settings, observation_size=world.observation_size, action_size=world.action_size)
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())
