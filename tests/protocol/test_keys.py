"""Keys: one pattern per kind, safe chunks, and liveliness keys that can be read back."""

import pytest
from hypothesis import given

from protocol import keys
from protocol.keys import DELIVERY
from protocol.messages import MESSAGES
from tests.protocol.golden.make import GOLDEN
from tests.protocol.strategies import names


def test_every_kind_that_is_sent_by_itself_has_a_delivery():
    assert set(DELIVERY) == set(MESSAGES) - {"reply"}


@pytest.mark.parametrize(
    ("name", "key"),
    [
        ("segment-babble", "babble/cuboid-1/segment/encoder_learner/body/actor-7f3a"),
        ("ack", "babble/cuboid-1/ack/actor-7f3a/policy_learner"),
        ("model", "babble/cuboid-1/model/encoder/body"),
        ("phase", "babble/cuboid-1/phase"),
        ("settings", "babble/cuboid-1/settings"),
        ("status", "babble/cuboid-1/status/policy_learner/policy-0c11"),
        ("view", "babble/cuboid-1/view/latent/actor-7f3a"),
        ("command", "babble/cuboid-1/command/*"),
        ("reply", "babble/cuboid-1/command/*"),
    ],
)
def test_the_key_of_each_kind(name, key):
    assert keys.of(GOLDEN[name]) == key


def test_control_never_shares_a_connection_with_data():
    assert {kind for kind, row in DELIVERY.items() if row.link == "data"} == {"segment", "model", "view"}
    assert all(row.on_full == "drop" for row in DELIVERY.values() if row.link == "control")


def test_only_what_may_not_be_lost_blocks_its_sender():
    assert {kind for kind, row in DELIVERY.items() if row.on_full == "block"} == {"segment", "model"}


@given(run=names, service=names, life=names)
def test_a_liveliness_key_says_who_lives(run, service, life):
    assert keys.member(keys.alive(run, service, life)) == (service, life)
    assert keys.is_member(keys.alive(run, service, life))


@pytest.mark.parametrize(
    "key",
    [
        "",
        "babble/r/alive/actor",
        "babble/r/alive/actor/a/b",
        "other/r/alive/actor/a",
        "babble/r/status/actor/a",
        "babble/*/alive/actor/a",
        "babble/r/alive/actor/a-$*",
        "babble/r/alive/actor/A",
        "babble/r/alive/actor/a\n",
        "babble/r/alive/actor/" + "a" * 65,
    ],
)
def test_another_key_is_no_liveliness_key(key):
    with pytest.raises(ValueError, match="is not a liveliness key babble/<run>/alive/<service>/<life>"):
        keys.member(key)
    assert not keys.is_member(key)
