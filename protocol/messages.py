"""The message types. Each is one frame on the wire; SPEC.md lists who sends and who hears it.

Every message of a run carries the same five fields, `Header`: run, term, block, life, seq.
Counts are totals since the sender's life began, never increments, so that hearing a message
twice or losing one does no harm.
"""

from collections.abc import Mapping
from enum import StrEnum
from typing import Annotated, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, StringConstraints

NAME_PATTERN = "[a-z0-9][a-z0-9_-]{0,63}"
Name = Annotated[str, StringConstraints(pattern=f"^{NAME_PATTERN}$")]
"""A run, block, life or consumer: it becomes one chunk of a key expression."""
MAX_COUNT = 2**53
"""What a count may be; exact in every language's numbers."""
Count = Annotated[int, Field(ge=0, le=MAX_COUNT)]
Text = Annotated[str, StringConstraints(max_length=2000)]
Label = Annotated[str, StringConstraints(max_length=200)]
"""The name of a total, a metric, a version or a reason."""
Finite = Annotated[float, Field(allow_inf_nan=False)]
"""A score: a NaN or an infinity would win or lose comparisons without a word. Metrics may be both."""
Fingerprint = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{16}$")]
Digest = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
Arrays = Mapping[str, NDArray[np.generic]]

ALL_BLOCKS = "all"
"""The block name of messages that concern the whole run (phase, status, command)."""
RECORDER = "recorder"
"""The consumer of the states of a whole body, which nobody learns from."""

MAX_ENTRIES = 256
"""The most entries of a list or map in a header; bounds memory, far above any real use."""
MAX_REPLY_CHARS = 1 << 18
MAX_CONFIG_CHARS = 1 << 20
MAX_STEPS = 1 << 20
"""The most steps per column of a segment."""


class Phase(StrEnum):
    """The phases of the Composer's training loop (thesis 3.3), and the end."""

    BABBLE = "babble"
    ENCODE = "encode"
    GROUND = "ground"
    WALK = "walk"
    REFINE = "refine"
    PRACTISE = "practise"
    EVALUATE = "evaluate"
    DONE = "done"


_PHASES = {str(phase): phase for phase in Phase}


def _phase_of_text(value: object) -> object:
    return _PHASES.get(value, value) if isinstance(value, str) else value


PhaseText = Annotated[Phase, BeforeValidator(_phase_of_text)]
"""A phase that is given as itself or by its text, and by nothing else."""


class Strict(BaseModel):
    """Frozen, with unknown fields refused and nothing converted: "1" is no number, 1 is no truth value."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class Header(Strict):
    """The fields of every message."""

    kind: ClassVar[str]
    carries_arrays: ClassVar[bool] = False

    run: Name
    term: Count
    """Grows at each phase change; says which announcement of the coordinator this belongs to."""
    block: Name
    life: Name
    """The sender's name, new at each process start."""
    seq: Count
    """Counts the sender's messages of this stream from 0, without gaps."""


class WithArrays(Header):
    """A message whose header is followed by named arrays."""

    model_config = ConfigDict(arbitrary_types_allowed=True)
    carries_arrays: ClassVar[bool] = True
    arrays: Arrays = Field(default_factory=dict, exclude=True, repr=False)

    def __eq__(self, other: object) -> bool:
        """Same kind, same header, and arrays of the same names, types, shapes and bytes."""
        if type(self) is not type(other) or not isinstance(other, WithArrays):
            return False
        return (
            self.model_dump() == other.model_dump()
            and self.arrays.keys() == other.arrays.keys()
            and all(_same(array, other.arrays[name]) for name, array in self.arrays.items())
        )

    def __hash__(self) -> int:
        return hash((self.kind, self.run, self.block, self.life, self.seq))


def _same(a: NDArray[np.generic], b: NDArray[np.generic]) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


class Segment(WithArrays):
    """Experience: `steps` steps of a block in `columns` worlds, for one consumer.

    A step of a block on a higher level lasts several of the environment, as the run's settings say.
    The arrays by phase, as contents.py checks them (T = steps, E = columns, L = evaluation legs,
    d = latent dimension):

    - BABBLE, WALK: observation (T, E, ...) float32, image (T, E, ...) uint8 or both; episode (T, E) int32.
    - GROUND, PRACTISE: latent, next_latent, goal (T, E, d), action (T, E, a), log_prob (T, E)
      float32; truncated, terminated (T, E) uint8; and perhaps external_reward (T, E) float32.
    - EVALUATE: posture (L, E, p), latent (L, E, d) float32, goal (L, E) int32, and perhaps
      start_posture (E, p) and external_reward (L, E) float32.

    For the consumer `RECORDER`, of `ALL_BLOCKS`, a step is one of the environment in every phase: state
    (T, E, s) float32, episode (T, E) int32, perhaps external_reward (T, E) float32, and for each block that
    acts on a latent "latent/<block>" and "goal/<block>" (T, E, d) float32, with a d of its own.
    """

    kind: ClassVar[str] = "segment"
    consumer: Name
    fingerprint: Fingerprint
    phase: PhaseText
    level: Count = 0
    iteration: Count = 0
    """Of the announcement under which it was made, as is the level."""
    encoder_version: Count = 0
    policy_version: Count = 0
    """The policy version that acted in this segment."""
    policy: Literal["random", "sampled", "mean"] = "random"
    steps: Annotated[int, Field(ge=1, le=MAX_STEPS)]
    columns: Annotated[int, Field(ge=1, le=2**16)]
    first_step: Count
    """Steps of the block per column that this life had done in this term before the segment.

    For the recorder: environment steps per column that this life had done, in all its terms, before the
    first row; each row is as many later as the run's settings say (`recording.every_steps`).
    """


class Ack(Header):
    """A consumer's word to one sender: what it holds safely, and what it wants next."""

    kind: ClassVar[str] = "ack"
    to: Name
    consumer: Name
    upto: Count
    """All segments with seq < upto of (to, block) are held safely; cumulative."""
    granted: Count
    """The sender may publish segments with seq < granted in this term."""
    policy_floor: Count = 0
    """The experience is wanted from this policy version or a newer one."""
    want: Literal["random", "sampled", "mean"] = "random"
    progress: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    """The share of what the consumer wants in this term that it holds, of all senders."""


class Model(WithArrays):
    """One version of an encoder or a policy: arrays = {"onnx": (n,) uint8}."""

    kind: ClassVar[str] = "model"
    model: Literal["encoder", "policy"]
    version: Annotated[int, Field(ge=1, le=MAX_COUNT)]
    encoder_version: Count
    """The encoder that this model is, or that this policy was trained on."""
    fingerprint: Fingerprint
    digest: Digest
    """SHA-256 of the ONNX bytes."""


class ModelFloor(Strict):
    """The least versions with which a block may work in a term."""

    encoder: Count = 0
    policy: Count = 0


class Frozen(ModelFloor):
    """The models of a block that is done: the versions to act with, at least, and whose work they are.

    A version may hold an older one's ONNX: the block is frozen at the iteration that scored best, and
    versions only grow.
    """

    of_encoder: Count = 0
    of_policy: Count = 0


class PhaseAnnounced(Header):
    """The coordinator's word on what all do now; repeated each second, the newest term wins."""

    kind: ClassVar[str] = "phase"
    phase: PhaseText
    level: Count = 0
    iteration: Count = 0
    """0 for the initialization (3.3.1), then 1..N for the rounds of the loop (3.3.2)."""
    iterations: Count = 0
    evaluates: PhaseText | None = None
    """For EVALUATE: the phase whose result is measured."""
    blocks: Annotated[dict[Name, ModelFloor], Field(max_length=MAX_ENTRIES)]
    """The blocks at work in this term."""
    frozen: Annotated[dict[Name, Frozen], Field(max_length=MAX_ENTRIES)] = {}
    """The blocks of the levels below, which are done."""


class SettingsAnnounced(Header):
    """The coordinator's word on what the whole run is made with, for actors that have only its name."""

    kind: ClassVar[str] = "settings"
    config: Annotated[str, StringConstraints(max_length=MAX_CONFIG_CHARS, pattern=r"^[ -~]*$")]
    """All settings of the run, as the text of a JSON object in printable ASCII."""
    began_ms: Count
    """When the run began (Unix time); another number is another run of the same name."""


class Score(Strict):
    """What an evaluation of one block found; the formulas are in babble/scores.py."""

    run: Name
    block: Name
    iteration: Count
    phase: PhaseText
    separation: Finite
    separation_worst: Finite
    z_min: Finite
    z_goal: Finite
    switch_success: Finite
    crossing: Finite | None = None
    landmarks: Annotated[dict[Label, Finite], Field(max_length=MAX_ENTRIES)] = {}
    """The share of legs that ended at each landmark of the body, where it has any."""
    landmark_vertices: Annotated[dict[Label, Count], Field(max_length=MAX_ENTRIES)] = {}
    """The vertex that stands for a landmark; one that was never reached has none."""
    external_reward: Finite | None = None
    """Per step; None where there is no task."""
    external_reward_by_vertex: Annotated[list[Finite | None], Field(max_length=MAX_ENTRIES)] | None = None
    policy: Literal["mean", "sampled"]
    steps: Count
    encoder_version: Count = 0
    policy_version: Count = 0


class Progress(Strict):
    """How far a learner is with one block's work in the current term."""

    block: Name
    done: Count
    wanted: Count
    unit: Literal["steps", "updates", "columns"]
    finished: bool = False
    """True once the work is done, checkpointed, and its model version published."""


class Status(Header):
    """Health and progress of one process, each second and at each change that matters."""

    kind: ClassVar[str] = "status"
    service: Name
    phase: PhaseText | None = None
    versions: Annotated[dict[Label, Count], Field(max_length=MAX_ENTRIES)] = {}
    """Model versions held, by "encoder/<block>" and "policy/<block>"."""
    totals: Annotated[dict[Label, Count], Field(max_length=MAX_ENTRIES)] = {}
    """Totals of this life by name: env_steps, segments, updates, resent, stale, dropped..."""
    progress: Annotated[list[Progress], Field(max_length=MAX_ENTRIES)] = []
    scores: Annotated[list[Score], Field(max_length=MAX_ENTRIES)] = []
    """The scores found in this term (EVALUATE)."""
    metrics: Annotated[dict[Label, float], Field(max_length=MAX_ENTRIES)] = {}
    """The newest measurements: losses, rates, lag, memory, CPU seconds."""
    queue_depth: Count = 0
    lost: Count = 0
    duplicated: Count = 0
    refused: Annotated[dict[Label, Count], Field(max_length=MAX_ENTRIES)] = {}
    """Refused frames by reason."""
    waiting_for: Text = ""
    last_error: Text = ""


class View(WithArrays):
    """A picture for people: latents, poses or images. Best effort, never a brake.

    Of E columns at one moment, and of the way of the first of them there, K steps, the newest last; the
    arrays as contents.py checks them, float32 but for pixels:

    - latent, of one block: latent (E, d), and perhaps goal (E, d), posture (E, p), trail (K, d), path (K, p).
    - posture, where there is no latent yet: posture (E, p), and perhaps path (K, p).
    - pose, of the first column: position (B, 3) and quaternion (B, 4; w first) of all bodies of its model,
      and perhaps touch (N,), the forces on the skin in newton.
    - image, what the first column sees with one eye: pixels (H, W, 3) uint8.
    """

    kind: ClassVar[str] = "view"
    view: Literal["latent", "posture", "pose", "image"]
    env_step: Count = 0
    """Environment steps per column of the sender's life."""
    title: Text = ""
    """image: which eye"""


class Command(Header):
    """A question with a deadline. Doing it twice (same id) is the same as doing it once."""

    kind: ClassVar[str] = "command"
    id: Name
    name: Literal["stop", "describe"]


class Reply(Header):
    """The answer to a command; an empty or missing one is a failure."""

    kind: ClassVar[str] = "reply"
    id: Name
    ok: bool
    text: Annotated[str, StringConstraints(max_length=MAX_REPLY_CHARS)] = ""


Message = Segment | Ack | Model | PhaseAnnounced | SettingsAnnounced | Status | View | Command | Reply
MESSAGES: dict[str, type[Header]] = {
    m.kind: m for m in (Segment, Ack, Model, PhaseAnnounced, SettingsAnnounced, Status, View, Command, Reply)
}
