"""Models for the tests of the actor: known answers, no ONNX."""

import numpy as np

from babble.blocks import BlockSpec, BlockTree
from services.actor.models import Held, ModelShelf


class Half:
    """An encoder: z_0 grows along x, so that it is known from the position."""

    latent_dim = 2

    def latent(self, observation: np.ndarray) -> np.ndarray:
        first = 0.5 + 0.4 * observation[:, :1]
        return np.concatenate([first, 1 - first], axis=1).astype(np.float32)


class Push:
    """A policy: towards the goal along x; tells its name by its log-probability."""

    def __init__(self, name: float, actuators: int = 3) -> None:
        self.name = name
        self.actuators = actuators

    def act(self, z, g, rng, mode="sampled"):  # type: ignore[no-untyped-def]
        action = np.zeros((len(z), self.actuators), np.float32)
        action[:, 0] = g[:, 0] - g[:, 1]
        return action, np.full(len(z), self.name, np.float32)


class Shelf(ModelShelf):
    """A shelf with the models above."""

    def __init__(self, tree: BlockTree | None = None) -> None:
        super().__init__(tree or BlockTree([BlockSpec("body", 2)], 1, 1))

    def put(self, policy_version: int, actuators: int = 3, block: str = "body") -> None:
        policy = Push(policy_version, actuators)
        self._held[block] = Held(Half(), 1, policy, policy_version)  # type: ignore[arg-type]
