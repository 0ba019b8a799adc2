"""Acting with published models: ONNX Runtime only, no torch."""

from typing import Literal

import numpy as np
import onnxruntime
from numpy.typing import NDArray
from onnxruntime.capi import onnxruntime_pybind11_state as faults

Floats = NDArray[np.float32]
Mode = Literal["sampled", "mean"]

FAULTS = tuple(t for t in vars(faults).values() if isinstance(t, type) and issubclass(t, Exception))
"""ONNX Runtime's errors, which share no base of their own."""
LOG_2PI = float(np.log(2 * np.pi))


class ModelError(ValueError):
    """Model bytes that cannot be used; the text is one sentence for a person."""


class ActingModel:
    """An ONNX model with the expected inputs and outputs, each (batch, size) float32."""

    def __init__(self, onnx: bytes, kind: str, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> None:
        try:
            self._session = session_of(onnx)
        except FAULTS as error:
            raise ModelError(
                f"the {kind} is not a model that ONNX Runtime reads ({type(error).__name__})"
            ) from None
        self.onnx = onnx
        self.prefix = _prefix(self._session)
        """What all names in it begin with: its block's, or nothing."""
        self._kind = kind
        self.inputs = _sizes(self._session.get_inputs(), kind, "input", inputs, self.prefix)
        """the size of each input"""
        self._outputs = _sizes(self._session.get_outputs(), kind, "output", outputs, self.prefix)

    @property
    def sizes(self) -> dict[str, int]:
        """Of each input and output; one that is both by name, by its input."""
        return self._outputs | self.inputs

    def feed(self, **arrays: Floats) -> dict[str, Floats]:
        """The inputs as ONNX Runtime takes them. Raises `ModelError` for other sizes."""
        for name, array in arrays.items():
            if array.ndim != 2 or array.shape[1] != self.inputs[name]:
                size = self.inputs[name]
                raise ModelError(f"the {self._kind} takes {name} of size {size}, got shape {array.shape}")
        return {
            self.prefix + name: np.ascontiguousarray(array, dtype=np.float32)
            for name, array in arrays.items()
        }

    def run(self, **arrays: Floats) -> list[Floats]:
        """The outputs. Raises `ModelError` where there are none."""
        given = self.feed(**arrays)
        try:
            return [np.asarray(value) for value in self._session.run(None, given)]
        except FAULTS as error:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in arrays.items())
            raise ModelError(f"the {self._kind} cannot run on {shapes} ({type(error).__name__})") from None


class EncoderModel(ActingModel):
    """observation (E, n) -> latent (E, d). Raises `ModelError` for other bytes."""

    def __init__(self, onnx: bytes) -> None:
        super().__init__(onnx, "encoder", ("observation",), ("latent",))
        self.observation_size = self.inputs["observation"]
        self.latent_dim = self._outputs["latent"]

    def latent(self, observation: Floats) -> Floats:
        """z (E, d), each row on the simplex, or anywhere if the encoder has a linear output."""
        return self.run(observation=observation)[0]


class PolicyModel(ActingModel):
    """latent, goal (E, d) -> a Gaussian over actions (E, a). Raises `ModelError` for other bytes."""

    def __init__(self, onnx: bytes) -> None:
        super().__init__(onnx, "policy", ("latent", "goal"), ("mean", "log_std"))
        self.latent_dim = self.inputs["latent"]
        self.action_size = self._outputs["mean"]
        if self.inputs["goal"] != self.latent_dim or self._outputs["log_std"] != self.action_size:
            raise ModelError("the policy's goal must be as long as its latent, and its log_std as its mean")

    def distribution(self, z: Floats, g: Floats) -> tuple[Floats, Floats]:
        """The mean and the log standard deviation (E, a)."""
        mean, log_std = self.run(latent=z, goal=g)
        return mean, log_std

    def act(
        self, z: Floats, g: Floats, rng: np.random.Generator, mode: Mode = "sampled"
    ) -> tuple[Floats, Floats]:
        """Actions (E, a), not clipped, and their log probabilities (E,)."""
        return drawn(*self.distribution(z, g), rng, mode)


def drawn(mean: Floats, log_std: Floats, rng: np.random.Generator, mode: Mode) -> tuple[Floats, Floats]:
    """Actions (E, a) of a Gaussian, its mean or a sample, and their log probabilities (E,)."""
    noise = rng.standard_normal(mean.shape, dtype=np.float32) if mode == "sampled" else np.zeros_like(mean)
    log_prob = -(0.5 * noise**2 + log_std + 0.5 * LOG_2PI).sum(axis=1)
    return np.asarray(mean + np.exp(log_std) * noise), log_prob.astype(np.float32)


def session_of(onnx: bytes) -> onnxruntime.InferenceSession:
    """A session with one thread. Raises one of `FAULTS`."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    options.log_severity_level = 4
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    return onnxruntime.InferenceSession(onnx, options, providers=["CPUExecutionProvider"])


def _prefix(session: onnxruntime.InferenceSession) -> str:
    names = [value.name for value in session.get_inputs()[:1]]
    return names[0][: names[0].rfind("/") + 1] if names else ""


def _sizes(
    found: list[onnxruntime.NodeArg], kind: str, role: str, expected: tuple[str, ...], prefix: str
) -> dict[str, int]:
    names = tuple(value.name.removeprefix(prefix) for value in found)
    if names != expected:
        raise ModelError(f"the {kind} has {role}s {', '.join(names)}, expected {', '.join(expected)}")
    for value in found:
        fits = value.type == "tensor(float)" and len(value.shape) == 2
        if not fits or not isinstance(value.shape[1], int) or isinstance(value.shape[0], int):
            what = f"{value.type} {value.shape}"
            raise ModelError(f"the {kind}'s {role} {value.name} is {what}, expected float (batch, size)")
    return {value.name.removeprefix(prefix): value.shape[1] for value in found}
