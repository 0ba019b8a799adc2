"""One block's encoder learning: collect in BABBLE and WALK, fit in ENCODE and REFINE (thesis 3.3)."""

import io
from collections.abc import Mapping, Sequence
from typing import Any

import torch

from babble.encoder.export import export_encoder
from babble.encoder.network import Encoder
from babble.encoder.training import EncoderTrainer
from babble.memory import EPISODES, ExperienceMemory
from babble.policy.act import EncoderModel
from protocol.messages import Phase, PhaseAnnounced, Progress, Score, Segment
from services.encoder_learner.config import COLLECTS, FITS, EncoderWorkConfig
from services.runtime.clock import Clock
from services.runtime.errors import UserError
from services.runtime.intake import Want
from services.runtime.models import ModelKind, ModelOffer

QUANTUM_UPDATES = 25
"""Updates between two looks at the inbox, at most: some 50 ms without vision."""
QUANTUM_SECS = 0.1
"""No update is begun so long after the first one: with vision too, acks and heartbeats keep flowing."""


class EncoderWork:
    """The `Work` of one encoder."""

    kind: ModelKind = "encoder"

    def __init__(self, config: EncoderWorkConfig, clock: Clock) -> None:
        """The clock only says when to look at the inbox again; nothing that is learned depends on it."""
        self.block = config.block
        self._config = config
        self._clock = clock
        self._memory = ExperienceMemory(config.senses)
        # Made at once: a process's first optimiser costs torch seconds, which pass while actors babble.
        self._trainer = _new_trainer(config)
        self._scaled = False
        self._phase: Phase | None = None
        self._version = 0
        self._updates_done = 0
        self._updates_total = 0
        self._fitted = False
        self._streams: dict[str, tuple[int, int]] = {}
        """By life: the stream it is in, and the step that follows in it."""
        self._offer: ModelOffer | None = None
        self._metrics: dict[str, float] = {}

    def begin(self, announced: PhaseAnnounced) -> None:
        """Start a term: an empty memory to collect into, or a fit of what was collected."""
        self._phase = announced.phase
        if announced.phase in COLLECTS:
            self._memory.clear()
            self._streams.clear()
        elif announced.phase in FITS:
            fit = self._config.fit(announced.phase)
            self._check_pairs(fit.updates)
            self._updates_done = 0
            self._fitted = False
            if not self._scaled:
                self._trainer.encoder.normalise(*self._memory.scaling())
                self._scaled = True
            self._trainer.begin_fit(window_steps=fit.window_steps, temperature=fit.temperature)

    def take(self, segment: Segment) -> bool:
        """Add observations; anything beyond what the phase wants is still welcome.

        Raises ValueError for what does not fit the senses or the earlier segments of its sender.
        """
        if self._phase not in COLLECTS or EPISODES not in segment.arrays:
            return False
        parts = {part: array for part, array in segment.arrays.items() if part != EPISODES}
        stream = self._stream_of(segment)
        self._memory.extend(f"{segment.life}/{stream}", parts, segment.arrays[EPISODES])
        self._streams[segment.life] = stream, segment.first_step + segment.steps
        return True

    def _stream_of(self, segment: Segment) -> int:
        """The number of the stream that this segment belongs to.

        Where steps are missing (another block was granted, this one was not; or a segment could not be
        used), a new one begins, so that positives (eq. 4) are never taken across a gap.
        """
        stream, expected = self._streams.get(segment.life, (0, segment.first_step))
        return stream if segment.first_step == expected else stream + 1

    def advance(self) -> bool:
        """A few updates of the encoder, if this is a fit and not done."""
        if self._phase not in FITS:
            return False
        wanted = self._config.fit(self._phase).updates
        count = min(QUANTUM_UPDATES, wanted - self._updates_done)
        if count > 0:
            self._update(count)
        if self._updates_done < wanted:
            return True
        if not self._fitted:
            self._end_fit(self._phase)
        return False

    def wanted_columns(self) -> int:
        """What is still to collect, in columns of `segment_steps` rows."""
        if self._phase not in COLLECTS:
            return 0
        missing = self._config.rows(self._phase) - self._memory.steps
        return max(0, -(-missing // self._config.segment_steps))

    def request(self) -> tuple[Want, int]:
        """Random walk in BABBLE, sampled actions in WALK; any policy version does."""
        return ("sampled" if self._phase is Phase.WALK else "random"), 0

    def progress(self) -> Progress | None:
        """Environment steps collected, or updates done."""
        if self._phase in COLLECTS:
            return Progress(
                block=self.block,
                done=self._memory.steps * self._config.steps_per_row[self._phase],
                wanted=self._config.steps[self._phase],
                unit="steps",
            )
        if self._phase in FITS:
            # A fit of no updates still has the work of publishing: it counts as one.
            wanted = max(1, self._config.fit(self._phase).updates)
            done = wanted if self._fitted else min(self._updates_done, wanted - 1)
            return Progress(block=self.block, done=done, wanted=wanted, unit="updates")
        return None

    def model(self) -> ModelOffer | None:
        """The newest encoder."""
        return self._offer

    def scores(self) -> Sequence[Score]:
        """None: encoders are scored together with a policy."""
        return ()

    def metrics(self) -> Mapping[str, float]:
        """Loss, alignment and uniformity of the last updates."""
        return self._metrics

    def totals(self) -> Mapping[str, int]:
        """Updates of the encoder since the run began."""
        return {f"{self.block}/encoder_updates": self._updates_total}

    def freeze(self, version: int, onnx: bytes) -> None:
        """Offer this encoder as `version` and learn no more. Raises ValueError for another block's."""
        model = EncoderModel(onnx)
        encoder = self._trainer.encoder
        found = model.observation_size, model.latent_dim
        if found != (encoder.observation_size, self._config.latent_dim):
            raise ValueError(
                f"it makes {found[1]} numbers of {found[0]}, and the block's encoder makes "
                f"{self._config.latent_dim} of {encoder.observation_size}"
            )
        self._phase = None
        self._memory.clear()
        self._streams.clear()
        self._version = version
        self._offer = self._as_offer(onnx)

    def state(self) -> bytes:
        """Weights, optimiser, memory, random state and counts."""
        buffer = io.BytesIO()
        torch.save(
            {
                "phase": None if self._phase is None else self._phase.value,
                "version": self._version,
                "updates_done": self._updates_done,
                "updates_total": self._updates_total,
                "fitted": self._fitted,
                "streams": self._streams,
                "memory": {name: torch.from_numpy(array) for name, array in self._memory.state().items()},
                "scaled": self._scaled,
                "trainer": self._trainer.state(),
                "onnx": None if self._offer is None else self._offer.onnx,
            },
            buffer,
        )
        return buffer.getvalue()

    def restore(self, state: bytes) -> None:
        """Go on from a state; nothing in it is unpickled as code."""
        saved: dict[str, Any] = torch.load(io.BytesIO(state), weights_only=True)
        self._phase = None if saved["phase"] is None else Phase(saved["phase"])
        self._version = saved["version"]
        self._updates_done = saved["updates_done"]
        self._updates_total = saved["updates_total"]
        self._fitted = saved["fitted"]
        self._streams = saved["streams"]
        self._memory.restore({name: tensor.numpy() for name, tensor in saved["memory"].items()})
        self._scaled = saved["scaled"]
        self._trainer.restore(saved["trainer"])
        if saved["onnx"] is not None:
            self._offer = self._as_offer(saved["onnx"])

    def _check_pairs(self, updates: int) -> None:
        """Raises `UserError` where there is nothing to contrast with one another."""
        if updates and not self._memory.has_pairs:
            raise UserError(
                f"the encoder of block {self.block} learns from steps that follow one another, and no "
                "episode that it was sent has two; give the world longer episodes (episode_steps)"
            )

    def _update(self, count: int) -> None:
        """Up to so many updates, fewer where they take long."""
        began_secs, before = self._clock.now_secs(), self._trainer.updates_done
        found = self._trainer.update(
            self._memory, count, lambda: self._clock.now_secs() - began_secs >= QUANTUM_SECS
        )
        self._metrics = {f"{self.block}/encoder/{name}": value for name, value in found.items()}
        done = self._trainer.updates_done - before
        self._updates_done += done
        self._updates_total += done

    def _end_fit(self, phase: Phase) -> None:
        """Blend (eq. 13; the first fit has nothing to blend with) and make the next version.

        What it was fitted on is let go: the next fit has a walk of its own, and checkpoints stay small.
        """
        self._memory.clear()
        self._streams.clear()
        self._trainer.end_fit(blend=1.0 if phase is Phase.ENCODE else self._config.encoder.blend)
        self._fitted = True
        self._version += 1
        self._offer = self._as_offer(export_encoder(self._trainer.encoder, self.block))

    def _as_offer(self, onnx: bytes) -> ModelOffer:
        return ModelOffer(
            kind="encoder", version=self._version, encoder_version=self._version, onnx=onnx, keep=True
        )


def _new_trainer(config: EncoderWorkConfig) -> EncoderTrainer:
    encoder = Encoder(
        config.senses,
        config.latent_dim,
        hidden=tuple(config.encoder.hidden),
        vision_features=config.encoder.vision_features,
        output=config.encoder.output,
        seed=config.seed,
    )
    return EncoderTrainer(
        encoder,
        learning_rate=config.encoder.learning_rate,
        batch=config.encoder.batch,
        similarity=config.encoder.similarity,
        seed=config.seed,
    )
