"""A level of the tree as a world of its own (Hi-Composer, thesis 3.5): latents in, goals out.

For the blocks of level 0 the world is the body. For those of a level above it is the body together with
all the frozen blocks below them: what such blocks observe are the latents of their children (eq. 14), their
action is the goals of their children (eq. 15), and one step is as many steps of the body as an action is
held for. So babbling, collecting, training and scoring are the same at every level.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from babble.blocks import BlockTree, Indices
from babble.landmarks import Landmark
from babble.legs import Seen, Witness
from babble.limbs import BlockModels, Limbs, SubgoalForm
from babble.parts import moved_by
from babble.worlds.batch import Flags, Floats, Start, Step, World

__all__ = ["BlockModels", "LevelWorld", "Stage", "SubgoalForm", "stage_of"]


@dataclass(frozen=True)
class Stage:
    """What the blocks of one level act on."""

    world: World
    observed: Mapping[str, Indices]
    """by block at work: which of the world's observation it observes"""
    driven: Mapping[str, Indices]
    """by block at work: which of the world's action it drives"""
    env_steps_per_step: int
    """environment steps of the body in one step of `world`"""
    witness: Witness
    """for whoever steps the world: it shows people the body, at each environment step"""

    def env_steps(self, steps: int) -> int:
        """What all steps of `world` so far, which are `steps`, were in environment steps of each copy."""
        undone = self.world.undone if isinstance(self.world, LevelWorld) else 0
        return steps * self.env_steps_per_step - undone


def stage_of(
    world: World,
    tree: BlockTree,
    level: int = 0,
    models: Mapping[str, BlockModels] | None = None,
    *,
    decision_steps: Sequence[int] = (1,),
    steps_per_action: int | None = None,
    subgoals: Mapping[str, SubgoalForm] | None = None,
    witness: Witness | None = None,
) -> Stage:
    """The stage of a level, on a body that stays where it is.

    `models` are those of all blocks below the level's. `decision_steps` are by level, from 1 at level 0:
    so many environment steps an action is held. `steps_per_action` are those of one step on this stage
    instead of the level's `decision_steps`. `subgoals` say by block how its actions become goals, one-hot
    where nothing is said. Raises `BlockError` for a missing model.
    """
    names = [spec.name for spec in tree.level(level)]
    if level == 0:
        observed = {name: tree.observed(name) for name in names}
        driven = {name: tree.driven(name) for name in names}
        return Stage(world, observed, driven, 1, witness or Witness())
    each = decision_steps[level] if steps_per_action is None else steps_per_action
    limbs = Limbs(tree, level, models or {}, decision_steps, subgoals or {})
    raised = LevelWorld(world, limbs, each, witness or Witness())
    return Stage(raised, limbs.places, limbs.places, each, raised.relay)


class LevelWorld:
    """A body with the frozen blocks below a level; implements `World`.

    Where an episode ends within a step, the step's numbers are those of its end; the body goes on in a
    new episode until the step is over, which nobody records. Rewards are means over environment steps.
    """

    def __init__(self, world: World, limbs: Limbs, env_steps_per_step: int, witness: Witness) -> None:
        self.relay = _Relay(witness)
        self.body = world
        self._limbs = limbs
        self._each = env_steps_per_step
        self._witness = witness
        self._observation: Floats | None = None
        self._ended: _Story | None = None
        """of the last step, if an episode ended within it"""
        self.undone = 0
        """environment steps of each copy that were not done, because the simulation broke down before"""
        self.id, self.columns = world.id, world.columns
        self.observation_size = self.action_size = limbs.size
        self.senses: Mapping[str, tuple[int, ...]] = {"latent": (limbs.size,)}
        self.posture_size, self.posture_names = world.posture_size, world.posture_names
        self.diameter, self.crossing_axis = world.diameter, world.crossing_axis
        self.rewarded, self.state_names = world.rewarded, world.state_names
        self.landmarks: tuple[Landmark, ...] = world.landmarks
        components = [
            (child, vertex)
            for child in limbs.children
            for vertex in range(limbs.tree.specs[child].latent_dim)
        ]
        self.observation_names = tuple(f"latent/{child}:{vertex}" for child, vertex in components)
        self.action_names = tuple(f"{child}:{vertex}" for child, vertex in components)
        self.moves = tuple(moved_by(world, limbs.tree, child) for child, _ in components)

    def span(self, components: Sequence[int]) -> float:
        """See `World.span`; of the body."""
        return self.body.span(components)

    def reset(self, start: Start = "centre") -> Floats:
        """Begin a new episode in all copies."""
        return self.resume(self.body.reset(start))

    def resume(self, observation: Floats) -> Floats:
        """Go on from where the body is, by its present observation (E, n)."""
        self._observation = observation
        self._ended = None
        self._limbs.move_on()
        return self._limbs.observe(observation)

    @property
    def body_observation(self) -> Floats:
        """(E, n) of the body, now. Raises RuntimeError before `reset` or `resume`."""
        if self._observation is None:
            raise RuntimeError("a level is stepped after reset or resume")
        return self._observation

    def restart(self, columns: Flags) -> Floats:
        """Begin a new episode in the flagged copies."""
        return self.resume(self.body.restart(columns))

    def posture(self) -> Floats:
        """(E, p) of the body; where the last step ended an episode, what it was then."""
        posture = self.body.posture()
        return posture if self._ended is None else self._ended.left(posture)

    def side(self) -> Floats | None:
        """(E,) of the body; where the last step ended an episode, what it was then."""
        side = self.body.side()
        return side if side is None or self._ended is None else self._ended.lain(side)

    def state(self) -> Floats:
        """(E, s) of the body, now."""
        return self.body.state()

    def step(self, action: Floats) -> Step:
        """Give the children their goals by (E, a), and let them act for the steps that these are held.

        Raises ValueError for a wrong shape or NaN.
        """
        if action.shape != (self.columns, self.action_size) or not np.isfinite(action).all():
            raise ValueError(
                f"actions must be finite numbers of shape ({self.columns}, {self.action_size}), "
                f"got shape {action.shape}"
            )
        self._limbs.aim(action)
        self._ended = None
        story = _Story(self.columns)
        for k in range(self._each):
            step = self._step_body(k)
            if step.failed is not None and step.failed.any():
                self.undone += self._each - 1 - k
                return replace(step, observation=np.zeros((self.columns, self.observation_size), np.float32))
            over = story.add(step, self.body)
            if over.any() and k < self._each - 1:
                self._begin_anew(over)
            self._limbs.move_on()
        if not story.ended.any():
            arrived = self._limbs.observe(self.body_observation)
        else:
            self._ended = story
            arrived = self._limbs.observe(story.arrived(self.body_observation))
            self._limbs.move_on()
        none = None if step.failed is None else np.zeros(self.columns, np.bool_)
        return Step(arrived, story.terminated, story.truncated, story.reward(), none)

    def _step_body(self, k: int) -> Step:
        before = self.body_observation
        action = self._limbs.act(before, k, self.body.action_size)
        if self._witness.looking:
            self._witness.see(before, {**self.relay.above, **self._limbs.seen})
        step = self.body.step(action)
        self._observation = step.observation
        self._witness.stepped(step)
        self._witness.passed()
        return step

    def _begin_anew(self, over: Flags) -> None:
        self._observation = self.body.restart(over)
        self._witness.begun(over)
        if over[0]:
            self._witness.cut()


class _Story:
    """What happened to each column within one step of a level, up to the end of its episode."""

    def __init__(self, columns: int) -> None:
        self.terminated = np.zeros(columns, np.bool_)
        self.truncated = np.zeros(columns, np.bool_)
        self._total = np.zeros(columns, np.float32)
        self._steps = np.zeros(columns, np.float32)
        self._ends = self._postures = np.zeros((columns, 0), np.float32)
        self._sides = np.zeros(columns, np.float32)

    @property
    def ended(self) -> Flags:
        """(E,) whose episode has ended."""
        return np.asarray(self.terminated | self.truncated)

    def add(self, step: Step, body: World) -> Flags:
        """Take a step of the body; returns (E,) in which an episode ended with it, the first or another."""
        going = ~self.ended
        self._total += np.where(going, step.external_reward, 0)
        self._steps += going
        over = step.terminated | step.truncated
        newly = over & going
        if newly.any():
            posture = body.posture()
            if not self._ends.size:
                self._ends, self._postures = step.observation.copy(), posture.copy()
            self._ends[newly], self._postures[newly] = step.observation[newly], posture[newly]
            if (side := body.side()) is not None:
                self._sides[newly] = side[newly]
        self.terminated = self.terminated | (step.terminated & going)
        self.truncated = self.truncated | (step.truncated & going)
        return np.asarray(over)

    def arrived(self, observation: Floats) -> Floats:
        """The observation (E, n), with the end of each episode that ended."""
        return np.where(self.ended[:, None], self._ends, observation).astype(np.float32)

    def left(self, posture: Floats) -> Floats:
        """The posture (E, p), with that at the end of each episode that ended."""
        return np.where(self.ended[:, None], self._postures, posture).astype(np.float32)

    def lain(self, side: Floats) -> Floats:
        """The side (E,), with that at the end of each episode that ended."""
        return np.where(self.ended, self._sides, side).astype(np.float32)

    def reward(self) -> Floats:
        """(E,) the mean per environment step."""
        return np.asarray(self._total / self._steps, np.float32)


class _Relay(Witness):
    """Keeps what the blocks at work act on, for the steps of the body under it."""

    looking = True

    def __init__(self, witness: Witness) -> None:
        self.above: dict[str, Seen | None] = {}
        self._witness = witness

    def see(self, observation: Floats, seen: Mapping[str, Seen | None]) -> None:
        self.above = dict(seen)

    def begun(self, columns: Flags) -> None:
        self._witness.begun(columns)

    def cut(self) -> None:
        self._witness.cut()
