"""What all simulated bodies share: their parameters, and their Gymnasium environment."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, Literal

import gymnasium
import mujoco
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from babble.landmarks import Landmark
from babble.observations import Layout
from babble.worlds.batch import Floats
from babble.worlds.checks import check_choice, check_count, check_flag, check_table
from babble.worlds.physics.actuation import Actuation, Indices, Motors, balance
from babble.worlds.physics.impairment import restrict, weaken
from babble.worlds.physics.muscles import Muscles, hand_over
from babble.worlds.physics.names import names_of
from babble.worlds.physics.task import Task
from babble.worlds.physics.world import Blueprint, MujocoWorld
from babble.worlds.senses.build import check_names, make_senses
from babble.worlds.senses.degradation import Degradation
from babble.worlds.senses.joints import Unit
from babble.worlds.senses.rendering import View, picture


@dataclass(frozen=True, kw_only=True)
class BodyParameters:
    """Parameters of every simulated body."""

    senses: Sequence[str] = ("position",)
    """what is observed, in this order; see babble.worlds.senses.build.SENSES"""
    angles: Unit = "range"
    """positions as shares of the joints' ranges, or in radians"""
    touch: Mapping[str, Any] = field(default_factory=dict)
    """options of babble.worlds.senses.touch.Touch"""
    vision: Mapping[str, Any] = field(default_factory=dict)
    """options of babble.worlds.senses.vision.Vision"""
    degradation: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    """by sense: options of babble.worlds.senses.degradation.Degradation"""
    actuation: Literal["motors", "muscles"] = "motors"
    """motors with the joints' springs and dampers, or MIMo's muscle model"""
    balanced: bool = False
    """motors are driven only as hard as their weaker direction can answer: bending as strong as stretching"""
    mobility: Mapping[str, float] = field(default_factory=dict)
    """by pattern of joints: the share of the range that is left"""
    strength: Mapping[str, float] = field(default_factory=dict)
    """by pattern of actuators: the share of the force that is left"""
    physics_steps: int = 2
    """MuJoCo steps in one environment step"""
    episode_steps: int = 0
    """environment steps after which an episode is cut off; 0 for never"""

    def __post_init__(self) -> None:
        check_names(self.senses)
        check_choice("actuation", self.actuation, ("motors", "muscles"))
        check_choice("angles", self.angles, ("range", "radians"))
        check_count("physics_steps", self.physics_steps, least=1, most=1000)
        check_count("episode_steps", self.episode_steps, least=0, most=10**9)
        for given in fields(self):
            if isinstance(given.default, bool):
                check_flag(given.name, getattr(self, given.name))
        for name in ("touch", "vision", "degradation", "mobility", "strength"):
            check_table(name, getattr(self, name))
        for sense in ("touch", "vision"):
            if getattr(self, sense) and sense not in self.senses:
                raise ValueError(f'{sense} has options, but senses lacks "{sense}"; add it')
        if self.balanced and self.actuation == "muscles":
            raise ValueError("balanced is for motors; muscles are as strong as their figures say")

    def degradations(self) -> dict[str, Degradation]:
        """By the name of the sense. Raises ValueError for an unknown option or a bad value."""
        known = [option.name for option in fields(Degradation)]
        for sense, options in self.degradation.items():
            check_table(f"degradation of {sense}", options, known)
        return {sense: Degradation(**options) for sense, options in self.degradation.items()}


class MujocoEnv(gymnasium.Env[Floats, Floats]):
    """A simulated body as a Gymnasium environment; its parameters are keywords.

    Observation (n,) float32 and action (a,) in [-1, 1] are those of the `World` with one copy; the
    reward is the task's own. A simulation that breaks down truncates the episode, with `info["failed"]`.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 100}
    Parameters: ClassVar[type[BodyParameters]] = BodyParameters
    view: ClassVar[View] = View()
    """from where `render` looks"""

    def __init__(self, *, render_mode: str | None = None, **parameters: Any) -> None:
        known = self.defaults()
        if unknown := sorted(set(parameters) - set(known)):
            raise ValueError(f"there is no parameter {unknown[0]!r}; the parameters are {', '.join(known)}")
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f'render_mode is "rgb_array" or None, got {render_mode!r}')
        self.render_mode = render_mode
        self.blueprint = self.build(self.Parameters(**parameters))
        self._single = self.world(columns=1, rng=np.random.default_rng())
        self.observation_space = _observation_space(self._single.senses)
        self.action_space = spaces.Box(-1.0, 1.0, (self._single.action_size,), dtype=np.float32)

    @classmethod
    def defaults(cls) -> dict[str, Any]:
        """The parameters and their default values."""
        return {
            given.name: given.default if given.default_factory is MISSING else given.default_factory()
            for given in fields(cls.Parameters)
        }

    def build(self, parameters: Any) -> Blueprint:
        """The body, its senses and its task. Raises ValueError, in one sentence, for bad parameters."""
        raise NotImplementedError

    def world(self, columns: int, rng: np.random.Generator) -> MujocoWorld:
        """`columns` copies of this environment, stepped together."""
        return MujocoWorld(self.blueprint, columns, rng)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Floats, dict[str, Any]]:
        """Begin an episode at the task's usual place, or a random one with `options={"start": "random"}`."""
        super().reset(seed=seed)
        if seed is not None:
            # The world and its senses share one generator, which is wound to the seed's place.
            self._single.rng.bit_generator.state = self.np_random.bit_generator.state
        return self._single.reset((options or {}).get("start", "centre"))[0], {}

    def step(self, action: Floats) -> tuple[Floats, float, bool, bool, dict[str, Any]]:
        """One environment step."""
        step = self._single.step(np.asarray(action)[None])
        failed = step.failed is not None and bool(step.failed[0])
        info = {"failed": True} if failed else {}
        over = bool(step.truncated[0]) or failed
        return step.observation[0], float(step.external_reward[0]), bool(step.terminated[0]), over, info

    def split(self, observation: Floats) -> dict[str, NDArray[np.float32]]:
        """An observation (..., n) by sense, each in its own shape (..., *shape)."""
        layout = Layout(self._single.senses)
        return {
            name: observation[..., place].reshape(*observation.shape[:-1], *layout.senses[name])
            for name, place in layout.slices.items()
        }

    def render(self) -> NDArray[np.uint8] | None:
        """A picture (480, 640, 3) of the body, in render mode "rgb_array"."""
        if self.render_mode is None:
            return None
        data = self._single.copies[0]
        return picture(self.blueprint.model, data, width=640, height=480, camera=self.view)


def blueprint(
    id: str,
    model: mujoco.MjModel,
    parameters: BodyParameters,
    *,
    joints: Indices,
    actuators: Indices,
    task: Callable[[], Task],
    sensors: Sequence[str] = (),
    landmarks: tuple[Landmark, ...] = (),
    sided: int | None = None,
) -> Blueprint:
    """The blueprint of a body whose model was built for it alone: its ranges and motors are changed.

    `joints` are posture and proprioception; `task` is made when the model stays as it is. Raises ValueError.
    """
    actuation = _actuated(model, parameters, joints, actuators)
    senses = partial(
        make_senses,
        model,
        parameters.senses,
        joints=joints,
        angles=parameters.angles,
        sensors=sensors,
        touch=parameters.touch,
        vision=parameters.vision,
    )
    return Blueprint(
        id=id,
        model=model,
        joints=joints,
        joint_names=tuple(np.array(names_of(model, "joint"))[joints].tolist()),
        task=task(),
        actuation=actuation,
        senses=senses,
        physics_steps=parameters.physics_steps,
        episode_steps=parameters.episode_steps,
        degradations=parameters.degradations(),
        landmarks=landmarks,
        sided=sided,
    )


def _actuated(
    model: mujoco.MjModel, parameters: BodyParameters, joints: Indices, actuators: Indices
) -> Callable[[int], Actuation]:
    """Change the model as the parameters say; returns what makes its actuation for so many copies."""
    stretched_over = model.jnt_range[model.actuator_trnid[actuators, 0]].copy()
    restrict(model, parameters.mobility)
    weaken(model, parameters.strength)
    if parameters.balanced:
        balance(model, actuators)
    if parameters.actuation == "muscles":
        hand_over(model, actuators, joints)
        return lambda columns: Muscles(model, actuators, stretched_over, columns)
    return lambda columns: Motors(model, actuators, columns)


def _observation_space(senses: Mapping[str, tuple[int, ...]]) -> spaces.Box:
    layout = Layout(senses)
    low, high = np.full((2, layout.size), [[-np.inf], [np.inf]], np.float32)
    for image in layout.images:
        low[layout.slices[image]], high[layout.slices[image]] = 0.0, 255.0
    return spaces.Box(low, high, dtype=np.float32)
