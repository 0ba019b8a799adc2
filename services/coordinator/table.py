"""The phases of a run and the legal moves between them; docs/phases.md is drawn from this table.

Pure: standard library only, no clock, bus, disk, thread or random number. This `Phase` has the values of
`protocol.messages.Phase`, which may not be imported here because it brings numpy; a test holds them together.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Literal, get_args


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


ONLY = ""
"""The condition of a move without an alternative."""

NEXT: Mapping[Phase, Mapping[Phase, str]] = MappingProxyType(
    {
        Phase.BABBLE: {
            Phase.ENCODE: "something is to be learned",
            Phase.DONE: "nothing is to be learned (open loop)",
        },
        Phase.ENCODE: {Phase.GROUND: ONLY},
        Phase.GROUND: {Phase.EVALUATE: ONLY},
        Phase.WALK: {Phase.REFINE: ONLY},
        Phase.REFINE: {Phase.PRACTISE: ONLY},
        Phase.PRACTISE: {Phase.EVALUATE: ONLY},
        Phase.EVALUATE: {
            Phase.WALK: "iterations are left",
            Phase.BABBLE: "a level of blocks is left",
            Phase.DONE: "nothing is left",
        },
        Phase.DONE: {},
    }
)
"""Phase -> the possible next phases, each with its condition."""

Learner = Literal["encoder_learner", "policy_learner"]
LEARNERS: tuple[Learner, ...] = get_args(Learner)
RECORDER: Literal["recorder"] = "recorder"
Worker = Learner | Literal["recorder"]
"""Who can be responsible for a phase."""


@dataclass(frozen=True, kw_only=True)
class Duty:
    """What is done in a phase, who ends it, and what that one counts."""

    does: str
    worker: Worker | None
    """who is responsible for it and ends it"""
    counts: str
    needs_actors: bool


DUTY: Mapping[Phase, Duty] = MappingProxyType(
    {
        Phase.BABBLE: Duty(
            does="actors move at random; the encoder learner collects",
            worker="encoder_learner",
            counts="steps",
            needs_actors=True,
        ),
        Phase.ENCODE: Duty(
            does="the encoder is fitted to what was collected",
            worker="encoder_learner",
            counts="updates",
            needs_actors=False,
        ),
        Phase.GROUND: Duty(
            does="the policy is trained for the first time, the encoder is frozen",
            worker="policy_learner",
            counts="steps",
            needs_actors=True,
        ),
        Phase.WALK: Duty(
            does="actors walk from vertex to vertex with the policy; the encoder learner collects",
            worker="encoder_learner",
            counts="steps",
            needs_actors=True,
        ),
        Phase.REFINE: Duty(
            does="the encoder is fitted again and blended with the old one",
            worker="encoder_learner",
            counts="updates",
            needs_actors=False,
        ),
        Phase.PRACTISE: Duty(
            does="the policy is trained again, the encoder is frozen",
            worker="policy_learner",
            counts="steps",
            needs_actors=True,
        ),
        Phase.EVALUATE: Duty(
            does="the newest versions are scored; nothing is changed",
            worker="policy_learner",
            counts="columns",
            needs_actors=True,
        ),
        Phase.DONE: Duty(does="every process ends with code 0", worker=None, counts="", needs_actors=False),
    }
)
"""What is done in each phase of a run that learns."""

OPEN_LOOP: Mapping[Phase, Duty] = MappingProxyType(
    {
        Phase.BABBLE: Duty(
            does="actors move at random; the recorder writes it down",
            worker=RECORDER,
            counts="steps",
            needs_actors=True,
        ),
    }
)
"""The duties that are otherwise where nothing is learned."""
