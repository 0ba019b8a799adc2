"""Each reason for refusal: what triggers it, that it is counted, and that its sentence names both values."""

import hashlib
from collections.abc import Callable

import msgpack
import numpy as np
import pytest

from protocol import keys
from protocol.codec import Reason, encode
from protocol.gate import Gate
from protocol.keys import MAX_FRAME_BYTES
from protocol.latest import LatestModel, LatestPhase
from protocol.ledger import Ledger
from protocol.messages import MESSAGES, Message, Phase
from protocol.refusal import Refused
from tests.protocol.golden.make import GOLDEN, path

RUN = "cuboid-1"
FINGERPRINT = "0123456789abcdef"


def gate(**changes: object) -> Gate:
    """A gate that lets all golden messages in."""
    return Gate(**{"run": RUN, "kinds": set(MESSAGES), "fingerprint": FINGERPRINT, **changes})


def key_of(message: Message) -> str:
    """The key of a message, asked of the coordinator where it is a question."""
    return keys.of(message).replace("*", "coordinator")


def heard(name: str, door: Gate, **changes: object) -> None:
    """A golden message with changes, on the key that fits it."""
    message = GOLDEN[name].model_copy(update=changes)
    door.admit(key_of(message), encode(message))


def altered(door: Gate, **entries: object) -> None:
    """The golden ack with other entries in its envelope."""
    envelope = msgpack.unpackb(path("ack").read_bytes())
    door.admit(key_of(GOLDEN["ack"]), msgpack.packb({**envelope, **entries}))


def on_key(name: str, key: str) -> Callable[[Gate], None]:
    """A golden frame on another key."""
    return lambda door: door.admit(key, path(name).read_bytes()) and None


def stale_model(door: Gate) -> None:
    latest = LatestModel()
    for version in (5, 4):
        model = GOLDEN["model"].model_copy(update={"version": version})
        if not latest.admit(model):
            door.refuse(Refused(Reason.STALE, latest.last_stale))


def stale_phase(door: Gate) -> None:
    latest = LatestPhase()
    for phase in (Phase.WALK, Phase.REFINE):
        announced = GOLDEN["phase"].model_copy(update={"phase": phase})
        if not latest.admit(announced):
            door.refuse(Refused(Reason.STALE, latest.last_stale))


def in_ledger(*seqs: int, max_lives: int = 9, life: str = "a") -> Callable[[Gate], None]:
    """Segment 0 of a life is taken; then come these numbers of `life`."""

    def come(door: Gate) -> None:
        ledger = Ledger(max_lives=max_lives)
        ledger.accept("a", "body", 0)
        for seq in seqs:
            door.refuse(ledger.refuse(life, "body", seq))

    return come


OTHER_DIGEST = hashlib.sha256(b"other").hexdigest()
TRUE_DIGEST = hashlib.sha256(bytes(range(16))).hexdigest()
SEGMENT_KEY = "babble/cuboid-1/segment/encoder_learner/body/actor-7f3a"

CASES: list[tuple[Reason, Callable[[Gate], None], list[str]]] = [
    (
        Reason.OVERSIZED,
        lambda door: door.admit("k", bytes(MAX_FRAME_BYTES + 1)) and None,
        [str(MAX_FRAME_BYTES + 1), str(MAX_FRAME_BYTES)],
    ),
    (Reason.MALFORMED, lambda door: door.admit("k", b"\xc1") and None, ["not a MessagePack frame"]),
    (Reason.WRONG_PROTOCOL, lambda door: altered(door, p=1), ["speaks protocol 1", "speaks 3"]),
    (Reason.UNKNOWN_KIND, lambda door: altered(door, k="nack"), ["'nack'", "'ack'"]),
    (Reason.BAD_HEADER, lambda door: altered(door, h={"run": 7}), ["ack header: run", "7"]),
    (
        Reason.BAD_ARRAY,
        lambda door: (
            door.admit(
                "k",
                msgpack.packb(
                    {
                        **msgpack.unpackb(path("model").read_bytes()),
                        "a": {"onnx": ["|u1", [2, 2], b"abcd"]},
                    }
                ),
            )
            and None
        ),
        ["(n,)", "(2, 2)"],
    ),
    (Reason.FOREIGN_RUN, lambda door: heard("ack", door, run="other"), ["'other'", "'cuboid-1'"]),
    (Reason.FOREIGN_RUN, lambda door: heard("command", door, run="other"), ["'other'", "'cuboid-1'"]),
    (
        Reason.WRONG_KEY,
        on_key("segment-babble", SEGMENT_KEY.replace("7f3a", "ffff")),
        ["actor-ffff", "actor-7f3a"],
    ),
    (
        Reason.WRONG_KEY,
        on_key("segment-babble", SEGMENT_KEY.replace("/body/", "/hand/")),
        ["/hand/", "/body/"],
    ),
    (
        Reason.WRONG_KEY,
        on_key("segment-babble", SEGMENT_KEY.replace("encoder", "policy")),
        ["policy_learner", "encoder_learner"],
    ),
    (Reason.WRONG_KEY, on_key("segment-babble", SEGMENT_KEY + "/more"), ["/more"]),
    (Reason.WRONG_KEY, on_key("segment-babble", SEGMENT_KEY.replace("cuboid-1", "x")), ["/x/", "/cuboid-1/"]),
    (
        Reason.WRONG_KEY,
        on_key("status", "babble/cuboid-1/status/actor/policy-0c11"),
        ["/actor/", "/policy_learner/"],
    ),
    (Reason.WRONG_KEY, on_key("model", "babble/cuboid-1/model/policy/body"), ["/policy/", "/encoder/"]),
    (Reason.WRONG_KEY, on_key("command", "babble/cuboid-1/command"), ["/command'"]),
    (Reason.WRONG_KEY, on_key("command", "babble/cuboid-1/command/"), ["/command/'"]),
    (Reason.WRONG_KEY, on_key("reply", "babble/cuboid-1/command/a/b"), ["/command/a/b'"]),
    (
        Reason.UNEXPECTED,
        lambda door: heard("view", door),
        ["a view", "['ack', 'command'"],
    ),
    (
        Reason.WRONG_FINGERPRINT,
        lambda door: heard("segment-babble", door, fingerprint="f" * 16),
        ["f" * 16, FINGERPRINT],
    ),
    (
        Reason.WRONG_FINGERPRINT,
        lambda door: heard("model", door, fingerprint="f" * 16),
        ["f" * 16, FINGERPRINT],
    ),
    (
        Reason.WRONG_DIGEST,
        lambda door: heard("model", door, digest=OTHER_DIGEST),
        [OTHER_DIGEST, TRUE_DIGEST],
    ),
    (
        Reason.WRONG_DIGEST,
        lambda door: heard("model", door, arrays={"onnx": np.zeros(16, np.uint8)}),
        [hashlib.sha256(bytes(16)).hexdigest(), TRUE_DIGEST],
    ),
    (Reason.STALE, stale_model, ["encoder 4", "than 5"]),
    (Reason.STALE, stale_phase, ["refine of term 3", "walk of term 3"]),
    (Reason.DUPLICATE, in_ledger(0), ["segment 0", "1 is expected"]),
    (Reason.OUT_OF_ORDER, in_ledger(7), ["segment 7", "1 is expected"]),
    (Reason.NO_ROOM, in_ledger(0, max_lives=1, life="b"), ["b/body"]),
]


@pytest.mark.parametrize(
    ("reason", "trigger", "named"), CASES, ids=[f"{i}-{c[0]}" for i, c in enumerate(CASES)]
)
def test_a_refusal_is_counted_by_its_reason_and_says_what_and_why(reason, trigger, named):
    kinds = set(MESSAGES) - ({"view"} if reason is Reason.UNEXPECTED else set())
    door = gate(kinds=kinds)
    trigger(door)
    trigger(door)
    assert door.refused == {reason.value: 2}
    assert door.admitted == 0
    for value in named:
        assert value in door.last_refusal
    assert "\n" not in door.last_refusal
    assert len(door.last_refusal) <= 400


def test_every_reason_has_a_case():
    assert {reason for reason, _, _ in CASES} == set(Reason)


@pytest.mark.parametrize("name", GOLDEN)
def test_golden_frames_are_let_in(name):
    door = gate()
    assert door.admit(key_of(GOLDEN[name]), path(name).read_bytes()) == GOLDEN[name]
    assert (door.admitted, door.refused, door.last_refusal) == (1, {}, "")


def test_a_gate_without_a_fingerprint_takes_any():
    door = gate(fingerprint=None)
    heard("segment-babble", door, fingerprint="f" * 16)
    assert door.admitted == 1


def test_a_refusal_does_not_close_the_gate():
    door = gate()
    door.admit("k", b"")
    heard("ack", door)
    assert (door.admitted, door.refused) == (1, {"malformed": 1})


@pytest.mark.parametrize("kinds", ["segment", {"segmnet"}, {"segment", "other"}])
def test_a_gate_for_kinds_that_do_not_exist_is_a_mistake(kinds):
    with pytest.raises(ValueError, match="a gate needs a set of kinds"):
        Gate(RUN, kinds)
