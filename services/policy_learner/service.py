"""The policy learner as a process: one `PolicyWork` per block in the shell of a learner."""

import torch

from babble.bodies import make_body
from babble.scores import landmarks_of
from services.policy_learner.config import work_config
from services.policy_learner.work import PolicyWork
from services.runtime.interface import interface_of
from services.runtime.learner import Learner
from services.runtime.process import Context
from services.runtime.settings import SettingsError

SERVICE = "policy_learner"


def build(context: Context) -> Learner:
    """The policy learner of a run, resumed from its checkpoint if there is one.

    Raises `SettingsError` for a world or blocks that cannot be, or a reward that there is not.
    """
    torch.set_num_threads(1)
    settings = context.settings
    wanted = settings.world
    try:
        world, tree = make_body(wanted.id, wanted.parameters, settings.block, columns=1, seed=0)
    except ValueError as error:
        raise SettingsError(str(error)) from None
    settings.check_rewarded(world.rewarded)
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
