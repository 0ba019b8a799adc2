"""The encoder learner as a process: one `EncoderWork` per block in the shell of a learner."""

import torch

from babble.bodies import make_body
from services.encoder_learner.config import check_memory, check_models, work_config
from services.encoder_learner.work import EncoderWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import SettingsError
from services.runtime.sharing import own_blocks

SERVICE = "encoder_learner"


def build(context: Context) -> Learner:
    """The encoder learner of this index, for the blocks that are its own, resumed from its checkpoint.

    Raises `SettingsError` for a world, blocks or an index that cannot be, experience that memory cannot hold,
    or an encoder that no frame can.
    """
    torch.set_num_threads(1)
    settings = context.settings
    blocks, wanted = own_blocks(settings, "encoder", context.index), settings.world
    try:
        world, tree = make_body(wanted.id, wanted.parameters, settings.block, columns=1, seed=0)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    configs = [work_config(settings, tree, world.senses, block, place) for place, block in blocks]
    check_memory(configs)
    check_models(configs)
    works = [EncoderWork(config, context.clock) for config in configs]
    interface = interface_of(
        settings, senses=world.senses, action_size=world.action_size, blocks=tree.specs.values()
    )
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())
