"""One block's policy learning: PPO in GROUND and PRACTISE, scores in EVALUATE (thesis 3.2, 3.3)."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from babble.policy.act import PolicyModel
from babble.policy.export import export_policy
from babble.policy.ppo import GoalPPO
from protocol.messages import Phase, PhaseAnnounced, Progress, Score, Segment
from services.policy_learner.config import PRACTISES, PolicyWorkConfig
from services.policy_learner.evaluation import Evaluation
from services.policy_learner.rollouts import RolloutHand
from services.runtime.intake import Want
from services.runtime.models import ModelKind, ModelOffer

ROLLOUT_ARRAYS = ("latent", "next_latent", "goal", "action", "log_prob", "truncated", "terminated")
EXTERNAL_REWARD = "external_reward"
"""Also needed where it has a weight."""


class PolicyWork:
    """The `Work` of one policy."""

    kind: ModelKind = "policy"

    def __init__(self, config: PolicyWorkConfig) -> None:
        self.block = config.block
        self._config = config
        self._ppo = _new_ppo(config)
        self._hand = RolloutHand(config.policy.rollout_columns, config.policy.max_policy_lag)
        self._evaluation: Evaluation | None = None
        self._phase: Phase | None = None
        self._encoder_version = 0
        self._version = 0
        self._updates_done = 0
        self._updates_total = 0
        self._frozen: bytes | None = None
        self._offer: ModelOffer | None = None
        self._metrics: dict[str, float] = {}

    def begin(self, announced: PhaseAnnounced) -> None:
        """Start a term: training on the announced encoder, or an evaluation."""
        self._phase = announced.phase
        self._hand.clear()
        if announced.phase in PRACTISES:
            self._encoder_version = announced.blocks[self.block].encoder
            self._updates_done = 0
            self._ppo.reset_optimiser()
            self._make_version()
        elif announced.phase is Phase.EVALUATE:
            self._evaluation = Evaluation(
                self._config,
                iteration=announced.iteration,
                phase=announced.evaluates or Phase.PRACTISE,
                versions=(self._encoder_version, self._version),
            )

    def take(self, segment: Segment) -> bool:
        """Take columns for PPO, or legs for the evaluation."""
        if self._phase is Phase.EVALUATE and self._evaluation is not None:
            return self._evaluation.take(segment)
        if (
            self._phase not in PRACTISES
            or self._done()
            or segment.encoder_version != self._encoder_version
            or not all(name in segment.arrays for name in ROLLOUT_ARRAYS)
        ):
            return False
        wanted = (*ROLLOUT_ARRAYS, EXTERNAL_REWARD) if self._config.external else ROLLOUT_ARRAYS
        if not segment.arrays.keys() >= set(wanted):
            raise ValueError(
                f"it has no {EXTERNAL_REWARD}, to which this run's goals.external_weight gives a weight of "
                f"{self._config.goals.external_weight:g}; start its actor with this run's config.toml"
            )
        arrays = {name: segment.arrays[name] for name in wanted}
        self._check(segment, arrays)
        self._hand.add(arrays, segment.policy_version)
        return True

    def advance(self) -> bool:
        """One PPO update, if a rollout is in hand."""
        if self._phase not in PRACTISES or self._done():
            return False
        self._hand.drop_older_than(self._version)
        ready = self._hand.rollout()
        if ready is None:
            return False
        rollout, versions = ready
        lags = self._version - np.asarray(versions)
        found = self._ppo.update(rollout)
        self._metrics = {f"{self.block}/policy/{name}": value for name, value in found.items()}
        self._metrics[f"{self.block}/policy/lag_mean"] = float(lags.mean())
        self._metrics[f"{self.block}/policy/lag_max"] = float(lags.max())
        self._updates_done += 1
        self._updates_total += 1
        self._make_version()
        return True

    def wanted_columns(self) -> int:
        """Columns that the next update, or the evaluation, still lacks."""
        if self._phase is Phase.EVALUATE and self._evaluation is not None:
            return max(0, self._evaluation.missing_columns())
        if self._phase not in PRACTISES or self._done():
            return 0
        return max(0, self._config.policy.rollout_columns - self._hand.columns)

    def request(self) -> tuple[Want, int]:
        """Sampled actions of the newest version for PPO; mean, then sampled ones for EVALUATE."""
        if self._phase is Phase.EVALUATE and self._evaluation is not None:
            return self._evaluation.want, self._version
        return "sampled", self._version

    def progress(self) -> Progress | None:
        """Environment steps trained on, or columns measured."""
        if self._phase is Phase.EVALUATE and self._evaluation is not None:
            return Progress(
                block=self.block,
                done=self._evaluation.done_columns,
                wanted=self._evaluation.wanted_columns,
                unit="columns",
            )
        if self._phase in PRACTISES:
            wanted = self._config.updates(self._phase)
            steps = self._config.rollout_steps(self._phase)
            return Progress(
                block=self.block, done=self._updates_done * steps, wanted=wanted * steps, unit="steps"
            )
        return None

    def model(self) -> ModelOffer | None:
        """The newest policy."""
        return self._offer

    def scores(self) -> Sequence[Score]:
        """What the evaluation of this term found so far."""
        if self._phase is not Phase.EVALUATE or self._evaluation is None:
            return ()
        return self._evaluation.scores

    def metrics(self) -> Mapping[str, float]:
        """Losses, KL, clip fraction, entropy, reward and policy lag of the last update."""
        return self._metrics

    def totals(self) -> Mapping[str, int]:
        """Updates of the policy, and columns too old for it, since the run began."""
        return {
            f"{self.block}/policy_updates": self._updates_total,
            f"{self.block}/too_old_columns": self._hand.too_old,
        }

    def freeze(self, version: int, onnx: bytes) -> None:
        """Offer this policy as `version` and learn no more. Raises ValueError for another block's."""
        model = PolicyModel(onnx)
        found, own = (
            (model.latent_dim, model.action_size),
            (self._config.latent_dim, self._config.action_size),
        )
        if found != own:
            raise ValueError(
                f"it sets {found[1]} numbers by a latent of {found[0]}, and the block's policy {own[1]} by "
                f"one of {own[0]}"
            )
        self._phase = None
        self._evaluation = None
        self._hand.clear()
        self._version, self._frozen = version, onnx
        self._offer = self._as_offer()

    def state(self) -> bytes:
        """Weights, optimiser, columns in hand, random state and counts."""
        buffer = io.BytesIO()
        torch.save(
            {
                "phase": None if self._phase is None else self._phase.value,
                "encoder_version": self._encoder_version,
                "version": self._version,
                "updates_done": self._updates_done,
                "updates_total": self._updates_total,
                "ppo": self._ppo.state(),
                "hand": [
                    (version, {name: torch.from_numpy(array) for name, array in columns.items()})
                    for version, columns in self._hand.state()
                ],
                "too_old": self._hand.too_old,
                "evaluation": None if self._evaluation is None else self._evaluation.state(),
                "offered": self._offer is not None,
                "frozen": self._frozen,
            },
            buffer,
        )
        return buffer.getvalue()

    def restore(self, state: bytes) -> None:
        """Go on from a state; nothing in it is unpickled as code."""
        saved: dict[str, Any] = torch.load(io.BytesIO(state), weights_only=True)
        self._phase = None if saved["phase"] is None else Phase(saved["phase"])
        self._encoder_version = saved["encoder_version"]
        self._version = saved["version"]
        self._updates_done = saved["updates_done"]
        self._updates_total = saved["updates_total"]
        self._ppo.restore(saved["ppo"])
        self._hand.restore(
            [(version, {n: t.numpy() for n, t in columns.items()}) for version, columns in saved["hand"]]
        )
        self._hand.too_old = saved["too_old"]
        if saved["evaluation"] is not None:
            self._evaluation = Evaluation.restored(self._config, saved["evaluation"])
        self._frozen = saved["frozen"]
        if saved["offered"]:
            self._offer = self._as_offer()

    def _check(self, segment: Segment, arrays: Mapping[str, NDArray[np.generic]]) -> None:
        """Raises ValueError for arrays that do not fit this block's rollouts."""
        frame = (self._config.segment_steps, segment.columns)
        sizes = {
            "latent": self._config.latent_dim,
            "next_latent": self._config.latent_dim,
            "goal": self._config.latent_dim,
            "action": self._config.action_size,
        }
        for name, array in arrays.items():
            shape = (*frame, sizes[name]) if name in sizes else frame
            if array.shape != shape or not np.isfinite(array.astype(np.float64)).all():
                raise ValueError(f"{name} must be finite numbers of shape {shape}, got shape {array.shape}")

    def _done(self) -> bool:
        return self._phase in PRACTISES and self._updates_done >= self._config.updates(self._phase)

    def _make_version(self) -> None:
        self._version += 1
        self._offer = self._as_offer()

    def _as_offer(self) -> ModelOffer:
        return ModelOffer(
            kind="policy",
            version=self._version,
            encoder_version=self._encoder_version,
            onnx=export_policy(self._ppo, self.block) if self._frozen is None else self._frozen,
            keep=self._done() or self._frozen is not None,
        )


def _new_ppo(config: PolicyWorkConfig) -> GoalPPO:
    policy = config.policy
    return GoalPPO(
        config.latent_dim,
        config.action_size,
        hidden=tuple(policy.hidden),
        learning_rate=policy.learning_rate,
        steps=config.segment_steps,
        columns=policy.rollout_columns,
        epochs=policy.epochs,
        minibatch=policy.minibatch,
        discount=policy.discount,
        gae_lambda=policy.gae_lambda,
        clip=policy.clip,
        entropy_weight=policy.entropy_weight,
        value_weight=policy.value_weight,
        max_grad_norm=policy.max_grad_norm,
        log_std=policy.log_std,
        seed=config.seed,
        reward_form=config.goals.reward,
        sparse_radius=config.goals.sparse_radius,
        goal_weight=config.goals.goal_weight,
        external_weight=config.goals.external_weight,
    )
