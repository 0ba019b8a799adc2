"""A study: conditions x seeds of one base scenario, each condition with one thing otherwise."""

import re
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, ValidationError, field_validator

from protocol.messages import Name
from protocol.refusal import clip
from services.runtime.errors import UserError
from services.runtime.levels import merged
from services.runtime.sections import PhaseSettings, Positive, Section
from services.runtime.settings import LONGEST_SHOWN, RunSettings, SettingsError, load

MOST_STEPS = 10**9
MOST_RUNS = 1000
Measured = tuple[float, Annotated[float, Field(ge=0)]]
"""A mean and its deviation."""
Seed = Annotated[int, Field(ge=0, lt=2**32)]
SEEDS = re.compile(r"(\d{1,10})(?:-(\d{1,10}))?")


class StudyError(UserError, ValueError):
    """A study that cannot be run as it is; the text is one sentence for a person."""


class ThesisNumbers(Section):
    """What the thesis prints for a condition."""

    diameter: Measured | None = None
    participation_ratio: Measured | None = None
    intrinsic_dimension: Measured | None = None


class Condition(Section):
    """One way of moving."""

    id: Annotated[str, Field(pattern=r"^[A-Za-z0-9][A-Za-z0-9_]{0,15}$")]
    title: Annotated[str, Field(min_length=1, max_length=80)]
    change: dict[str, Any] = Field(default={})
    """What of the base scenario is otherwise, by table."""
    thesis: ThesisNumbers = ThesisNumbers()


class Plan(Section):
    """The TOML of a study."""

    study: Annotated[Name, Field(max_length=24)]
    title: str
    base: str
    """The scenario's file, from the folder of this one."""
    steps: Annotated[int, Field(ge=1, le=MOST_STEPS)]
    """Environment steps of each run, evaluations not counted."""
    seeds: Annotated[list[Seed], Field(min_length=1)]
    curve: list[Positive] = Field(default=[])
    """Coverage is also measured after so many environment steps."""
    claims: Literal["thesis-4.5"] | None = None
    """Whose claims the report judges, by the conditions' ids; None for none."""
    notes: list[str] = Field(default=[])
    """What a reader of the report must know: choices that are ours, what a source does not say."""
    condition: Annotated[list[Condition], Field(min_length=1)]

    @field_validator("seeds")
    @classmethod
    def _seeds_differ(cls, seeds: list[int]) -> list[int]:
        if len(set(seeds)) != len(seeds):
            raise ValueError("each seed may be there once")
        return seeds

    @field_validator("condition")
    @classmethod
    def _ids_differ(cls, conditions: list[Condition]) -> list[Condition]:
        # Not by their case either: a run has a folder of its condition's name.
        if len({condition.id.lower() for condition in conditions}) != len(conditions):
            raise ValueError("each id may be there once")
        return conditions


@dataclass(frozen=True, kw_only=True)
class Run:
    """One condition with one seed."""

    condition: str
    seed: int
    settings: RunSettings
    rows: int
    """The cloud that is measured: so many first rows of its recording, evaluations left out."""
    curve: tuple[int, ...]
    """Of so many first rows coverage is measured too."""

    @property
    def name(self) -> str:
        """Of its folder."""
        return run_folder_name(self.condition, self.seed)

    @property
    def learns(self) -> bool:
        """False for a random walk in open loop."""
        return not self.settings.phases.open_loop


def run_folder_name(condition: str, seed: int) -> str:
    """The folder of a run, in that of its study."""
    return f"{condition}-seed{seed}"


def load_plan(path: Path) -> Plan:
    """The study of a TOML file. Raises `StudyError` with one sentence that names the file and the key."""
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise StudyError(f"cannot read the study {path}: {error.strerror}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise StudyError(f"{path} is not valid TOML: {error}") from None
    return parse_plan(table, origin=str(path))


def parse_plan(table: dict[str, Any], *, origin: str) -> Plan:
    """The study of an already read table. Raises `StudyError`, naming `origin` and the key."""
    if "scenario" in table and "condition" not in table:
        raise StudyError(f"{origin} is a scenario, not a study; train it with `babble up`")
    try:
        return Plan.model_validate(table)
    except ValidationError as error:
        raise StudyError(f"{origin}: {_first_fault(error)}") from None


def runs_of(
    plan: Plan,
    base: RunSettings,
    *,
    steps: int,
    seeds: Sequence[int],
    only: Sequence[str] = (),
    actors: int | None = None,
) -> list[Run]:
    """The runs in the order in which they are worth having.

    All conditions with the first seed before any with the second, and of one seed those without learning
    first: they are quick, and the others are compared with them. Raises `StudyError` for what cannot be run.
    """
    if unknown := [each for each in only if each not in {condition.id for condition in plan.condition}]:
        known = ", ".join(condition.id for condition in plan.condition)
        raise StudyError(f"--only: {plan.study} has no condition {unknown[0]!r}; it has {known}")
    chosen = [condition for condition in plan.condition if not only or condition.id in only]
    if len(chosen) * len(seeds) > MOST_RUNS:
        raise StudyError(f"{len(chosen) * len(seeds)} runs are more than the {MOST_RUNS} of one study")
    made = [settings_of(plan, base, condition, steps=steps, actors=actors) for condition in chosen]
    runs = []
    for seed in seeds:
        of_seed = [_run(plan, settings, condition.id, seed, steps) for condition, settings in made]
        runs += sorted(of_seed, key=lambda run: run.learns)
    return runs


def settings_of(
    plan: Plan, base: RunSettings, condition: Condition, *, steps: int, actors: int | None = None
) -> tuple[Condition, RunSettings]:
    """A condition and its settings, but for the seed. Raises `StudyError`."""
    place = f"condition {condition.id} of {plan.study}"
    named = {"scenario": f"{plan.study}-{condition.id}".lower()}
    given = {} if actors is None else {"actors": {"count": actors}}
    try:
        settings = merged(merged(base, condition.change, ()), {**named, **given}, ())
    except ValidationError as error:
        raise StudyError(f"{place}: {_first_fault(error)}") from None
    if not settings.recording.every_steps:
        raise StudyError(f"{place} records nothing to measure; set recording.every_steps = 1 in {plan.base}")
    if len(settings.levels) > 1 or any(level.phases for level in settings.level):
        raise StudyError(f"{place} says phases by level, whose steps a study cannot count; leave levels out")
    return condition, settings.model_copy(update={"phases": scaled(settings.phases, steps)})


def scaled(phases: PhaseSettings, steps: int) -> PhaseSettings:
    """The phases with so many environment steps in sum, in the same proportions; each at least its share."""
    if phases.open_loop:
        return phases.model_copy(update={"babble_steps": steps})
    once = ("babble_steps", "ground_steps")
    again = ("walk_steps", "practise_steps")
    total = sum(getattr(phases, name) for name in once)
    total += phases.iterations * sum(getattr(phases, name) for name in again)
    return phases.model_copy(
        update={name: -(-getattr(phases, name) * steps // total) for name in (*once, *again)}
    )


def base_settings(plan: Plan, path: Path) -> RunSettings:
    """The scenario that the study at `path` begins from. Raises `SettingsError`."""
    return load(path.parent / plan.base)


def seeds_of(text: str) -> list[int]:
    """The seeds of a command line: "0-4", "0,2,5" or both mixed. Raises ValueError with one sentence."""
    seeds: list[int] = []
    for part in text.split(","):
        found = SEEDS.fullmatch(part.strip())
        first, last = (int(found[1]), int(found[2] or found[1])) if found else (1, 0)
        if first > last or last - first >= MOST_RUNS or last >= 2**32:
            raise ValueError(f"seeds are such as 0-2 or 0,3,7, got {text!r}")
        seeds += range(first, last + 1)
    if len(set(seeds)) != len(seeds):
        raise ValueError(f"each seed may be there once, got {text!r}")
    return seeds


def _run(plan: Plan, settings: RunSettings, condition: str, seed: int, steps: int) -> Run:
    every = settings.recording.every_steps
    rows = steps // every
    curve = tuple(sorted({prefix // every for prefix in plan.curve if 0 < prefix // every < rows}))
    seeded = settings.model_copy(update={"seed": seed})
    return Run(condition=condition, seed=seed, settings=seeded, rows=rows, curve=(*curve, rows))


def _first_fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False, include_context=False)[0]
    place = clip(".".join(str(part) for part in fault["loc"]), LONGEST_SHOWN) or "the file"
    if fault["type"] == "extra_forbidden":
        return f"{place}: is not a known key"
    wrong, value = clip(fault["msg"].lower(), 2 * LONGEST_SHOWN), clip(repr(fault["input"]), LONGEST_SHOWN)
    return f"{place}: {wrong}, got {value}"


__all__ = [
    "Condition",
    "Measured",
    "Plan",
    "Run",
    "SettingsError",
    "StudyError",
    "ThesisNumbers",
    "base_settings",
    "load_plan",
    "parse_plan",
    "run_folder_name",
    "runs_of",
    "scaled",
    "seeds_of",
    "settings_of",
]
