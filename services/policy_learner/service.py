"""The policy learner as a process: one `PolicyWork` per block in the shell of a learner."""

import torch

from babble.bodies import make_body
from babble.parts import part_of_block
from services.policy_learner.config import work_config
from services.policy_learner.work import PolicyWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import SettingsError
from services.runtime.sharing import own_blocks

SERVICE = "policy_learner"


def build(context: Context) -> Learner:
    """The policy learner of this index, for the blocks that are its own, resumed from its checkpoint.

    Raises `SettingsError` for a world, blocks or an index that cannot be, or a reward that there is not.
    """
    torch.set_num_threads(1)
    settings = context.settings
    blocks, wanted = own_blocks(settings, "policy", context.index), settings.world
    try:
        world, tree = make_body(wanted.id, wanted.parameters, settings.block, columns=1, seed=0)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    settings.check_rewarded(world.rewarded)
    configs = [
        work_config(
            settings,
            tree,
            block,
            place,
            run=context.run,
            posture_size=world.posture_size,
            part=part_of_block(world, tree, block),
        )
        for place, block in blocks
    ]
    works = [PolicyWork(config) for config in configs]
    interface = interface_of(
        settings, senses=world.senses, action_size=world.action_size, blocks=tree.specs.values()
    )
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())
