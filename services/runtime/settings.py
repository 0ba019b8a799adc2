"""The settings of a run: one TOML per scenario, frozen, with unknown keys refused.

A scenario states what differs from the defaults here; the run folder's `config.toml` records the
whole. Defaults come from the prototype's measurements and are argued in docs/operating.md.
"""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from protocol.messages import ALL_BLOCKS, MAX_CONFIG_CHARS, MAX_STEPS, Name
from protocol.refusal import clip
from services.runtime.errors import UserError

LONGEST_SHOWN = 200
"""So many characters of a wrong value, or of its key, get into a sentence."""

Positive = Annotated[int, Field(ge=1)]
PositiveFloat = Annotated[float, Field(gt=0)]
Fraction = Annotated[float, Field(gt=0, le=1)]


class SettingsError(UserError, ValueError):
    """A scenario or run configuration that cannot be used; the text is one sentence for a person."""


class Section(BaseModel):
    """A table of the TOML file."""

    model_config = ConfigDict(frozen=True, extra="forbid")


class WorldSettings(Section):
    """Which body, and its parameters (checked by babble.worlds)."""

    id: str = "Cuboid"
    parameters: dict[str, Any] = {}


class BlockSettings(Section):
    """One Composer block: what it observes, drives and how many vertices its simplex has."""

    name: Name = "body"
    latent_dim: Annotated[int, Field(ge=2, le=64)] = 2
    observes: list[int] | None = None
    """Indices of the world's observation; None for all of it."""
    drives: list[int] | None = None
    """Indices of the world's action; None for all of it."""
    children: list[Name] = []
    """Blocks below whose latents it observes and whose goals it sets (Hi-Composer); they cannot act yet."""


class ActorSettings(Section):
    """How many actors `babble up` starts, and how each works."""

    count: Positive = 2
    envs_per_actor: Annotated[int, Field(ge=1, le=4096)] = 8
    """worlds stepped together with one batched inference"""
    segment_steps: Annotated[int, Field(ge=2, le=65536)] = 128
    """steps per world in one published segment; the rollout length of PPO"""
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


class NoiseSettings(Section):
    """The random walk of the BABBLE phase."""

    kind: Literal["white", "pink", "ou", "held"] = "ou"
    scale: PositiveFloat = 0.6
    """standard deviation of the action before clipping to the bounds"""
    correlation: Annotated[float, Field(ge=0, lt=1)] = 0.9
    """OU only: u <- correlation * u + noise"""
    hold_steps: Positive = 10
    """held only: steps between new draws"""


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


class GoalSettings(Section):
    """Goals and the reward for reaching them."""

    period_steps: Positive = 100
    """environment steps between goal draws in GROUND and PRACTISE"""
    walk_steps_per_goal: Positive = 100
    """environment steps per vertex in WALK"""
    reward: Literal["squared", "dense", "sparse"] = "squared"
    """eq. 12, eq. 9 or eq. 8"""
    sparse_radius: PositiveFloat = 0.1
    """epsilon_g of eq. 8"""
    goal_weight: Annotated[float, Field(ge=0, allow_inf_nan=False)] = 1.0
    """of the reward above in what the policy is trained on"""
    external_weight: Annotated[float, Field(allow_inf_nan=False)] = 0.0
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


class WireSettings(Section):
    """Deadlines of the distributed run."""

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


class RunSettings(Section):
    """A whole run."""

    scenario: Name
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    world: WorldSettings = WorldSettings()
    block: list[BlockSettings] = [BlockSettings()]
    actors: ActorSettings = ActorSettings()
    phases: PhaseSettings = PhaseSettings()
    babbling: NoiseSettings = NoiseSettings()
    encoder: EncoderSettings = EncoderSettings()
    policy: PolicySettings = PolicySettings()
    goals: GoalSettings = GoalSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    wire: WireSettings = WireSettings()
    view: ViewSettings = ViewSettings()

    @model_validator(mode="after")
    def _blocks_are_distinct(self) -> "RunSettings":
        names = [block.name for block in self.block]
        if not names or len(set(names)) != len(names) or ALL_BLOCKS in names:
            raise ValueError(f"block names must be distinct and none may be {ALL_BLOCKS!r}; got {names}")
        return self

    @model_validator(mode="after")
    def _segments_fit_rollouts(self) -> "RunSettings":
        most = self.policy.rollout_columns * (self.policy.max_policy_lag + 1)
        if self.actors.envs_per_actor > most:
            raise ValueError(
                f"actors.envs_per_actor may be at most {most}, that is policy.rollout_columns x "
                "(policy.max_policy_lag + 1), or part of every segment would be too old to learn from"
            )
        return self

    @model_validator(mode="after")
    def _evaluations_are_one_segment(self) -> "RunSettings":
        legs, leg_steps = self.evaluation.legs, self.evaluation.leg_steps
        if legs * leg_steps > MAX_STEPS:
            raise ValueError(
                f"evaluation.legs x evaluation.leg_steps may be at most {MAX_STEPS:,}, the steps of one "
                f"segment; got {legs:,} x {leg_steps:,}"
            )
        return self

    def check_rewarded(self, rewarded: bool) -> None:
        """Raise `SettingsError` if a reward is weighed that the world never gives.

        `rewarded`: it has a task, and so a reward of its own.
        """
        weight = self.goals.external_weight
        if weight != 0 and not rewarded:
            raise SettingsError(
                f"goals.external_weight is {weight:g}, and the world {self.world.id} has no reward of its "
                "own to weigh; leave it out, or choose a world with a task"
            )

    def one_block(self, name: str) -> BlockSettings:
        """The settings of the named block. Raises KeyError for an unknown one."""
        for block in self.block:
            if block.name == name:
                return block
        raise KeyError(name)


def load(path: Path, **overrides: Any) -> RunSettings:
    """The settings of a TOML file; `overrides` replace top-level values.

    Raises `SettingsError` with one sentence that names the file and the key.
    """
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise SettingsError(f"cannot read the scenario {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise SettingsError(f"{path} is not valid TOML: {error}") from None
    return parse({**table, **overrides}, origin=str(path))


def parse(table: dict[str, Any], *, origin: str) -> RunSettings:
    """The settings of an already read table. Raises `SettingsError`, naming `origin` and the key."""
    try:
        return RunSettings.model_validate(table)
    except ValidationError as error:
        fault = error.errors(include_url=False, include_context=False)[0]
        place = clip(".".join(str(part) for part in fault["loc"]), LONGEST_SHOWN) or "the file"
        wrong, value = (
            clip(fault["msg"].lower(), 2 * LONGEST_SHOWN),
            clip(repr(fault["input"]), LONGEST_SHOWN),
        )
        what = "is not a known key" if fault["type"] == "extra_forbidden" else f"{wrong}, got {value}"
        raise SettingsError(f"{origin}: {place}: {what}") from None


def announced_text(settings: RunSettings) -> str:
    """The settings as a coordinator announces them: a JSON object with all keys.

    Raises `SettingsError` if that is longer than may travel.
    """
    text = json.dumps(settings.model_dump(mode="json"), separators=(",", ":"))
    if len(text) > MAX_CONFIG_CHARS:
        raise SettingsError(
            f"the settings of {settings.scenario} are {len(text):,} characters long, and actors can be told "
            f"{MAX_CONFIG_CHARS:,}; shorten the lists of what blocks observe and drive"
        )
    return text


def parse_announced(text: str, *, origin: str) -> RunSettings:
    """The settings of a coordinator's announcement. Raises `SettingsError`, naming `origin` and the key.

    The coordinator has checked them, so what does not hold here is of another version of Babble. A key that
    is missing has its default: new ones keep the old meaning.
    """
    try:
        table = json.loads(text)
        if not isinstance(table, dict):
            raise ValueError("not an object")
        return parse(table, origin=origin)
    except SettingsError as error:
        fault = str(error)
    except (ValueError, RecursionError) as error:
        fault = f"{origin} are no JSON object ({error})"
    raise SettingsError(
        f"{fault}; the coordinator's side has another version of babble, install the same one on both"
    )
