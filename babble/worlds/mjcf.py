"""`Mjcf`: any MuJoCo model file as a world, with joints, actuators and sensors chosen by pattern."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from babble.patterns import matching
from babble.worlds.batch import Start
from babble.worlds.checks import check_texts, shown
from babble.worlds.physics.actuation import Indices
from babble.worlds.physics.env import BodyParameters, MujocoEnv, blueprint
from babble.worlds.physics.names import names_of
from babble.worlds.physics.task import Play
from babble.worlds.physics.world import Blueprint

SINGLE_AXIS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


@dataclass(frozen=True, kw_only=True)
class MjcfParameters(BodyParameters):
    """Parameters of `Mjcf`."""

    file: str = ""
    """the model (MJCF, URDF or MJB); a relative path is looked for where the process runs"""
    joints: Sequence[str] = ("*",)
    """patterns of the joints of posture and proprioception; hinges and slides only"""
    actuators: Sequence[str] = ("*",)
    """patterns of the actuators that are driven; the others stay at 0, or at the keyframe's control"""
    sensors: Sequence[str] = ()
    """patterns of the model's sensors, for the sense "sensors" """
    keyframe: str = ""
    """the model's keyframe at which episodes begin; "" for its own pose"""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name in ("joints", "actuators", "sensors"):
            check_texts(name, getattr(self, name))
        for name in ("file", "keyframe"):
            if not isinstance(getattr(self, name), str):
                raise ValueError(f"{name} must be a text, got {shown(getattr(self, name))}")
        if self.sensors and "sensors" not in self.senses:
            raise ValueError('sensors are chosen, but senses lacks "sensors"; add it')
        if "sensors" in self.senses and not self.sensors:
            raise ValueError('senses has "sensors", but none is chosen; give sensors, a list of patterns')


class Mjcf(MujocoEnv):
    """Any MuJoCo model; nothing is rewarded from outside."""

    Parameters = MjcfParameters

    def build(self, parameters: MjcfParameters) -> Blueprint:
        """Load the file and choose by pattern. Raises ValueError for what the model has not."""
        model = load(parameters.file)
        joints = _joints(model, parameters.joints)
        actuators = _named_or_all(model, "actuator", parameters.actuators)
        return blueprint(
            "Mjcf",
            model,
            parameters,
            joints=joints,
            actuators=actuators,
            task=lambda: _FromKeyframe(model, joints, parameters.keyframe),
            sensors=parameters.sensors,
        )


def load(file: str) -> mujoco.MjModel:
    """The compiled model of a file. Raises ValueError with one sentence that names the file."""
    if not file:
        raise ValueError("file is missing: name the MuJoCo model (MJCF, URDF or MJB) to load")
    try:
        path = Path(file).expanduser().absolute()
        there = path.is_file()
    except (OSError, RuntimeError) as error:
        raise ValueError(f"file {shown(file)} cannot be looked for: {error}") from None
    if not there:
        raise ValueError(f"there is no model file {path}")
    try:
        if path.suffix.lower() == ".mjb":
            return mujoco.MjModel.from_binary_path(str(path))
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"MuJoCo cannot use {path}: {' '.join(str(error).split())}") from None


class _FromKeyframe(Play):
    """Begins at a keyframe; a random start moves the chosen joints on from there."""

    def __init__(self, model: mujoco.MjModel, joints: Indices, keyframe: str) -> None:
        super().__init__(model, joints)
        self._key = -1
        if keyframe:
            self._key = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, keyframe)
            known = [model.key(index).name for index in range(model.nkey)]
            if self._key < 0:
                there = f"it has {', '.join(known)}" if known else "it has none"
                raise ValueError(f"the model has no keyframe {keyframe!r}; {there}")

    def begin(self, data: mujoco.MjData, rng: np.random.Generator, start: Start) -> None:
        """At the keyframe, or with each chosen joint anywhere in its range."""
        if self._key >= 0:
            mujoco.mj_resetDataKeyframe(self.model, data, self._key)
        super().begin(data, rng, start)


def _joints(model: mujoco.MjModel, patterns: Sequence[str]) -> Indices:
    """The chosen joints; "*" alone means all hinges and slides, named or not."""
    single = np.isin(model.jnt_type, [int(kind) for kind in SINGLE_AXIS])
    if list(patterns) == ["*"]:
        chosen = np.flatnonzero(single)
        if not chosen.size:
            raise ValueError("the model has no hinge or slide joint to make up a posture")
        return chosen
    chosen = matching(names_of(model, "joint"), patterns, "joint")
    if wrong := [int(joint) for joint in chosen if not single[joint]]:
        name = model.joint(wrong[0]).name
        raise ValueError(f"joint {name!r} is neither a hinge nor a slide; take it out with '!{name}'")
    return chosen


def _named_or_all(model: mujoco.MjModel, kind: str, patterns: Sequence[str]) -> Indices:
    names = names_of(model, kind)
    if not names:
        raise ValueError(f"the model has no {kind} to drive")
    return np.arange(len(names)) if list(patterns) == ["*"] else matching(names, patterns, kind)
