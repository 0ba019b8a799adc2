"""Processes that disagree about what the world senses, or about the blocks, do not understand one another."""

from babble.blocks import BlockSpec
from services.runtime.interface import interface_of
from services.runtime.settings import parse

SETTINGS = parse({"scenario": "test"}, origin="test")
SENSES = {"joints": (3,), "touch": (3,), "eyes": (2, 8, 8, 3)}
BODY = BlockSpec("body", latent_dim=2)


def fingerprint(senses, *blocks):
    made = interface_of(SETTINGS, senses=senses, action_size=3, blocks=blocks or [BODY])
    return made.fingerprint()


def test_the_fingerprint_knows_every_sense_its_shape_and_their_order():
    others = [
        {"joints": (3,), "touch": (3,)},
        SENSES | {"eyes": (1, 16, 8, 3)},
        {"touch": (3,), "joints": (3,), "eyes": (2, 8, 8, 3)},
        {"joints": (6,), "eyes": (2, 8, 8, 3)},
    ]
    assert len({fingerprint(senses) for senses in (SENSES, *others)}) == 5
    assert fingerprint(SENSES) == fingerprint(dict(SENSES))


def test_the_fingerprint_knows_the_blocks_by_what_their_patterns_mean_in_the_world():
    parts = [BlockSpec("a", 2, observes=(0, 1), drives=(0, 1)), BlockSpec("b", 2, observes=(2,), drives=(2,))]
    other = [parts[0], BlockSpec("b", 2, observes=(3,), drives=(2,))]
    above = [*parts, BlockSpec("hand", 2, children=("a", "b"))]
    assert len({fingerprint(SENSES, *blocks) for blocks in ([BODY], parts, other, above)}) == 4
    assert fingerprint(SENSES, *parts) == fingerprint(SENSES, *reversed(parts))


def test_of_a_flat_body_it_is_as_it_was_before_there_were_trees():
    named = interface_of(SETTINGS, senses={"position": (2,)}, action_size=2, blocks=[BODY])
    assert named.canonical_json().count('"children":[],"drives":null,"latent_dim":2') == 1
