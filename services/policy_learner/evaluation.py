"""The EVALUATE phase at the learner: legs come in, scores go out; nothing is trained."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from babble.scores import Legs, score
from protocol.messages import Phase, Score, Segment
from services.policy_learner.config import PolicyWorkConfig

Mode = Literal["mean", "sampled"]
MODES: tuple[Mode, ...] = ("mean", "sampled")
_DTYPES = {
    "posture": np.float32,
    "latent": np.float32,
    "goal": np.int32,
    "external_reward": np.float32,
    "side": np.float32,
}
LEG_ARRAYS = ("posture", "latent", "goal")
"""What legs cannot be scored without."""
_Arrays = dict[str, NDArray[np.generic]]


class Evaluation:
    """Collects the legs of one term, first with mean and then with sampled actions."""

    def __init__(
        self, config: PolicyWorkConfig, *, iteration: int, phase: Phase, versions: tuple[int, int]
    ) -> None:
        """`phase` is the phase whose result is measured; `versions` are (encoder, policy)."""
        self._config = config
        self._iteration = iteration
        self._phase = phase
        self.versions = versions
        self._legs: dict[Mode, list[_Arrays]] = {mode: [] for mode in MODES}
        self.scores: list[Score] = []

    @property
    def want(self) -> Mode:
        """The kind of actions that is still too few."""
        return next((mode for mode in MODES if self._missing(mode) > 0), "sampled")

    @property
    def done_columns(self) -> int:
        """Columns measured, of both kinds."""
        return sum(min(self._columns(mode), self._config.evaluation.columns) for mode in MODES)

    @property
    def wanted_columns(self) -> int:
        """Columns to measure, of both kinds."""
        return len(MODES) * self._config.evaluation.columns

    def missing_columns(self) -> int:
        """Columns still wanted of the kind that is wanted now."""
        return self._missing(self.want)

    def take(self, segment: Segment) -> bool:
        """Add the legs of a segment; False if they are of no use."""
        mode = segment.policy
        if mode == "random" or (segment.encoder_version, segment.policy_version) != self.versions:
            return False
        if self._missing(mode) <= 0 or not all(name in segment.arrays for name in LEG_ARRAYS):
            return False
        legs = {name: np.array(segment.arrays[name]) for name in _DTYPES if name in segment.arrays}
        self._check(segment, legs)
        self._add(mode, legs)
        return True

    def _check(self, segment: Segment, legs: Mapping[str, NDArray[np.generic]]) -> None:
        """Raises ValueError for legs that cannot be scored together with the others."""
        frame, d = (self._config.evaluation.legs, segment.columns), self._config.latent_dim
        shapes = {"posture": (*frame, self._config.posture_size), "latent": (*frame, d)}
        for name, array in legs.items():
            values, shape = array.astype(np.float64), shapes.get(name, frame)
            if values.shape != shape or not np.isfinite(values).all():
                raise ValueError(f"{name} must be finite numbers of shape {shape}, got shape {values.shape}")
        if not np.isin(legs["goal"], np.arange(d)).all():
            raise ValueError(f"goals must be vertices 0 to {d - 1}")

    def state(self) -> dict[str, object]:
        """What was measured so far, as plain lists for a checkpoint."""
        return {
            "iteration": self._iteration,
            "phase": self._phase.value,
            "versions": list(self.versions),
            "legs": {
                mode: [{name: array.tolist() for name, array in legs.items()} for legs in taken]
                for mode, taken in self._legs.items()
            },
        }

    @classmethod
    def restored(cls, config: PolicyWorkConfig, state: Mapping[str, Any]) -> "Evaluation":
        """The evaluation that `state()` described."""
        encoder_version, policy_version = state["versions"]
        evaluation = cls(
            config,
            iteration=state["iteration"],
            phase=Phase(state["phase"]),
            versions=(encoder_version, policy_version),
        )
        for mode in MODES:
            for legs in state["legs"][mode]:
                evaluation._add(mode, {name: np.asarray(legs[name], _DTYPES[name]) for name in legs})
        return evaluation

    def _add(self, mode: Mode, legs: _Arrays) -> None:
        self._legs[mode].append(legs)
        if self._missing(mode) <= 0:
            self.scores.append(self._score(mode))

    def _columns(self, mode: Mode) -> int:
        return sum(legs["goal"].shape[1] for legs in self._legs[mode])

    def _missing(self, mode: Mode) -> int:
        return self._config.evaluation.columns - self._columns(mode)

    def _score(self, mode: Mode) -> Score:
        taken = self._legs[mode]
        joined = {
            name: np.concatenate([legs[name] for legs in taken], axis=1)[:, : self._config.evaluation.columns]
            for name in _DTYPES
            if all(name in legs for legs in taken)
        }
        part = self._config.part
        found = score(
            part.cut(Legs(**joined)),
            diameter=part.diameter,
            crossing_axis=part.crossing_axis,
            landmarks=part.landmarks,
        )
        legs, columns = joined["goal"].shape
        return Score(
            run=self._config.run,
            block=self._config.block,
            iteration=self._iteration,
            phase=self._phase,
            policy=mode,
            steps=legs * columns * self._config.evaluation.leg_steps,
            encoder_version=self.versions[0],
            policy_version=self.versions[1],
            **found,
        )
