"""The interface, its fingerprint, and what is said when two differ."""

import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from protocol.specs import BlockInterface, InterfaceSpec, describe_difference

FINGER = BlockInterface(name="finger", latent_dim=2, observes=(0, 1), drives=(0,))
THUMB = BlockInterface(name="thumb", latent_dim=3, observes=(2, 3), drives=(1,))
HAND = BlockInterface(name="hand", latent_dim=4, children=("finger", "thumb"))


def spec(**changes: object) -> InterfaceSpec:
    """A hand of two digits."""
    fields = {
        "world": "Hand",
        "parameters": {"size": 1.5, "soft": True, "joints": [1, 2]},
        "senses": {"angles": (2,), "touch": (2, 3)},
        "action_size": 2,
        "blocks": (HAND, FINGER, THUMB),
    }
    return InterfaceSpec(**{**fields, **changes})


def test_the_example_of_the_document():
    body = BlockInterface(name="body", latent_dim=2)
    found = InterfaceSpec(
        world="Cuboid", parameters={"size": 1.0}, senses={"position": (2,)}, action_size=2, blocks=(body,)
    )
    assert found.canonical_json() == (
        '{"action_size":2,"blocks":[{"children":[],"drives":null,"latent_dim":2,"name":"body","observes":null}],'
        '"parameters":{"size":1},"senses":[["position",[2]]],"world":"Cuboid"}'
    )
    assert found.fingerprint() == "688b7f09192301ec"


@pytest.mark.parametrize(
    "same",
    [
        {"blocks": (FINGER, THUMB, HAND)},
        {"parameters": {"joints": [1.0, 2], "soft": True, "size": 1.5}},
    ],
)
def test_what_makes_no_difference_has_the_same_fingerprint(same):
    assert spec(**same).fingerprint() == spec().fingerprint()
    assert (
        describe_difference(spec(), spec(**same)) == f"the interfaces are the same ({spec().fingerprint()})"
    )


DIFFERENCES = [
    ({"world": "Foot"}, 'world is "Hand" here and "Foot" there'),
    ({"action_size": 3}, "action_size is 2 here and 3 there"),
    ({"parameters": {"size": 1.5, "joints": [1, 2]}}, "parameters.soft is true here and absent there"),
    (
        {"parameters": {"size": 1.5, "soft": 1, "joints": [1, 2]}},
        "parameters.soft is true here and 1 there",
    ),
    ({"senses": {"angles": (2,), "touch": (3, 2)}}, "senses.touch is [2,3] here and [3,2] there"),
    (
        {"senses": {"touch": (2, 3), "angles": (2,)}},
        'the order of the senses is ["angles","touch"] here and ["touch","angles"] there',
    ),
    (
        {"blocks": (HAND, FINGER, THUMB.model_copy(update={"latent_dim": 5}))},
        "blocks.thumb.latent_dim is 3 here and 5 there",
    ),
    (
        {"blocks": (HAND.model_copy(update={"children": ("thumb", "finger")}), FINGER, THUMB)},
        'blocks.hand.children is ["finger","thumb"] here and ["thumb","finger"] there',
    ),
    (
        {"blocks": (HAND, FINGER.model_copy(update={"observes": None}), THUMB)},
        "blocks.finger.observes is [0,1] here and null there",
    ),
]


@pytest.mark.parametrize(("change", "sentence"), DIFFERENCES)
def test_each_difference_changes_the_fingerprint_and_is_named(change, sentence):
    ours, theirs = spec(), spec(**change)
    assert ours.fingerprint() != theirs.fingerprint()
    assert describe_difference(ours, theirs) == (
        f"the interfaces differ ({ours.fingerprint()} here, {theirs.fingerprint()} there): {sentence}"
    )


def test_many_and_long_differences_are_still_one_sentence():
    long = {"blocks": (BlockInterface(name="b", latent_dim=2, observes=tuple(range(8))),), "world": "W" * 200}
    text = describe_difference(spec(parameters={str(i): "x" * 500 for i in range(100)}), spec(**long))
    assert "and 117 more" in text
    assert len(text) <= 800
    almost = [
        spec(senses={"a": (900,)}, blocks=(BlockInterface(name="b", latent_dim=2, observes=tuple(range(n))),))
        for n in (500, 501)
    ]
    assert "blocks.b.observes is [0,1" in describe_difference(*almost)


def test_the_fingerprint_is_the_same_in_another_process():
    code = "from tests.protocol.test_specs import spec; print(spec().fingerprint())"
    found = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env={"PYTHONPATH": ".", "PYTHONHASHSEED": "7"},
    )
    assert found.stdout.strip() == spec().fingerprint()


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=5), inner, max_size=3),
    max_leaves=8,
)


@given(parameters=st.dictionaries(st.text(max_size=9), json_values, max_size=4))
def test_any_parameters_survive_their_own_json(parameters):
    first = spec(parameters=parameters)
    again = InterfaceSpec.model_validate_json(first.model_dump_json())
    assert again.fingerprint() == first.fingerprint()
    assert len(first.fingerprint()) == 16
    assert set(first.fingerprint()) <= set("0123456789abcdef")


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"parameters": {"size": float("nan")}}, "Out of range float values"),
        ({"parameters": {"size": float("inf")}}, "Out of range float values"),
        ({"blocks": (FINGER, FINGER)}, "must be distinct"),
        ({"blocks": (BlockInterface(name="all", latent_dim=2),)}, "none may be 'all'"),
        ({"blocks": (HAND, FINGER)}, "hand has the child thumb, which is no block"),
        (
            {"blocks": (HAND, FINGER, THUMB, HAND.model_copy(update={"name": "fist"}))},
            "finger is a child of both hand and fist",
        ),
        ({"blocks": (HAND.model_copy(update={"children": ("hand",)}),)}, "hand is below itself"),
        ({"senses": {"angles": (3,)}}, "thumb observes index 3, but the world has only 3"),
        ({"action_size": 1}, "thumb drives index 1, but the world has only 1"),
    ],
)
def test_an_interface_that_cannot_be_is_refused(change, sentence):
    with pytest.raises(ValueError, match=sentence):
        spec(**change)


def test_a_long_cycle_is_found():
    ring = tuple(BlockInterface(name=f"b{i}", latent_dim=2, children=(f"b{(i + 1) % 5}",)) for i in range(5))
    with pytest.raises(ValueError, match="below itself"):
        spec(blocks=ring)
