"""Copies of one MuJoCo body, stepped together: the `World` of every simulated body."""

import logging
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import mujoco
import numpy as np
from numpy.typing import NDArray

from babble.breakdowns import UnstableError
from babble.landmarks import Landmark
from babble.observations import Layout
from babble.worlds.batch import Flags, Floats, Start, Step
from babble.worlds.physics.actuation import Actuation
from babble.worlds.physics.names import labels
from babble.worlds.physics.stability import BEGINNINGS, is_broken
from babble.worlds.physics.task import Task
from babble.worlds.senses.degradation import Degradation, Degraded
from babble.worlds.senses.joints import centre_and_half_range
from babble.worlds.senses.sense import Copies, Sense

log = logging.getLogger(__name__)
# By itself MuJoCo writes its warnings into a file where the process runs; what they tell is counted here.
mujoco.set_mju_user_warning(lambda text: log.debug("MuJoCo: %s", text))

Indices = NDArray[np.intp]


@dataclass(frozen=True, kw_only=True)
class Blueprint:
    """A body with its actuation, senses and task, of which worlds of any number of copies are made."""

    id: str
    model: mujoco.MjModel
    joints: Indices
    """the joints of the posture: hinges and slides"""
    joint_names: tuple[str, ...]
    task: Task
    actuation: Callable[[int], Actuation]
    """given the number of copies"""
    senses: Callable[[Actuation, np.random.Generator], Sequence[Sense]]
    """given the actuation and the world's random numbers"""
    physics_steps: int
    """MuJoCo steps in one environment step"""
    episode_steps: int = 0
    """an episode is cut off after so many environment steps; 0 for never"""
    degradations: Mapping[str, Degradation] = field(default_factory=dict)
    """by the name of a sense"""
    landmarks: tuple[Landmark, ...] = ()
    sided: int | None = None
    """the body part whose x axis, its front, says which side the whole lies on; None where none counts"""


class MujocoWorld:
    """`columns` copies (E) of a body; implements `World`.

    An observation is of the moment after the step. As in MuJoCo, what is derived from positions
    (sensors, contacts, what eyes see) is of the beginning of the step's last physics step.
    """

    crossing_axis = None

    def __init__(self, blueprint: Blueprint, columns: int, rng: np.random.Generator) -> None:
        if columns < 1:
            raise ValueError(f"a world needs at least one column, got {columns}")
        self.id = blueprint.id
        self.blueprint = blueprint
        self.columns = columns
        self.rng = rng
        self.landmarks = blueprint.landmarks
        self.posture_names = blueprint.joint_names
        self.state_names = tuple(
            f"{what}/{j}" for what in ("position", "velocity") for j in self.posture_names
        )
        self.rewarded = blueprint.task.rewarded
        self._model = blueprint.model
        # A broken simulation is to be seen, not to be set back behind our back.
        self._model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
        self.copies: Copies = [mujoco.MjData(self._model) for _ in range(columns)]
        self._actuation = blueprint.actuation(columns)
        self._senses = list(blueprint.senses(self._actuation, rng))
        self.senses = {sense.name: sense.shape for sense in self._senses}
        self.observation_names = tuple(f"{s.name}/{part}" for s in self._senses for part in s.components)
        self.action_size = self._actuation.size
        self.action_names = labels(self._model, "actuator", self._actuation.actuators)
        self.moves = _moves(self._model, self._actuation.actuators, blueprint.joints)
        self.observation_size = Layout(self.senses).size
        self._degraded = _degraded(blueprint, self.senses, columns, rng)
        self._qpos = self._model.jnt_qposadr[blueprint.joints]
        # MuJoCo's own memory, which stays where it is as long as the copies are there.
        self._moving = [data.qpos for data in self.copies] + [data.qvel for data in self.copies]
        self._state = _state_indices(self._model, blueprint.joints, columns)
        self._centre, self._half = centre_and_half_range(self._model, blueprint.joints)
        self._now = self._earliest = 0
        """steps of the world, and that at which its longest episode began"""
        self._begun = np.zeros(columns, np.int64)
        self._none = np.zeros(columns, np.bool_)
        self._last = np.zeros((columns, self.observation_size), np.float32)

    @property
    def posture_size(self) -> int:
        """The number of joints."""
        return len(self._qpos)

    @property
    def diameter(self) -> float:
        """From all joints at their lower to all at their upper limits: 2 * sqrt(joints)."""
        return self.span(range(self.posture_size))

    def span(self, components: Sequence[int]) -> float:
        """2 * sqrt(n) for n joints."""
        return 2 * math.sqrt(len(components))

    @property
    def step_secs(self) -> float:
        """The time that passes in one step of the world."""
        return float(self._model.opt.timestep * self.blueprint.physics_steps)

    def reset(self, start: Start = "centre") -> Floats:
        """Begin a new episode in all copies, at the task's usual place or a random one."""
        if start not in ("centre", "random"):
            raise ValueError(f"start must be 'centre' or 'random', got {start!r}")
        return self._begin(np.ones(self.columns, np.bool_), start)

    def restart(self, columns: Flags) -> Floats:
        """Begin a new episode in the flagged copies."""
        return self._begin(columns, "centre")

    def step(self, action: Floats) -> Step:
        """Act for one environment step. Raises ValueError for a wrong shape or NaN."""
        flat = action.reshape(-1)
        # The square is one call where looking at each number is two, between steps of MuJoCo that leave
        # nothing of Python in the processor's caches.
        if action.shape != (self.columns, self.action_size) or not math.isfinite(flat.dot(flat)):
            raise ValueError(
                f"actions must be finite numbers of shape ({self.columns}, {self.action_size}), "
                f"got shape {action.shape}"
            )
        self._actuation.advance(self.copies, action, self.blueprint.physics_steps)
        self._now += 1
        failed = self._broken()
        if failed is None:
            terminated, reward, observation = self._outcome()
        else:
            # Numbers of a broken simulation need not fit the observation's type.
            with np.errstate(all="ignore"):
                terminated, reward, observation = self._outcome()
            observation[failed], reward[failed] = 0.0, 0.0
        self._last = observation
        return Step(observation, terminated, self._cut_off(terminated), reward, failed)

    def _outcome(self) -> tuple[Flags, Floats, Floats]:
        task = self.blueprint.task
        observation = self._joined([self._passed(sense) for sense in self._senses])
        return task.terminated(self.copies), task.reward(self.copies), observation

    def _cut_off(self, terminated: Flags) -> Flags:
        """(E,) whose episode has had its steps and did not end by itself."""
        limit = self.blueprint.episode_steps
        if not limit or self._now - self._earliest < limit:
            return self._none.copy()
        return (self._now - self._begun >= limit) & ~terminated

    def posture(self) -> Floats:
        """(E, joints): where each joint is in its range, from -1 to 1."""
        position = np.array([data.qpos for data in self.copies])[:, self._qpos]
        return np.clip((position - self._centre) / self._half, -1, 1).astype(np.float32)

    def side(self) -> Floats | None:
        """(E,) the height of the front's unit vector: 1 facing up, on the back; -1 facing down."""
        part = self.blueprint.sided
        return None if part is None else np.array([data.xmat[part, 6] for data in self.copies], np.float32)

    def state(self) -> Floats:
        """(E, 2 x joints) of the posture's joints: positions in rad or m, then velocities in rad/s or m/s."""
        return np.concatenate(self._moving).take(self._state).astype(np.float32)

    def _begin(self, columns: Flags, start: Start) -> Floats:
        for index in np.flatnonzero(columns).tolist():
            self._begin_copy(self.copies[index], start)
        self._actuation.begin(columns)
        self._begun[columns] = self._now
        self._earliest = int(self._begun.min())
        values = []
        for sense in self._senses:
            value, degraded = sense.read(self.copies), self._degraded.get(sense.name)
            values.append(value if degraded is None else degraded.begin(value, columns))
        observation = self._joined(values)
        # Copies that go on have seen what they saw: another reading would draw new noise.
        observation[~columns] = self._last[~columns]
        self._last = observation
        return observation

    def _begin_copy(self, data: mujoco.MjData, start: Start) -> None:
        """A new episode; what breaks down while the body comes to rest is begun again from another draw."""
        for _ in range(BEGINNINGS):
            mujoco.mj_resetData(self._model, data)
            self.blueprint.task.begin(data, self.rng, start)
            if not is_broken(data):
                mujoco.mj_forward(self._model, data)
                return
            log.info("an episode of %s broke down while it was begun; it is begun again", self.id)
        raise UnstableError(
            f"the simulation of {self.id} broke down {BEGINNINGS} times before an episode had begun; "
            "give it a smaller timestep, or let it start from rest"
        )

    def _joined(self, values: Sequence[Floats]) -> Floats:
        return np.concatenate([value.reshape(self.columns, -1) for value in values], axis=1)

    def _passed(self, sense: Sense) -> Floats:
        value, degraded = sense.read(self.copies), self._degraded.get(sense.name)
        return value if degraded is None else degraded.next(value)

    def _broken(self) -> Flags | None:
        """(E,) whose velocities are not finite or out of bounds; None if all are well."""
        broken = [is_broken(data) for data in self.copies]
        return np.array(broken) if any(broken) else None


def _state_indices(model: mujoco.MjModel, joints: Indices, columns: int) -> Indices:
    """(E, 2 x joints) where each number of a state lies in all qpos of the copies, then all qvel."""
    copy = np.arange(columns)[:, None]
    positions = copy * model.nq + model.jnt_qposadr[joints]
    velocities = columns * model.nq + copy * model.nv + model.jnt_dofadr[joints]
    return np.concatenate([positions, velocities], axis=1)


def _moves(model: mujoco.MjModel, actuators: Indices, joints: Indices) -> tuple[tuple[int, ...], ...]:
    """For each actuator, which of the joints have a lever arm with it in the model's own pose.

    That is the joint itself, or all joints of a tendon; those that follow through contacts, springs and
    equalities are not counted.
    """
    data = mujoco.MjData(model)
    mujoco.mj_fwdPosition(model, data)
    place = {int(model.jnt_dofadr[joint]): index for index, joint in enumerate(joints)}
    moved = []
    for actuator in actuators:
        start, count = data.moment_rowadr[actuator], data.moment_rownnz[actuator]
        dofs = data.moment_colind[start : start + count].tolist()
        moved.append(tuple(sorted(place[dof] for dof in dofs if dof in place)))
    return tuple(moved)


def _degraded(
    blueprint: Blueprint, senses: Mapping[str, tuple[int, ...]], columns: int, rng: np.random.Generator
) -> dict[str, Degraded]:
    for name in blueprint.degradations:
        if name not in senses:
            raise ValueError(f"degradation: the body has no sense {name!r}; it has {', '.join(senses)}")
    return {name: Degraded(how, senses[name], columns, rng) for name, how in blueprint.degradations.items()}
