"""Processes that disagree about what the world senses do not understand one another."""

from services.runtime.interface import interface_of
from services.runtime.settings import parse

SETTINGS = parse({"scenario": "test"}, origin="test")
SENSES = {"joints": (3,), "touch": (3,), "eyes": (2, 8, 8, 3)}


def fingerprint(senses):
    return interface_of(SETTINGS, senses=senses, action_size=3).fingerprint()


def test_the_fingerprint_knows_every_sense_its_shape_and_their_order():
    others = [
        {"joints": (3,), "touch": (3,)},
        SENSES | {"eyes": (1, 16, 8, 3)},
        {"touch": (3,), "joints": (3,), "eyes": (2, 8, 8, 3)},
        {"joints": (6,), "eyes": (2, 8, 8, 3)},
    ]
    assert len({fingerprint(senses) for senses in (SENSES, *others)}) == 5
    assert fingerprint(SENSES) == fingerprint(dict(SENSES))
