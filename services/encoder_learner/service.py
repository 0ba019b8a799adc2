"""The encoder learner as a process: one `EncoderWork` per block in the shell of a learner."""

import torch

from babble.bodies import make_body
from services.encoder_learner.config import check_memory, check_models, work_config
from services.encoder_learner.work import EncoderWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import SettingsError

SERVICE = "encoder_learner"


def build(context: Context) -> Learner:
    """The encoder learner of a run, resumed from its checkpoint if there is one.

    Raises `SettingsError` for a world or blocks that cannot be, experience that memory cannot hold, or an
    encoder that no frame can.
    """
    torch.set_num_threads(1)
    settings = context.settings
    wanted = settings.world
    try:
        world, tree = make_body(wanted.id, wanted.parameters, settings.block, columns=1, seed=0)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    configs = [
        work_config(settings, tree, world.senses, block.name, index)
        for index, block in enumerate(settings.block)
    ]
    check_memory(configs)
    check_models(configs)
    works = [EncoderWork(config, context.clock) for config in configs]
    interface = interface_of(settings, senses=world.senses, action_size=world.action_size)
    return Learner(context, works, service=SERVICE, fingerprint=interface.fingerprint())
