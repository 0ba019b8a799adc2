"""The policy learner as a process: one `PolicyWork` per block in the shell of a learner."""

import torch

from babble.blocks import BlockTree
from babble.worlds import make
from services.policy_learner.config import work_config
from services.policy_learner.work import PolicyWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context

SERVICE = "policy_learner"


def build(context: Context) -> Learner:
    """The policy learner of a run, resumed from its checkpoint if there is one."""
    torch.set_num_threads(1)
    settings = context.settings
    world = make(settings.world.id, settings.world.parameters, columns=1, seed=0)
    tree = BlockTree.of(settings.block, world.observation_size, world.action_size)
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
            )
        )
        for index, block in enumerate(settings.block)
    ]
    interface = interface_of(settings, observation_size=world.observation_size, action_size=world.action_size)
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())
