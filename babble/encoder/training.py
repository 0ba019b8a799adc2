"""Fitting the encoder: phase 1 (ENCODE) and phase 4 (REFINE) of the thesis (3.3)."""

import copy
from collections import deque
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from babble import rng_state
from babble.encoder.cltt import Similarity, alignment, info_nce, similarities, uniformity
from babble.encoder.network import Encoder
from babble.memory import ExperienceMemory

RECENT = 25
"""Measurements are means over so many updates."""


@dataclass
class _Fit:
    window_steps: int
    temperature: float
    updates: int = 0


class _Recent(NamedTuple):
    """What one update found."""

    loss: float
    accuracy: float
    alignment: float


class EncoderTrainer:
    """Fits one encoder, again and again: begin_fit, update..., end_fit. Sets torch to one thread."""

    def __init__(
        self,
        encoder: Encoder,
        *,
        learning_rate: float,
        batch: int,
        similarity: Similarity = "l2",
        seed: int = 0,
    ) -> None:
        torch.set_num_threads(1)
        self.encoder = encoder
        self._learning_rate = learning_rate
        self._batch = batch
        self._similarity: Similarity = similarity
        self._rng = np.random.default_rng(seed)
        self._optimiser = self._fresh_optimiser()
        self._old: dict[str, Tensor] = {}
        self._fit: _Fit | None = None
        self._recent: deque[_Recent] = deque(maxlen=RECENT)

    @property
    def updates_done(self) -> int:
        """Updates of the current fit; 0 when none is under way."""
        return self._fit.updates if self._fit else 0

    def begin_fit(self, window_steps: int, temperature: float) -> None:
        """Start a fit from the present weights, remembered for `end_fit`, with a fresh optimiser."""
        if window_steps < 1 or temperature <= 0:
            raise ValueError(
                f"a fit needs window_steps >= 1 and temperature > 0, got {window_steps} and {temperature}"
            )
        self._fit = _Fit(window_steps, temperature)
        self._old = copy.deepcopy(self.encoder.state_dict())
        self._optimiser = self._fresh_optimiser()
        self._recent.clear()

    def update(
        self, memory: ExperienceMemory, count: int, enough: Callable[[], bool] = lambda: False
    ) -> dict[str, float]:
        """Do `count` updates, fewer if `enough()` after one of them; returns what the last ones found.

        These are the means of loss, accuracy and alignment over the last 25 updates of the fit, however they
        were sliced, and the last batch's uniformity. accuracy = the share of anchors whose own positive is
        the nearest of the batch. Raises RuntimeError outside a fit and FloatingPointError when the loss is
        not finite.
        """
        fit = self._under_way()
        z = torch.empty(0)
        for _ in range(count):
            anchor, positive = memory.sample_pairs(self._rng, self._batch, fit.window_steps)
            z, near = self.encoder(torch.from_numpy(anchor)), self.encoder(torch.from_numpy(positive))
            loss = info_nce(z, near, fit.temperature, self._similarity)
            if not torch.isfinite(loss):
                raise FloatingPointError(f"the encoder's loss is {loss.item()} after {fit.updates} updates")
            self._optimiser.zero_grad()
            loss.backward()
            self._optimiser.step()
            fit.updates += 1
            z, near = z.detach(), near.detach()
            self._recent.append(_Recent(loss.item(), self._accuracy(z, near), alignment(z, near).item()))
            if enough():
                break
        if not count:
            return {}
        means = np.mean(self._recent, axis=0).tolist()
        return {**_Recent(*means)._asdict(), "uniformity": uniformity(z).item()}

    def end_fit(self, blend: float = 1.0) -> None:
        """Close the fit: weights = (1 - blend) * old + blend * new (eq. 13); 1 keeps the new ones.

        Raises ValueError unless 0 < blend <= 1, and RuntimeError outside a fit.
        """
        if not 0 < blend <= 1:
            raise ValueError(f"blend must lie in (0, 1], got {blend}")
        self._under_way()
        if blend < 1:
            new = self.encoder.state_dict()
            self.encoder.load_state_dict(
                {name: torch.lerp(self._old[name], new[name], blend) for name in new}
            )
        self._fit = None
        self._old = {}

    def state(self) -> dict[str, Any]:
        """Weights, optimiser, random numbers and the fit under way; for torch.load(weights_only=True)."""
        return copy.deepcopy(
            {
                "encoder": dict(self.encoder.state_dict()),
                "old": dict(self._old),
                "optimiser": self._optimiser.state_dict(),
                "rng": rng_state.dump(self._rng),
                "fit": asdict(self._fit) if self._fit else None,
            }
        )

    def restore(self, state: dict[str, Any]) -> None:
        """Go on exactly where `state` was taken. Raises RuntimeError for another network's weights."""
        state = copy.deepcopy(state)
        self.encoder.load_state_dict(state["encoder"])
        self._old = state["old"]
        self._optimiser = self._fresh_optimiser()
        self._optimiser.load_state_dict(state["optimiser"])
        rng_state.load(self._rng, state["rng"])
        self._fit = _Fit(**state["fit"]) if state["fit"] else None
        self._recent.clear()

    def _fresh_optimiser(self) -> torch.optim.Adam:
        return torch.optim.Adam(self.encoder.parameters(), lr=self._learning_rate)

    def _under_way(self) -> _Fit:
        if self._fit is None:
            raise RuntimeError("no fit is under way; call begin_fit first")
        return self._fit

    def _accuracy(self, z: Tensor, near: Tensor) -> float:
        best = similarities(z, near, self._similarity).argmax(dim=1)
        return (best == torch.arange(len(z))).float().mean().item()
