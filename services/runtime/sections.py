"""The tables of a scenario, one class each: frozen, with unknown keys refused.

Defaults come from the prototype's measurements and are argued in docs/operating.md.
"""

from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from protocol.messages import Name

Positive = Annotated[int, Field(ge=1)]
PositiveFloat = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]
Fraction = Annotated[float, Field(gt=0, le=1)]


class Section(BaseModel):
    """A table of the TOML file."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class WorldSettings(Section):
    """Which body, and its parameters (checked by babble.worlds)."""

    id: str = "Cuboid"
    parameters: dict[str, Any] = {}


class BlockSettings(Section):
    """One Composer block: what it observes, drives and how many vertices its simplex has."""

    name: Name = "body"
    latent_dim: Annotated[int, Field(ge=2, le=64)] = 2
    observes: list[int] | list[str] | None = None
    """Of the world's observation: indices, or patterns of names such as "position/*ff*"; None for all."""
    drives: list[int] | list[str] | None = None
    """Of the world's action: indices, or patterns of names such as "act:right_ff_*"; None for all."""
    children: list[Name] = []
    """Blocks below whose latents it observes and whose goals it sets (Hi-Composer)."""
    learner: Annotated[int, Field(ge=0)] | None = None
    """Index of the process of each kind that learns it; None deals the blocks of a level out in turn."""
    encoder: dict[str, Any] = {}
    """What of `[encoder]` is otherwise for this block."""
    policy: dict[str, Any] = {}
    """What of `[policy]` is otherwise for this block."""

    @field_validator("observes", "drives", mode="before")
    @classmethod
    def _are_alike(cls, parts: Any) -> Any:
        kinds = {type(part) for part in parts} if isinstance(parts, list) else {list}
        if parts is not None and kinds not in (set(), {int}, {str}):
            raise ValueError("must be a list of indices or a list of patterns of names")
        return parts


class LevelSettings(Section):
    """One `[[level]]`, from level 0 up: what is otherwise for its blocks than the run's tables say."""

    decision_steps: Positive | None = None
    """environment steps for which one action of the level holds; None for 1, 10, then 5 x the level below"""
    segment_steps: Annotated[int, Field(ge=2, le=65536)] | None = None
    """instead of `actors.segment_steps`"""
    phases: dict[str, Any] = {}
    babbling: dict[str, Any] = {}
    encoder: dict[str, Any] = {}
    policy: dict[str, Any] = {}
    goals: dict[str, Any] = {}
    evaluation: dict[str, Any] = {}


class LearnerSettings(Section):
    """How many processes of each kind share the blocks."""

    encoder: Positive = 1
    policy: Positive = 1


class ActorSettings(Section):
    """How many actors `babble up` starts, and how each works."""

    count: Positive = 2
    envs_per_actor: Annotated[int, Field(ge=1, le=4096)] = 8
    """worlds stepped together with one batched inference"""
    segment_steps: Annotated[int, Field(ge=2, le=65536)] = 128
    """steps of the block per world in one published segment; the rollout length of PPO"""
    window: Annotated[int, Field(ge=1, le=64)] = 4
    """segments sent and not yet acknowledged, at most: the back-pressure"""
    resend_secs: PositiveFloat = 1.0
    """an unacknowledged segment is sent again after this time"""


class PhaseSettings(Section):
    """How much of each phase (thesis 3.3); environment steps are summed over all worlds."""

    babble_steps: Positive = 20_000
    ground_steps: Positive = 32_768
    walk_steps: Positive = 16_000
    practise_steps: Positive = 12_288
    iterations: Annotated[int, Field(ge=0)] = 4
    open_loop: bool = False
    """nothing is learned: actors babble for `babble_steps`, which are recorded, and the run is done"""


class NoiseSettings(Section):
    """The random walk of the BABBLE phase."""

    kind: Literal["white", "pink", "ou", "held", "coloured"] = "ou"
    scale: PositiveFloat = 0.6
    """standard deviation of the action before clipping to the bounds"""
    correlation: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """OU only: u <- correlation * u + noise"""
    hold_steps: Positive = 10
    """held only: steps between new draws"""
    exponents: tuple[NonNegative, NonNegative] = (0.7, 0.9)
    """coloured only: beta of the spectrum 1/f^beta at the beginning and at the end of the phase"""
    block_steps: Annotated[int, Field(ge=2)] = 10_000
    """coloured only: steps of each world that are drawn at once"""
    subgoal_steps: tuple[Positive, Positive] = (20, 100)
    """above level 0, instead: environment steps for which each child keeps a random goal, least and most"""

    @property
    def drawn(self) -> dict[str, Any]:
        """What babble.noise.make_noise takes of these settings, by its names."""
        return self.model_dump(exclude={"subgoal_steps"})

    @model_validator(mode="after")
    def _least_is_first(self) -> "NoiseSettings":
        least, most = self.subgoal_steps
        if least > most:
            raise ValueError(f"subgoal_steps are [least, most], and {least} is more than {most}")
        return self


class FitSettings(Section):
    """One fit of the encoder."""

    updates: Annotated[int, Field(ge=0)] = 800
    window_steps: Positive = 30
    """positives lie 1..window_steps apart in the same episode"""
    temperature: PositiveFloat = 0.3


class EncoderSettings(Section):
    """The latent model (eq. 10) and its loss (eq. 4)."""

    hidden: list[Positive] = [64, 64]
    vision_features: Positive = 32
    """numbers that the CNN makes of each eye's image, where a body sees"""
    learning_rate: PositiveFloat = 1e-3
    batch: Annotated[int, Field(ge=2)] = 128
    similarity: Literal["l2", "cosine", "dot"] = "l2"
    encode: FitSettings = FitSettings()
    refine: FitSettings = FitSettings(updates=300, window_steps=8, temperature=0.15)
    blend: Fraction = 1.0
    """lambda of eq. 13; 1 is the thesis's alternative, a warm start without mixing"""
    contrastive: bool = True
    """false: no CLTT, the encoder keeps its random weights (thesis 4.5, C2)"""
    output: Literal["softmax", "linear"] = "softmax"
    """linear: no simplex, latents are unbounded (thesis 4.5, C3)"""


class PolicySettings(Section):
    """PPO (Stable-Baselines3) of the goal-conditioned policy (eq. 11)."""

    hidden: list[Positive] = [64, 64]
    learning_rate: PositiveFloat = 1e-3
    rollout_columns: Positive = 16
    """segments' columns in one update: a rollout is segment_steps x rollout_columns"""
    epochs: Positive = 6
    minibatch: Annotated[int, Field(ge=2)] = 512
    discount: Fraction = 0.95
    gae_lambda: Fraction = 0.95
    clip: PositiveFloat = 0.2
    entropy_weight: Annotated[float, Field(ge=0)] = 0.0
    value_weight: Annotated[float, Field(ge=0)] = 0.5
    max_grad_norm: PositiveFloat = 0.5
    log_std: float = 0.0
    """initial log standard deviation of the actions"""
    max_policy_lag: Annotated[int, Field(ge=1)] = 2
    """experience older than this many versions is counted and dropped"""
    subgoals: Literal["one-hot", "softmax"] = "one-hot"
    """above level 0: what is made of an action, by child: the vertex of its largest number, or softmax(4a)"""


class GoalSettings(Section):
    """Goals and the reward for reaching them."""

    kind: Literal["one-hot", "random"] = "one-hot"
    """random: points drawn uniformly from the simplex, one for each episode (thesis 4.5, C4)"""
    period_steps: Positive = 100
    """environment steps between goal draws in GROUND and PRACTISE"""
    walk_steps_per_goal: Positive = 100
    """environment steps per vertex in WALK"""
    reward: Literal["squared", "dense", "sparse"] = "squared"
    """eq. 12, eq. 9 or eq. 8"""
    sparse_radius: PositiveFloat = 0.1
    """epsilon_g of eq. 8"""
    goal_weight: Annotated[float, Field(ge=0)] = 1.0
    """of the reward above in what the policy is trained on"""
    external_weight: float = 0.0
    """of the task's own reward (eq. 1 for standing up); a negative one is a cost"""

    @model_validator(mode="after")
    def _rewards_something(self) -> "GoalSettings":
        if self.goal_weight == 0 and self.external_weight == 0:
            raise ValueError("goal_weight and external_weight are both 0, so nothing would be rewarded")
        return self


class EvaluationSettings(Section):
    """How every iteration is scored."""

    columns: Positive = 16
    legs: Annotated[int, Field(ge=3)] = 5
    """goals one after the other; the first leg is not scored"""
    leg_steps: Positive = 100


class RecordingSettings(Section):
    """What `services/recorder` writes of every actor's steps into the run's folder."""

    every_steps: Annotated[int, Field(ge=0, le=1 << 20)] = 0
    """a row of the data set for every n-th environment step; 0 for no recording"""
    group_rows: Annotated[int, Field(ge=1024, le=1 << 22)] = 65_536
    """rows in one file of the data set"""


class WireSettings(Section):
    """Deadlines of the distributed run; `inf` is one without end."""

    model_config = ConfigDict(allow_inf_nan=True)

    status_secs: PositiveFloat = 1.0
    connect_secs: PositiveFloat = 20.0
    """how long a process tries to reach the router before it says so and ends"""
    stall_secs: PositiveFloat = 60.0
    """no progress for so long is reported, with who waits for whom"""
    grant_secs: PositiveFloat = 10.0
    """a granted segment that does not come within this time is granted to another actor"""
    checkpoint_secs: PositiveFloat = 60.0


class ViewSettings(Section):
    """What actors show to people, and how often; none of it is learned from, and all of it may be lost."""

    latents_per_sec: Annotated[float, Field(ge=0, le=50)] = 5.0
    """latents and postures of each actor; 0 for none"""
    columns: Annotated[int, Field(ge=1, le=256)] = 16
    """of each actor are shown, at most"""
    trail_steps: Annotated[int, Field(ge=2, le=1024)] = 60
    """of the first column's way are shown"""
    poses_per_sec: Annotated[float, Field(ge=0, le=50)] = 10.0
    """poses of a simulated body; 0 for none"""
    images_per_sec: Annotated[float, Field(ge=0, le=50)] = 2.0
    """what a body with eyes sees; 0 for none"""
    shown_actors: Annotated[int, Field(ge=0)] = 1
    """poses and images are those of the actors whose index is below this"""
    recording_mb: Annotated[int, Field(ge=1)] = 512
    """the recording of the dashboard may take so much of the disk (10^6 bytes); the oldest goes first"""
