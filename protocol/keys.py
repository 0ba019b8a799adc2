"""Key expressions of the wire, and the delivery of each kind of message in one table."""

import re
from dataclasses import dataclass
from typing import Literal

from protocol.messages import (
    NAME_PATTERN,
    Ack,
    Command,
    Message,
    Model,
    PhaseAnnounced,
    Reply,
    Segment,
    SettingsAnnounced,
    Status,
    View,
)
from protocol.refusal import shown

ROOT = "babble"
SERVICES = (
    "actor",
    "encoder_learner",
    "policy_learner",
    "coordinator",
    "router",
    "launcher",
    "dashboard",
    "recorder",
)
MAX_FRAME_BYTES = 64 << 20
"""Zenoh drops larger messages without a word, so every put checks against this first."""


@dataclass(frozen=True, kw_only=True)
class Delivery:
    """How a kind of message travels: what may be lost, what may be late, what blocks whom."""

    promise: Literal["at-least-once", "latest-wins", "best-effort", "question"]
    priority: Literal["real-time", "interactive-high", "data-high", "data", "data-low", "background"]
    on_full: Literal["block", "drop"]
    """What the sender's transport does when the link is full."""
    link: Literal["control", "data"]
    """Which of a process's two connections it takes; control never waits behind data."""
    keep: int
    """Frames that a receiver's inbox holds of it before the oldest is dropped and counted."""


DELIVERY: dict[str, Delivery] = {
    "segment": Delivery(
        promise="at-least-once", priority="data-low", on_full="block", link="data", keep=1024
    ),
    "ack": Delivery(
        promise="best-effort", priority="interactive-high", on_full="drop", link="control", keep=4096
    ),
    "model": Delivery(promise="latest-wins", priority="data-high", on_full="block", link="data", keep=64),
    "phase": Delivery(promise="latest-wins", priority="real-time", on_full="drop", link="control", keep=64),
    "settings": Delivery(
        promise="latest-wins", priority="data-high", on_full="drop", link="control", keep=64
    ),
    "status": Delivery(
        promise="best-effort", priority="background", on_full="drop", link="control", keep=4096
    ),
    "command": Delivery(
        promise="question", priority="interactive-high", on_full="drop", link="control", keep=64
    ),
    "view": Delivery(promise="best-effort", priority="background", on_full="drop", link="data", keep=64),
}


def segment(run: str, consumer: str, block: str, life: str) -> str:
    """Key of the experience that `life` sends to `consumer`; `*` for any."""
    return f"{ROOT}/{run}/segment/{consumer}/{block}/{life}"


def ack(run: str, life: str, consumer: str) -> str:
    """Key of the acknowledgements that `consumer` sends to `life`."""
    return f"{ROOT}/{run}/ack/{life}/{consumer}"


def model(run: str, model_kind: str, block: str) -> str:
    """Key of a block's newest "encoder" or "policy"."""
    return f"{ROOT}/{run}/model/{model_kind}/{block}"


def phase(run: str) -> str:
    """Key of the coordinator's announcements."""
    return f"{ROOT}/{run}/phase"


def settings(run: str) -> str:
    """Key of the run's settings; `*` for those of all runs."""
    return f"{ROOT}/{run}/settings"


def status(run: str, service: str, life: str) -> str:
    """Key of one process's status."""
    return f"{ROOT}/{run}/status/{service}/{life}"


def alive(run: str, service: str, life: str) -> str:
    """Key of the liveliness token; it holds the unique life, so no two tokens share a key."""
    return f"{ROOT}/{run}/alive/{service}/{life}"


def command(run: str, service: str) -> str:
    """Key on which a service answers commands."""
    return f"{ROOT}/{run}/command/{service}"


def view(run: str, what: str, life: str) -> str:
    """Key of pictures for people."""
    return f"{ROOT}/{run}/view/{what}/{life}"


def of(message: Message) -> str:
    """The key on which a message travels; `*` where its header does not say (the service asked)."""
    match message:
        case Segment():
            return segment(message.run, message.consumer, message.block, message.life)
        case Ack():
            return ack(message.run, message.to, message.consumer)
        case Model():
            return model(message.run, message.model, message.block)
        case PhaseAnnounced():
            return phase(message.run)
        case SettingsAnnounced():
            return settings(message.run)
        case Status():
            return status(message.run, message.service, message.life)
        case View():
            return view(message.run, message.view, message.life)
        case Command() | Reply():
            return command(message.run, "*")


_ALIVE = re.compile(f"{ROOT}/{NAME_PATTERN}/alive/(?P<service>{NAME_PATTERN})/(?P<life>{NAME_PATTERN})")


def is_member(key: str) -> bool:
    """True if `member` can read the key: whoever announces himself may choose the end of his own name."""
    return _ALIVE.fullmatch(key) is not None


def member(key: str) -> tuple[str, str]:
    """(service, life) of an `alive` key.

    Raises ValueError if the key is not one, or has another name in it than a header may have.
    """
    found = _ALIVE.fullmatch(key)
    if found is None:
        raise ValueError(f"{shown(key)} is not a liveliness key {alive('<run>', '<service>', '<life>')}")
    return found["service"], found["life"]
