"""A hundred thousand broken frames: none gets through changed, none raises, none costs much."""

import random
import tracemalloc
from collections.abc import Callable
from copy import deepcopy
from time import process_time
from typing import Any

import msgpack
import pytest

from protocol import keys
from protocol.codec import decode, encode
from protocol.gate import Gate
from protocol.messages import MESSAGES
from tests.protocol.golden.make import GOLDEN, path

FRAMES = 100_000
CPU_SECS = 40.0
SEEDS = {name: path(name).read_bytes() for name in GOLDEN}
KEYS = {name: keys.of(message).replace("*", "coordinator") for name, message in GOLDEN.items()}
STRANGE: list[Any] = [
    None,
    True,
    0,
    -1,
    2**53,
    2**63,
    2**64 - 1,
    -(2**63),
    0.5,
    float("nan"),
    float("inf"),
    "",
    "1",
    "walk",
    "a" * 3000,
    "\0",
    "ü",
    b"",
    b"walk",
    b"\xff" * 40,
    [],
    {},
    [[]],
    {"": None},
    msgpack.ExtType(5, b""),
    list(range(300)),
]

Mutation = Callable[[random.Random, bytes], bytes]


def flip(rng: random.Random, frame: bytes) -> bytes:
    """Some bits of some bytes."""
    out = bytearray(frame)
    for _ in range(rng.choice((1, 1, 2, 8))):
        out[rng.randrange(len(out))] ^= 1 << rng.randrange(8)
    return bytes(out)


def truncate(rng: random.Random, frame: bytes) -> bytes:
    """The beginning, or the end."""
    cut = rng.randrange(len(frame))
    return frame[:cut] if rng.random() < 0.7 else frame[cut:]


def splice(rng: random.Random, frame: bytes) -> bytes:
    """The beginning of one frame and the end of another."""
    other = rng.choice(list(SEEDS.values()))
    return frame[: rng.randrange(len(frame))] + other[rng.randrange(len(other)) :]


def insert(rng: random.Random, frame: bytes) -> bytes:
    """Some bytes more, preferably those that begin something in MessagePack."""
    place = rng.randrange(len(frame) + 1)
    more = bytes(rng.choice((0x80, 0x90, 0xC1, 0xC6, 0xDB, 0xDD, 0xDF, rng.randrange(256))) for _ in range(3))
    return frame[:place] + more[: rng.randrange(1, 4)] + frame[place:]


def delete(rng: random.Random, frame: bytes) -> bytes:
    """Some bytes fewer."""
    place = rng.randrange(len(frame))
    return frame[:place] + frame[place + rng.randrange(1, 9) :]


def _containers(value: Any) -> list[Any]:
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    mine = [value] if isinstance(value, dict | list) and value else []
    return mine + [found for child in inner for found in _containers(child)]


def restructure(rng: random.Random, frame: bytes) -> bytes:
    """A well-formed frame with another structure: types swapped, entries added, gone, moved, resized."""
    envelope = TREES[frame]()
    containers = _containers(envelope)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        target = rng.choice(containers)
        where = rng.choice(list(target)) if isinstance(target, dict) else rng.randrange(len(target))
        match rng.randrange(6):
            case 0 | 1:
                target[where] = deepcopy(rng.choice(STRANGE))
            case 2 if isinstance(target, dict):
                target[rng.choice(("x", "arrays", "run", b"run", "", "seq"))] = deepcopy(rng.choice(STRANGE))
            case 3 if isinstance(target, dict) and len(target) > 1:
                del target[where]
            case 4:
                target[where] = deepcopy(rng.choice(containers))
            case _ if isinstance(target[where], bytes | str | list):
                target[where] = target[where][1:] or target[where] * 2
            case _:
                target[where] = [target[where]]
        containers = _containers(envelope)
        if not containers:
            break
    return msgpack.packb(envelope)


def _tree(frame: bytes) -> Callable[[], Any]:
    return lambda: msgpack.unpackb(frame)


TREES = {frame: _tree(frame) for frame in SEEDS.values()}
MUTATIONS: list[Mutation] = [flip, truncate, splice, insert, delete, restructure, restructure, restructure]


def broken(rng: random.Random, count: int) -> list[tuple[str, bytes]]:
    """`count` mutated golden frames, each with the key of what it was."""
    names = list(SEEDS)
    return [
        (KEYS[name], rng.choice(MUTATIONS)(rng, SEEDS[name]))
        for name in (rng.choice(names) for _ in range(count))
    ]


def gate() -> Gate:
    """A gate that lets the golden frames in."""
    return Gate("cuboid-1", set(MESSAGES), fingerprint="0123456789abcdef")


@pytest.mark.timeout(200)
def test_no_mutation_raises_or_gets_through_as_something_it_is_not():
    rng, door, cpu_secs, slowest_secs = random.Random(20240607), gate(), 0.0, 0.0
    for _ in range(FRAMES // 1000):
        for key, frame in broken(rng, 1000):
            began = process_time()
            message = door.admit(key, frame)
            took = process_time() - began
            cpu_secs += took
            slowest_secs = max(slowest_secs, took)
            assert len(door.last_refusal) <= 400
            if message is not None:
                assert encode(decode(encode(message))) == encode(message)
                assert keys.of(message).replace("*", "coordinator") == key
    assert sum(door.refused.values()) + door.admitted == FRAMES
    assert cpu_secs < CPU_SECS
    assert slowest_secs < 1.0
    assert door.admitted < FRAMES // 4, "most mutations must hurt, or they test nothing"
    assert {"malformed", "wrong-protocol", "unknown-kind", "bad-header", "bad-array"} <= door.refused.keys()
    assert {"foreign-run", "wrong-key", "wrong-fingerprint", "wrong-digest"} <= door.refused.keys()


def test_broken_frames_leave_no_memory_behind_and_need_little():
    frames = broken(random.Random(7), 5000)
    door = gate()
    for key, frame in frames[:500]:
        door.admit(key, frame)
    tracemalloc.start()
    try:
        before, _ = tracemalloc.get_traced_memory()
        tracemalloc.reset_peak()
        for key, frame in frames:
            door.admit(key, frame)
        after, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak - before < 8 << 20
    assert after - before < 1 << 20
