"""The settings of a run: one TOML per scenario, frozen, with unknown keys refused.

A scenario states what differs from the defaults in `sections.py`; the run folder's `config.toml` records the
whole. What a level or a block has otherwise stays beside it, and `of_level` and `of_block` put it together.
"""

import json
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, model_validator

from protocol.messages import ALL_BLOCKS, MAX_CONFIG_CHARS, MAX_STEPS, Name, Phase
from protocol.refusal import clip
from services.runtime.levels import (
    BLOCK_TABLES,
    LEVEL_TABLES,
    Place,
    SettingsError,
    decision_steps_of,
    levels_of,
    merged,
    misplaced,
)
from services.runtime.sections import (
    ActorSettings,
    BlockSettings,
    EncoderSettings,
    EvaluationSettings,
    FitSettings,
    GoalSettings,
    LearnerSettings,
    LevelSettings,
    NoiseSettings,
    PhaseSettings,
    PolicySettings,
    RecordingSettings,
    Section,
    ViewSettings,
    WireSettings,
    WorldSettings,
)

__all__ = [
    "ActorSettings",
    "BlockSettings",
    "EncoderSettings",
    "EvaluationSettings",
    "FitSettings",
    "GoalSettings",
    "LearnerKind",
    "LearnerSettings",
    "LevelSettings",
    "NoiseSettings",
    "PhaseSettings",
    "PolicySettings",
    "RecordingSettings",
    "RunSettings",
    "SettingsError",
    "ViewSettings",
    "WireSettings",
    "WorldSettings",
    "announced_text",
    "load",
    "parse",
    "parse_announced",
]

MOST_BLOCKS = 100
"""A status names the two models of each block, and has two scores of each, within the protocol's limits."""
MOST_DRAWN = 2_000_000
"""Steps of coloured noise that an actor draws ahead: 370 MB of them for the 46 motors of the whole body."""
LONGEST_SHOWN = 200
"""So many characters of a wrong value, or of its key, get into a sentence."""
DECIDING = frozenset({Phase.GROUND, Phase.PRACTISE, Phase.EVALUATE})
"""The phases in which a row of a segment is one decision of the block."""

LearnerKind = Literal["encoder", "policy"]


class RunSettings(Section):
    """A whole run."""

    scenario: Name
    seed: Annotated[int, Field(ge=0, lt=2**32)] = 0
    world: WorldSettings = WorldSettings()
    block: list[BlockSettings] = Field(default=[BlockSettings()], max_length=MOST_BLOCKS)
    level: list[LevelSettings] = Field(default=[])
    """what is otherwise for the blocks of level 0, 1...; may be left out"""
    actors: ActorSettings = ActorSettings()
    learners: LearnerSettings = LearnerSettings()
    phases: PhaseSettings = PhaseSettings()
    babbling: NoiseSettings = NoiseSettings()
    encoder: EncoderSettings = EncoderSettings()
    policy: PolicySettings = PolicySettings()
    goals: GoalSettings = GoalSettings()
    evaluation: EvaluationSettings = EvaluationSettings()
    recording: RecordingSettings = RecordingSettings()
    wire: WireSettings = WireSettings()
    view: ViewSettings = ViewSettings()

    @model_validator(mode="after")
    def _blocks_are_distinct(self) -> "RunSettings":
        names = [block.name for block in self.block]
        if not names or len(set(names)) != len(names) or ALL_BLOCKS in names:
            raise ValueError(f"block names must be distinct and none may be {ALL_BLOCKS!r}; got {names}")
        return self

    @model_validator(mode="after")
    def _learners_have_blocks(self) -> "RunSettings":
        for kind, count in self.learners:
            if count > len(self.block):
                raise misplaced(
                    ("learners", kind), f"there are only {len(self.block)} blocks to learn", count
                )
        least = min(self.learners.encoder, self.learners.policy)
        for index, block in enumerate(self.block):
            if block.learner is not None and block.learner >= least:
                sentence = f"must be below {least}, the processes of each kind (see [learners])"
                raise misplaced(("block", index, "learner"), sentence, block.learner)
        return self

    @model_validator(mode="after")
    def _levels_fit(self) -> "RunSettings":
        try:
            levels = self.levels
        except SettingsError:
            return self  # no tree: whoever builds it says so, with the world's own names
        for level, steps in enumerate(decision_steps_of(self.level, len(levels))):
            here = self.of_level(level)
            _check_periods(here, level, steps)
            _check_evaluation(here, level)
            for name in levels[level]:
                _check_rollout(self.of_block(name), name)
        return self

    @model_validator(mode="after")
    def _noise_fits(self) -> "RunSettings":
        held = self.actors.envs_per_actor * self.babbling.block_steps
        if self.babbling.kind == "coloured" and held > MOST_DRAWN:
            sentence = f"times actors.envs_per_actor may be at most {MOST_DRAWN:,}: an actor holds its blocks"
            raise misplaced(("babbling", "block_steps"), sentence, self.babbling.block_steps)
        return self

    @model_validator(mode="after")
    def _open_loop_is_recorded(self) -> "RunSettings":
        if self.phases.open_loop and (not self.recording.every_steps or any(b.children for b in self.block)):
            sentence = "needs recording.every_steps of at least 1, and blocks without children"
            raise misplaced(("phases", "open_loop"), sentence, True)
        return self

    @property
    def levels(self) -> tuple[tuple[str, ...], ...]:
        """The names of the blocks of each level, bottom-up; leaves are level 0.

        Raises `SettingsError` if a block names a child that is unknown or its own ancestor.
        """
        return levels_of(self.block)

    @property
    def decision_steps(self) -> tuple[int, ...]:
        """Environment steps for which one action of each level holds. Raises like `levels`."""
        return decision_steps_of(self.level, len(self.levels))

    def level_of(self, name: str) -> int:
        """The level of a block. Raises KeyError for an unknown one, and like `levels`."""
        for level, names in enumerate(self.levels):
            if name in names:
                return level
        raise KeyError(name)

    def of_level(self, level: int) -> "RunSettings":
        """The run's settings with the tables, and `actors.segment_steps`, as they hold on a level."""
        if level >= len(self.level):
            return self
        here = self.level[level]
        changed: dict[str, Any] = _tables(self, here, LEVEL_TABLES, ("level", level))
        if here.segment_steps is not None:
            changed["actors"] = self.actors.model_copy(update={"segment_steps": here.segment_steps})
        return self.model_copy(update=changed)

    def of_block(self, name: str) -> "RunSettings":
        """The run's settings as they hold for one block: the run's, its level's, its own.

        Raises KeyError for an unknown block, and like `levels`.
        """
        around = self.of_level(self.level_of(name))
        place: Place = ("block", [block.name for block in self.block].index(name))
        return around.model_copy(update=_tables(around, self.one_block(name), BLOCK_TABLES, place))

    def rows_env_steps(self, name: str, phase: Phase) -> int:
        """Environment steps in one row of a block's segment of a phase; 1 on level 0.

        A decision where the block acts; where it is watched, or fitted to what was watched, a decision of
        the level below. Raises KeyError for an unknown block, and like `levels`.
        """
        level = self.level_of(name)
        return self.decision_steps[level if phase in DECIDING else max(level - 1, 0)]

    def learner_of(self, name: str, kind: LearnerKind) -> int:
        """The index of the process that learns a block's encoder or policy.

        Raises KeyError for an unknown block, and like `levels`.
        """
        asked = self.one_block(name).learner
        if asked is not None:
            return asked
        count: int = getattr(self.learners, kind)
        return self.levels[self.level_of(name)].index(name) % count

    def check_rewarded(self, rewarded: bool) -> None:
        """Raise `SettingsError` if a reward is weighed that the world never gives.

        `rewarded`: it has a task, and so a reward of its own.
        """
        weights = (self.of_level(level).goals.external_weight for level in range(len(self.levels)))
        weight = next((weight for weight in weights if weight != 0), 0.0)
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


def _tables(run: RunSettings, change: Section, names: tuple[str, ...], place: Place) -> dict[str, Section]:
    """Those of the run's tables that are otherwise in `change`."""
    return {
        name: merged(getattr(run, name), getattr(change, name), (*place, name))
        for name in names
        if getattr(change, name)
    }


def _check_periods(run: RunSettings, level: int, decision_steps: int) -> None:
    """Goals may only change when the level decides."""
    goals, leg_steps = run.goals, run.evaluation.leg_steps
    periods = {
        ("goals", "period_steps"): goals.period_steps,
        ("goals", "walk_steps_per_goal"): goals.walk_steps_per_goal,
        ("evaluation", "leg_steps"): leg_steps,
    }
    for (table, key), steps in periods.items():
        if steps % decision_steps:
            sentence = f"must be a multiple of the {decision_steps} environment steps of the level's decision"
            raise misplaced(("level", level, table, key), sentence, steps)


def _check_evaluation(run: RunSettings, level: int) -> None:
    legs, leg_steps = run.evaluation.legs, run.evaluation.leg_steps
    if legs * leg_steps > MAX_STEPS:
        place: Place = ("level", level, "evaluation") if level else ("evaluation",)
        sentence = f"legs x leg_steps may be at most {MAX_STEPS:,}, the steps of one segment"
        raise misplaced(place, sentence, legs * leg_steps)


def _check_rollout(run: RunSettings, block: str) -> None:
    most = run.policy.rollout_columns * (run.policy.max_policy_lag + 1)
    if run.actors.envs_per_actor > most:
        sentence = (
            f"may be at most {most}, that is policy.rollout_columns x (policy.max_policy_lag + 1) of block "
            f"{block}, or part of every segment would be too old to learn from"
        )
        raise misplaced(("actors", "envs_per_actor"), sentence, run.actors.envs_per_actor)
