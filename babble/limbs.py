"""The blocks below a level: frozen, and sent to the goals that the level gives them (thesis 3.5.2)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from babble.blocks import BlockError, BlockTree
from babble.legs import Seen
from babble.policy.act import EncoderModel, PolicyModel
from babble.policy.goals import one_hot
from babble.policy.together import Encoders, Policies

Floats = NDArray[np.float32]
SubgoalForm = Literal["one-hot", "softmax"]
SHARPNESS = 4.0
"""Of the softmax that makes a goal of an action: actions are about 1 in size, goals to be near a vertex."""


@dataclass(frozen=True)
class BlockModels:
    """What a block acts with."""

    encoder: EncoderModel
    policy: PolicyModel


class Limbs:
    """The frozen blocks below a level, which act by their mean actions towards the goals they are given."""

    def __init__(
        self,
        tree: BlockTree,
        level: int,
        models: Mapping[str, BlockModels],
        decision_steps: Sequence[int],
        subgoals: Mapping[str, SubgoalForm],
    ) -> None:
        self.tree = tree
        self.at_work = [spec.name for spec in tree.level(level)]
        self.children = [child for name in self.at_work for child in tree.specs[name].children]
        """the blocks that are given goals from above the limbs, as they lie in observation and action"""
        self.places = _places(tree, self.at_work)
        self._subgoals = subgoals
        self._decision_steps = decision_steps
        below = blocks_below(tree, self.at_work)
        if missing := sorted(below - set(models)):
            raise BlockError(
                f"block {missing[0]!r} has no models to act with below {', '.join(self.at_work)}"
            )
        self._levels = [[s.name for s in tree.level(k) if s.name in below] for k in range(level)]
        self._encoders = [Encoders({b: models[b].encoder for b in blocks}) for blocks in self._levels]
        self._policies = [Policies({b: models[b].policy for b in blocks}) for blocks in self._levels]
        self.latents: dict[str, Floats] = {}
        """by block, (E, d) where it was when it was last looked at"""
        self.goals: dict[str, Floats] = {}
        """by block, (E, d) what it aims at"""
        self._known = 0
        """of so many levels, from below, the latents are those of the present observation"""

    @property
    def size(self) -> int:
        """The length of what is observed of them, and of what they are told."""
        return sum(self.tree.specs[child].latent_dim for child in self.children)

    @property
    def seen(self) -> dict[str, Seen | None]:
        """By block, what it acts on."""
        return {block: (self.latents[block], goal) for block, goal in self.goals.items()}

    def aim(self, action: Floats) -> None:
        """Give the children the goals that an action (E, size) of the level above makes (eq. 15)."""
        for name in self.at_work:
            self._route(name, action[:, self.places[name]])

    def perceive(self, observation: Floats, levels: int) -> None:
        """The latents of the lowest `levels` levels at an observation (E, n) of the body."""
        for k in range(self._known, levels):
            observed = {b: self.tree.observation_of(b, observation, self.latents) for b in self._levels[k]}
            self.latents |= self._encoders[k].latents(observed)
        self._known = max(self._known, levels)

    def observe(self, observation: Floats) -> Floats:
        """(E, n) -> (E, size): the concatenated latents of the children (eq. 14)."""
        self.perceive(observation, len(self._levels))
        return np.concatenate([self.latents[child] for child in self.children], axis=1)

    def move_on(self) -> None:
        """The body is elsewhere now: latents are to be found anew."""
        self._known = 0

    def act(self, observation: Floats, env_step: int, action_size: int) -> Floats:
        """The body's action (E, a) at an environment step, counted from when the last goals were given.

        Whoever is due decides, from above. What none of the limbs drives stays at 0.
        """
        due = [k for k in range(len(self._levels)) if env_step % self._decision_steps[k] == 0]
        self.perceive(observation, due[-1] + 1)
        action = np.zeros((len(observation), action_size), np.float32)
        for k in reversed(due):
            goals = {block: self.goals[block] for block in self._levels[k]}
            for block, mean in self._policies[k].means(self.latents, goals).items():
                if self.tree.specs[block].children:
                    self._route(block, mean)
                else:
                    action[:, self.tree.driven(block)] = mean
        return action

    def _route(self, name: str, action: Floats) -> None:
        form = self._subgoals.get(name, "one-hot")
        for child, place in self.tree.child_slices(name).items():
            self.goals[child] = goal_of(action[:, place], form)


def goal_of(action: Floats, form: SubgoalForm) -> Floats:
    """(E, d) -> (E, d): the goal that a part of an action stands for.

    one-hot: the vertex of its largest component; softmax: a point inside the simplex, near a vertex.
    """
    if form == "one-hot":
        return one_hot(action.argmax(axis=1), action.shape[1])
    raised = np.exp(SHARPNESS * (action - action.max(axis=1, keepdims=True)))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True), np.float32)


def _places(tree: BlockTree, names: Sequence[str]) -> dict[str, NDArray[np.intp]]:
    """Where each block's children lie in the concatenated latents and goals of all children."""
    places, start = {}, 0
    for name in names:
        size = tree.observation_size_of(name)
        places[name] = np.arange(start, start + size, dtype=np.intp)
        start += size
    return places


def blocks_below(tree: BlockTree, names: Sequence[str]) -> set[str]:
    """All descendants of the named blocks."""
    found: set[str] = set()
    waiting = [child for name in names for child in tree.specs[name].children]
    while waiting:
        name = waiting.pop()
        found.add(name)
        waiting += tree.specs[name].children
    return found
