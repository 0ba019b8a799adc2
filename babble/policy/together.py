"""Several blocks' models in one call, since a call costs more than what small networks compute.

An ONNX file is a protocol buffer, and concatenated messages merge: the bytes of several models, one after
the other, are one model with all their nodes, inputs and outputs, if no name comes twice. The learners
export a block's models under the block's name, so that none does; models of another origin run one by one,
and so do those that, joined, do not compute what each does alone.
"""

from collections.abc import Mapping
from typing import Any, Protocol

import numpy as np
import onnxruntime

from babble.policy.act import FAULTS, LOG_2PI, ActingModel, Floats, Mode, ModelError, session_of

TRIED_ROWS, TRIED_TOLERANCE = 2, 1e-4
"""Models that are joined are compared on so many random rows with each alone."""
Drawn = tuple[Floats, Floats]
"""Actions (E, a) and their log probabilities (E,)."""


class Encodes(Protocol):
    """An encoder as acting needs it; babble.policy.act.EncoderModel."""

    @property
    def latent_dim(self) -> int:
        """d"""
        ...

    def latent(self, observation: Floats) -> Floats:
        """(E, n) -> (E, d)."""
        ...


class Acts(Protocol):
    """A policy as acting needs it; babble.policy.act.PolicyModel."""

    def act(self, z: Floats, g: Floats, rng: np.random.Generator, mode: Mode = "sampled") -> Drawn:
        """Actions (E, a) and their log probabilities (E,)."""
        ...


class Encoders:
    """The encoders of several blocks, by block."""

    def __init__(self, models: Mapping[str, Encodes]) -> None:
        self.models = dict(models)
        self._joined = _Joined.of(self.models)

    def latents(self, observations: Mapping[str, Floats]) -> dict[str, Floats]:
        """By block, (E, n) -> (E, d)."""
        if self._joined is None:
            return {block: model.latent(observations[block]) for block, model in self.models.items()}
        outputs = self._joined.run({block: {"observation": observations[block]} for block in self.models})
        return dict(zip(self.models, outputs, strict=True))


class Policies:
    """The policies of several blocks, by block."""

    def __init__(self, models: Mapping[str, Acts]) -> None:
        self.models = dict(models)
        self._joined = _Joined.of(self.models)

    def act(
        self,
        latents: Mapping[str, Floats],
        goals: Mapping[str, Floats],
        rng: np.random.Generator,
        mode: Mode = "sampled",
    ) -> dict[str, Drawn]:
        """By block, latent and goal (E, d) -> actions (E, a), not clipped, and log probabilities (E,)."""
        if self._joined is None:
            return {
                block: model.act(latents[block], goals[block], rng, mode)
                for block, model in self.models.items()
            }
        outputs = self._run(latents, goals)
        sizes = [mean.shape[1] for mean in outputs[::2]]
        starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
        mean, log_std = np.concatenate(outputs[::2], axis=1), np.concatenate(outputs[1::2], axis=1)
        # One draw and one sum for all blocks: a call of NumPy costs more than what it computes here.
        noise = (
            rng.standard_normal(mean.shape, dtype=np.float32) if mode == "sampled" else np.zeros_like(mean)
        )
        action = np.asarray(mean + np.exp(log_std) * noise, np.float32)
        log_probs = np.add.reduceat(-(0.5 * noise**2 + log_std + 0.5 * LOG_2PI), starts, axis=1)
        return {
            block: (action[:, start : start + size], log_probs[:, index].astype(np.float32))
            for index, (block, start, size) in enumerate(zip(self.models, starts, sizes, strict=True))
        }

    def means(self, latents: Mapping[str, Floats], goals: Mapping[str, Floats]) -> dict[str, Floats]:
        """By block, the mean actions (E, a)."""
        if self._joined is None:
            rng = np.random.default_rng(0)
            return {
                block: model.act(latents[block], goals[block], rng, "mean")[0]
                for block, model in self.models.items()
            }
        return dict(zip(self.models, self._run(latents, goals)[::2], strict=True))

    def _run(self, latents: Mapping[str, Floats], goals: Mapping[str, Floats]) -> list[Floats]:
        assert self._joined is not None
        return self._joined.run({b: {"latent": latents[b], "goal": goals[b]} for b in self.models})


class _Joined:
    """Models that are one session."""

    def __init__(self, models: Mapping[str, ActingModel], session: onnxruntime.InferenceSession) -> None:
        self._models = models
        self._session = session

    @classmethod
    def of(cls, models: Mapping[str, Any]) -> "_Joined | None":
        """None where there is nothing to join, or where the models' names are not their own."""
        joinable = {block: model for block, model in models.items() if isinstance(model, ActingModel)}
        prefixes = {model.prefix for model in joinable.values()} - {""}
        if len(models) < 2 or len(prefixes) < len(models):
            return None
        try:
            joined = cls(joinable, session_of(b"".join(model.onnx for model in joinable.values())))
            return joined if joined._agrees() else None
        except ModelError:
            return None
        except FAULTS:
            return None

    def _agrees(self) -> bool:
        """Whether it computes what each model does alone: a name that comes twice would mix them up."""
        rng = np.random.default_rng(0)
        rows = {
            block: {name: rng.random((TRIED_ROWS, size), np.float32) for name, size in model.inputs.items()}
            for block, model in self._models.items()
        }
        alone = [value for block, model in self._models.items() for value in model.run(**rows[block])]
        together = self.run(rows)
        return len(alone) == len(together) and all(
            one.shape == other.shape and np.allclose(one, other, atol=TRIED_TOLERANCE)
            for one, other in zip(alone, together, strict=True)
        )

    def run(self, given: Mapping[str, Mapping[str, Floats]]) -> list[Floats]:
        """All outputs, in the order of the blocks."""
        feed: dict[str, Floats] = {}
        for block, model in self._models.items():
            feed |= model.feed(**given[block])
        try:
            return [np.asarray(value) for value in self._session.run(None, feed)]
        except FAULTS as error:
            shapes = ", ".join(f"{name} {array.shape}" for name, array in feed.items())
            raise ModelError(f"the joined models cannot run on {shapes} ({type(error).__name__})") from None
