"""Adam (Kingma & Ba 2015) for a learner that starts fast.

The first use of any torch.optim optimiser imports torch's compiler: 5 CPU seconds and 90 MB per
process, more than all the rest of a learner's start, for nothing that is used here, and torch has
no switch for it. This is the same rule (a test compares them); it offers what Stable-Baselines3 uses.
"""

from collections.abc import Iterable
from typing import Any

import torch
from torch import Tensor

BETA_MEAN = 0.9
BETA_SQUARE = 0.999


class Adam:
    """Adam over parameters that all have gradients at each step."""

    def __init__(self, params: Iterable[Tensor], lr: float = 1e-3, eps: float = 1e-8) -> None:
        self._params = list(params)
        self._eps = eps
        self._steps = 0
        self._means = [torch.zeros_like(p) for p in self._params]
        self._squares = [torch.zeros_like(p) for p in self._params]
        self.param_groups: list[dict[str, Any]] = [{"params": self._params, "lr": lr}]
        """one group; its "lr" may be changed"""

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for param in self._params:
            param.grad = None

    def step(self) -> None:
        """Move the parameters along their gradients. Raises RuntimeError where one has none."""
        if any(param.grad is None for param in self._params):
            raise RuntimeError("a parameter has no gradient; call backward on a loss that needs them all")
        self._steps += 1
        rate = self.param_groups[0]["lr"] / (1 - BETA_MEAN**self._steps)
        correction = (1 - BETA_SQUARE**self._steps) ** 0.5
        with torch.no_grad():
            for param, mean, square in zip(self._params, self._means, self._squares, strict=True):
                mean.lerp_(param.grad, 1 - BETA_MEAN)
                square.mul_(BETA_SQUARE).addcmul_(param.grad, param.grad, value=1 - BETA_SQUARE)
                param.addcdiv_(mean, square.sqrt().div_(correction).add_(self._eps), value=-rate)

    def state_dict(self) -> dict[str, Any]:
        """The moments and the step count; not the learning rate, which is a setting."""
        return {"steps": self._steps, "means": self._means, "squares": self._squares}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Take over copies of the moments and the count. Raises ValueError for other parameters' moments."""
        shapes = [param.shape for param in self._params]
        if any([moment.shape for moment in state[name]] != shapes for name in ("means", "squares")):
            raise ValueError("the optimiser's state belongs to other parameters")
        self._steps = state["steps"]
        self._means = [moment.clone() for moment in state["means"]]
        self._squares = [moment.clone() for moment in state["squares"]]
