"""Who may say, hear, ask and announce what: one table, and Zenoh's access control made from it.

What is not in the table is dropped by the router, without a word to whoever tries: Zenoh tells nobody
that it refused. Nobody may delete, and nobody but the launcher may ask for anything to be done.
"""

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass, fields
from typing import Literal

from protocol.keys import ROOT
from services.runtime.credentials import ACTOR, HOST_PATTERN
from services.runtime.transport import DOOR

OWN = "OWN"
"""Stands in the table for the lives of the identity itself: `coordinator-*`, or `actor-<host>-*`."""


@dataclass(frozen=True, kw_only=True)
class Rights:
    """What an identity may do, as keys below `babble/<any run>/`; nothing by default."""

    hears: tuple[str, ...] = ()
    hears_newest: tuple[str, ...] = ()
    """also what was said before it came: the kinds that are retained"""
    says: tuple[str, ...] = ()
    retains: tuple[str, ...] = ()
    """says, and keeps for those who come later"""
    announces: tuple[str, ...] = ()
    """itself, by a liveliness token"""
    watches: tuple[str, ...] = ()
    """the announcements of others"""
    answers: tuple[str, ...] = ()
    asks: tuple[str, ...] = ()


def _member(service: str) -> tuple[str, str]:
    """Every process of a run announces itself and says how it is, under its own life only."""
    return f"alive/{service}/{OWN}", f"status/{service}/{OWN}"


def _learner(service: str, model_kind: str) -> Rights:
    alive, status = _member(service)
    return Rights(
        hears=(f"segment/{service}/*/*",),
        hears_newest=("phase",),
        says=(f"ack/*/{service}", status),
        retains=(f"model/{model_kind}/*",),
        announces=(alive,),
        watches=("alive/actor/*",),
    )


RIGHTS: dict[str, Rights] = {
    "actor": Rights(
        hears=(f"ack/{OWN}/*",),
        hears_newest=("phase", "settings", "model/*/*"),
        says=(f"segment/*/*/{OWN}", f"status/actor/{OWN}", f"view/*/{OWN}"),
        announces=(f"alive/actor/{OWN}",),
    ),
    "encoder_learner": _learner("encoder_learner", "encoder"),
    "policy_learner": _learner("policy_learner", "policy"),
    "coordinator": Rights(
        hears=("status/*/*",),
        says=(f"status/coordinator/{OWN}",),
        retains=("phase", "settings"),
        announces=(f"alive/coordinator/{OWN}",),
        watches=("alive/*/*",),
        answers=("command/coordinator",),
    ),
    "dashboard": Rights(
        hears=("view/*/*", "status/*/*"),
        hears_newest=("phase",),
        says=(f"status/dashboard/{OWN}",),
        announces=(f"alive/dashboard/{OWN}",),
        watches=("alive/*/*",),
    ),
    "launcher": Rights(
        hears=("status/*/*",),
        hears_newest=("phase",),
        watches=("alive/*/*",),
        asks=("command/*",),
    ),
    "recorder": Rights(
        hears=("segment/recorder/*/*",),
        hears_newest=("phase",),
        says=("ack/*/recorder", f"status/recorder/{OWN}"),
        announces=(f"alive/recorder/{OWN}",),
        watches=("alive/actor/*",),
    ),
}
"""Rights by role. A right over `OWN` lives holds for the lives of that identity and for no other."""

Flow = Literal["ingress", "egress"]
Reach = Literal["key", "kind", "history", "kind's history"]
"""Of a right: its key itself, or all keys of its kind; and where retained frames of them are kept."""

_HEARS: list[tuple[Flow, str, Reach]] = [("ingress", "declare_subscriber", "key"), ("egress", "put", "key")]
_SAYS: list[tuple[Flow, str, Reach]] = [("ingress", "put", "key"), ("egress", "declare_subscriber", "kind")]
MEANS: dict[str, list[tuple[Flow, str, Reach]]] = {
    "hears": _HEARS,
    "hears_newest": [
        *_HEARS,
        ("egress", "reply", "key"),
        ("ingress", "declare_subscriber", "history"),
        ("ingress", "query", "history"),
        ("ingress", "declare_liveliness_subscriber", "history"),
        ("egress", "put", "history"),
        ("egress", "declare_queryable", "history"),
        ("egress", "liveliness_token", "history"),
    ],
    "says": _SAYS,
    "retains": [
        *_SAYS,
        ("ingress", "reply", "key"),
        ("ingress", "put", "history"),
        ("ingress", "declare_queryable", "history"),
        ("ingress", "liveliness_token", "history"),
        ("egress", "query", "kind's history"),
        ("egress", "declare_subscriber", "kind's history"),
    ],
    "announces": [("ingress", "liveliness_token", "key")],
    "watches": [("ingress", "declare_liveliness_subscriber", "key"), ("egress", "liveliness_token", "key")],
    "answers": [
        ("ingress", "declare_queryable", "key"),
        ("ingress", "reply", "key"),
        ("egress", "query", "key"),
    ],
    "asks": [
        ("ingress", "query", "key"),
        ("egress", "declare_queryable", "key"),
        ("egress", "reply", "key"),
    ],
}
"""What each right is in messages of Zenoh: from the client to the router ("ingress"), or back.

Whoever says something is told who listens, or it would send nothing; and who listens often does so by a
wildcard, as in `model/*/*`, which a rule must include whole: hence a whole kind there. Retained frames
travel by Zenoh's advanced publishers, at keys with a chunk `@adv`, which no wildcard matches.
"""


def access_control(hosts: Collection[str]) -> dict[str, object]:
    """Zenoh's `access_control`: the rights of each role, and of the actors of these hosts.

    Raises ValueError for a label that is no host's; one with a wildcard or a hyphen would let a host
    speak for another.
    """
    for host in hosts:
        if not re.fullmatch(HOST_PATTERN, host):
            raise ValueError(f"{host!r} is not a host's label: 1 to 24 characters of a-z, 0-9 and _")
    identities = [(role, RIGHTS[role], f"{role}-$*") for role in RIGHTS if role != ACTOR]
    identities += [(f"{ACTOR}.{host}", RIGHTS[ACTOR], f"{ACTOR}-{host}-$*") for host in sorted({*hosts})]
    rules = {identity: _rules(identity, rights, own) for identity, rights, own in identities}
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": [rule for of_one in rules.values() for rule in of_one],
        "subjects": [{"id": identity, "cert_common_names": [identity]} for identity in rules],
        "policies": [
            {"subjects": [identity], "rules": [rule["id"] for rule in of_one]}
            for identity, of_one in rules.items()
        ],
    }


def _rules(identity: str, rights: Rights, own: str) -> list[dict[str, object]]:
    """One rule for each flow and message that the identity may."""
    keys_of: dict[tuple[Flow, str], set[str]] = {
        (flow, message): {DOOR} for flow, message, _ in MEANS["asks"]
    }
    for flow, message, key in _grants(rights):
        keys_of.setdefault((flow, message), set()).add(f"{ROOT}/*/{key.replace(OWN, own)}")
    return [
        {
            "id": f"{identity} {flow} {message}",
            "permission": "allow",
            "flows": [flow],
            "messages": [message],
            "key_exprs": sorted(keys),
        }
        for (flow, message), keys in keys_of.items()
    ]


def _grants(rights: Rights) -> Iterator[tuple[Flow, str, str]]:
    for right in fields(rights):
        for key in getattr(rights, right.name):
            kind = key.split("/")[0]
            reached: dict[Reach, str] = {
                "key": key,
                "kind": f"{kind}/**",
                "history": f"{key}/@adv/**",
                "kind's history": f"{kind}/**/@adv/**",
            }
            for flow, message, reach in MEANS[right.name]:
                yield flow, message, reached[reach]
