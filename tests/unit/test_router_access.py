"""The table of rights and what is made of it for Zenoh: nothing by default, and no host in another's name."""

import itertools
from collections.abc import Iterable
from typing import Any

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from protocol import keys
from protocol.keys import DELIVERY
from services.router.access import RIGHTS, access_control
from services.runtime.credentials import HOST_PATTERN, ROLES

LABELS = st.from_regex(HOST_PATTERN, fullmatch=True)
LIFE = "00000000"


def allowed(config: dict[str, Any], identity: str, flow: str, message: str) -> list[str]:
    """The key expressions on which Zenoh lets an identity pass."""
    (subject,) = (s["id"] for s in config["subjects"] if s["cert_common_names"] == [identity])
    (names,) = (policy["rules"] for policy in config["policies"] if policy["subjects"] == [subject])
    rules = [rule for rule in config["rules"] if rule["id"] in names]
    assert {rule["permission"] for rule in rules} == {"allow"}
    return [
        key
        for rule in rules
        if flow in rule["flows"] and message in rule["messages"]
        for key in rule["key_exprs"]
    ]


def may(config: dict[str, Any], identity: str, message: str, key: str) -> bool:
    """As the router decides it: one of the rules must include the whole key."""
    rules = allowed(config, identity, "ingress", message)
    return any(zenoh.KeyExpr(rule).includes(zenoh.KeyExpr(key)) for rule in rules)


def who_may(config: dict[str, Any], message: str, key: str) -> set[str]:
    identities = [name for subject in config["subjects"] for name in subject["cert_common_names"]]
    return {identity for identity in identities if may(config, identity, message, key)}


CONFIG: dict[str, Any] = access_control(["lab", "lab_2", "other"])
ACTORS = {"actor.lab", "actor.lab_2", "actor.other"}


def test_what_is_not_granted_is_refused() -> None:
    assert CONFIG["enabled"] is True
    assert CONFIG["default_permission"] == "deny"
    identities = [name for subject in CONFIG["subjects"] for name in subject["cert_common_names"]]
    assert set(identities) == ACTORS | (set(ROLES) - {"router"})
    assert len(identities) == len(set(identities))


def test_nobody_may_delete_and_nobody_has_a_right_over_everything() -> None:
    assert not [rule for rule in CONFIG["rules"] if "delete" in rule["messages"]]
    for rule in CONFIG["rules"]:
        for key in rule["key_exprs"]:
            assert key.startswith(("babble/*/", "babble/@door"))
            assert key.split("/")[2:3] != ["**"]


@pytest.mark.parametrize(
    ("key", "speakers"),
    [
        (keys.phase("r"), {"coordinator"}),
        (keys.settings("r"), {"coordinator"}),
        (keys.model("r", "encoder", "body"), {"encoder_learner"}),
        (keys.model("r", "policy", "body"), {"policy_learner"}),
        (keys.ack("r", "actor-lab-1", "encoder_learner"), {"encoder_learner"}),
        (keys.ack("r", "actor-lab-1", "policy_learner"), {"policy_learner"}),
        (keys.segment("r", "encoder_learner", "body", f"actor-lab-{LIFE}"), {"actor.lab"}),
        (keys.segment("r", "encoder_learner", "body", f"actor-lab_2-{LIFE}"), {"actor.lab_2"}),
        (keys.segment("r", "encoder_learner", "body", f"actor-{LIFE}"), set()),
        (keys.view("r", "posture", f"actor-other-{LIFE}"), {"actor.other"}),
        (keys.status("r", "actor", f"actor-other-{LIFE}"), {"actor.other"}),
        (keys.status("r", "coordinator", f"coordinator-{LIFE}"), {"coordinator"}),
        (keys.status("r", "coordinator", f"actor-lab-{LIFE}"), set()),
        (keys.status("r", "router", f"router-{LIFE}"), set()),
        (keys.status("r", "dashboard", f"dashboard-{LIFE}"), {"dashboard"}),
        (keys.command("r", "coordinator"), set()),
        ("babble/r/phase/@adv/pub/1/2/_", {"coordinator"}),
    ],
)
def test_each_key_has_one_speaker(key: str, speakers: set[str]) -> None:
    assert who_may(CONFIG, "put", key) == speakers


@pytest.mark.parametrize(
    ("key", "hearers"),
    [
        (
            keys.phase("r"),
            {"encoder_learner", "policy_learner", "dashboard", "launcher", "recorder"} | ACTORS,
        ),
        (keys.settings("r"), ACTORS),
        (keys.model("r", "*", "*"), ACTORS),
        (keys.ack("r", f"actor-lab-{LIFE}", "*"), {"actor.lab"}),
        (keys.ack("r", "*", "*"), set()),
        (keys.segment("r", "encoder_learner", "*", "*"), {"encoder_learner"}),
        (keys.segment("r", "recorder", "*", "*"), {"recorder"}),
        (keys.segment("r", "*", "*", "*"), set()),
        (keys.status("r", "*", "*"), {"coordinator", "dashboard", "launcher"}),
        (keys.view("r", "*", "*"), {"dashboard"}),
        ("**", set()),
        ("babble/**", set()),
    ],
)
def test_each_key_has_its_hearers(key: str, hearers: set[str]) -> None:
    assert who_may(CONFIG, "declare_subscriber", key) == hearers


def test_commands_are_asked_by_the_launcher_and_answered_by_the_coordinator() -> None:
    assert who_may(CONFIG, "query", keys.command("r", "coordinator")) == {"launcher"}
    assert who_may(CONFIG, "declare_queryable", keys.command("r", "coordinator")) == {"coordinator"}
    assert who_may(CONFIG, "reply", keys.command("r", "coordinator")) == {"coordinator"}


def test_each_process_announces_itself_alone() -> None:
    for identity in ACTORS | (RIGHTS.keys() - {"actor", "launcher"}):
        service, _, host = identity.partition(".")
        life = f"{service}-{host}-{LIFE}" if host else f"{service}-{LIFE}"
        assert who_may(CONFIG, "liveliness_token", keys.alive("r", service, life)) == {identity}
    assert not may(CONFIG, "launcher", "liveliness_token", keys.alive("r", "launcher", f"launcher-{LIFE}"))


def test_what_is_retained_is_what_the_delivery_table_retains() -> None:
    retained = {kind for kind, row in DELIVERY.items() if row.promise == "latest-wins"}
    granted = [right for rights in RIGHTS.values() for right in (*rights.retains, *rights.hears_newest)]
    assert {right.split("/")[0] for right in granted} == retained
    plainly = [right for rights in RIGHTS.values() for right in (*rights.says, *rights.hears)]
    assert not {right.split("/")[0] for right in plainly} & retained


@given(st.sets(LABELS, min_size=2, max_size=5))
def test_no_two_hosts_share_a_key_to_speak_on(hosts: Iterable[str]) -> None:
    config = access_control([*hosts])
    for message in ("put", "liveliness_token"):
        granted = {host: allowed(config, f"actor.{host}", "ingress", message) for host in hosts}
        for one, other in itertools.permutations(hosts, 2):
            pairs = itertools.product(granted[one], granted[other])
            assert not any(zenoh.KeyExpr(a).intersects(zenoh.KeyExpr(b)) for a, b in pairs)


@given(st.lists(LABELS, max_size=4))
def test_the_order_and_repetition_of_hosts_change_nothing(hosts: list[str]) -> None:
    assert access_control(hosts) == access_control({*reversed(hosts)})


@pytest.mark.parametrize("label", ["", "a-b", "*", "$*", "a/b", "LAB", "x" * 25, "lab\n", "@adv"])
def test_what_could_speak_for_others_is_no_label(label: str) -> None:
    with pytest.raises(ValueError, match="not a host's label"):
        access_control(["lab", label])
