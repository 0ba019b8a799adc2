"""Frames made to hurt: bombs, ambiguities and lies about size are refused, cheaply."""

import tracemalloc
from time import process_time

import msgpack
import numpy as np
import pytest

from protocol import PROTOCOL
from protocol.codec import MAX_NODES, Reason, Refused, decode, encode
from protocol.keys import MAX_FRAME_BYTES
from protocol.messages import Phase
from tests.protocol.golden.make import GOLDEN, path

MEBIBYTE = 1 << 20
HEAD = b"\x84\xa1p\x03\xa1k\xa7segment"


def refusal(frame: bytes) -> Refused:
    """Why the frame is refused."""
    with pytest.raises(Refused) as caught:
        decode(frame)
    assert len(str(caught.value)) <= 400
    return caught.value


def with_array(packed: object, name: object = "episode") -> bytes:
    """The golden segment with one array replaced by whatever it is."""
    envelope = msgpack.unpackb(path("segment-babble").read_bytes())
    envelope["a"][name] = packed
    return msgpack.packb(envelope)


def lists(depth: int, width: int, leaf: bytes) -> bytes:
    """Lists of `width` entries, the last of which is the next list, `depth` deep."""
    return (b"\xdc" + width.to_bytes(2, "big") + leaf * (width - 1)) * depth + leaf


BOMBS = {
    "deep lists": HEAD + b"\x91" * 200_000,
    "deep maps": HEAD + b"\x81\xa1h" * 200_000,
    "just as deep as msgpack goes": HEAD + b"\xa1h" + b"\x91" * 1000 + b"\x01",
    "a million empty lists": HEAD + b"\xa1h" + (b"\xdc\x01\x00" + b"\x90" * 256) * 4000,
    "a tree of lists": HEAD + b"\xa1h" + lists(1000, 256, b"\x90"),
    "a tree of short texts": HEAD + b"\xa1h" + lists(1000, 256, b"\xa2ab"),
    "a tree of maps": HEAD + b"\xa1h" + lists(1000, 256, b"\x81\xa1a\x80"),
    "promises of long lists": HEAD + b"\xa1h" + b"\xdc\x01\x00" * 1000,
    "promises of lists as long as the frame": HEAD + b"\xa1h" + b"\xdc\xea\x60" * 1000 + bytes(70_000),
    "promises of huge lists": HEAD + b"\xa1h" + b"\xdd\xff\xff\xff\xff" * 1000,
    "a promise of huge bytes": HEAD + b"\xa1a\xc6\xff\xff\xff\xff",
    "texts that grow fourfold": HEAD
    + b"\xa1h"
    + b"\xdc\x01\x00"
    + (b"\xdb\x00\x0f\xff\xff" + "\U0001f40c".encode() + b"a" * (MEBIBYTE - 5)) * 16,
    "a long text": b"\x81\xa1p\xdb" + (8 * MEBIBYTE).to_bytes(4, "big") + b"a" * 8 * MEBIBYTE,
    "bytes for a kind": msgpack.packb({"p": PROTOCOL, "k": b"a" * 8 * MEBIBYTE, "h": {}}),
    "bytes for a number": msgpack.packb({"p": b"a" * 8 * MEBIBYTE, "k": "ack", "h": {}}),
    "bytes for a shape": with_array(["<i4", b"a" * 8 * MEBIBYTE, b""]),
    "bytes for a name": with_array([], name=b"a" * 8 * MEBIBYTE),
    "a thousand unknown fields": msgpack.packb(
        {"p": PROTOCOL, "k": "ack", "h": {f"{i}" * 99: {f"{j}": j for j in range(20)} for i in range(256)}}
    ),
    "all scores wrong": msgpack.packb({"p": PROTOCOL, "k": "status", "h": {"scores": [{"a": 1}] * 256}}),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_a_bomb_is_refused_within_bounds_of_time_and_memory(bomb):
    frame = BOMBS[bomb]
    refusal(frame)
    tracemalloc.start()
    try:
        refusal(frame)
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    began = process_time()
    refusal(frame)
    assert process_time() - began < 1.0
    assert peak <= 4 * len(frame) + 32 * MEBIBYTE


def test_a_frame_has_a_bounded_number_of_values():
    crowd = msgpack.packb({"p": PROTOCOL, "k": "ack", "h": {"x": [[1] * 200] * 90}})
    assert f"more than {MAX_NODES} values" in str(refusal(crowd))


def test_frames_over_the_limit_are_refused_before_they_are_read():
    assert refusal(bytes(MAX_FRAME_BYTES + 1)).reason is Reason.OVERSIZED
    assert refusal(bytes(MAX_FRAME_BYTES)).reason is Reason.MALFORMED


def test_a_message_over_the_limit_is_not_let_out():
    segment = GOLDEN["segment-babble"]
    big = np.zeros((2, 3, MAX_FRAME_BYTES // 24), "<f4")
    huge = segment.model_copy(update={"arrays": {**segment.arrays, "observation": big}})
    with pytest.raises(Refused, match="send fewer steps or columns") as caught:
        encode(huge)
    assert caught.value.reason is Reason.OVERSIZED


def test_a_key_that_stands_twice_is_ambiguous():
    frame = path("ack").read_bytes()
    doubled = frame.replace(b"\xa4upto\x0c", b"\xa4upto\x0c\xa4upto\x0d")
    count = frame.index(b"\xa1h") + 2
    assert frame[count] == 0x8B
    doubled = doubled[:count] + b"\x8c" + doubled[count + 1 :]
    refused = refusal(doubled)
    assert refused.reason is Reason.MALFORMED
    assert "same key twice" in str(refused)
    assert refusal(b"\x84\xa1p\x02\xa1p\x02" + frame[4:]).reason is Reason.MALFORMED


@pytest.mark.parametrize("tail", [b"\x00", b"\xc0", path("ack").read_bytes()])
def test_nothing_may_follow_a_frame(tail):
    assert refusal(path("ack").read_bytes() + tail).reason is Reason.MALFORMED


@pytest.mark.parametrize("name", GOLDEN)
def test_every_truncation_is_refused(name):
    frame = path(name).read_bytes()
    for length in range(len(frame)):
        assert refusal(frame[:length]).reason is Reason.MALFORMED


@pytest.mark.parametrize(
    "frame", [b"", b"\xc0", b"\x90", b"\x01", b"\xa1p", b"\xc1", b"\x80", b"\xd6\xff1234"]
)
def test_what_is_no_map_of_a_frame_is_refused(frame):
    assert refusal(frame).reason in {Reason.MALFORMED, Reason.WRONG_PROTOCOL}


@pytest.mark.parametrize(
    "envelope",
    [
        {"p": PROTOCOL, "k": "ack"},
        {"p": PROTOCOL, "k": "ack", "h": []},
        {"p": PROTOCOL, "k": "ack", "h": {}, "a": {}},
        {"p": PROTOCOL, "k": "ack", "h": {}, "z": 1},
        {"p": PROTOCOL, "k": "segment", "h": {}},
        {"p": PROTOCOL, "k": "ack", b"h": {}},
    ],
)
def test_an_envelope_has_exactly_its_entries(envelope):
    assert refusal(msgpack.packb(envelope)).reason is Reason.MALFORMED


@pytest.mark.parametrize("number", [True, 3.0, "3", b"\x03", None, 0, 1, 2, 4, -1, 2**64 - 1, [1]])
def test_only_the_number_itself_is_the_protocol(number):
    refused = refusal(msgpack.packb({"p": number, "k": "ack", "h": {}}))
    assert refused.reason is Reason.WRONG_PROTOCOL


@pytest.mark.parametrize("code", [-1, 0, 5])
@pytest.mark.parametrize("length", [1, 4, 8, 12, 16, 100])
def test_extensions_do_not_travel(code, length):
    envelope = msgpack.unpackb(path("ack").read_bytes())
    envelope["h"]["upto"] = (
        msgpack.ExtType(code, bytes(length)) if code >= 0 else msgpack.Timestamp(1, length)
    )
    assert refusal(msgpack.packb(envelope)).reason is Reason.MALFORMED


GOOD = bytes(24)


@pytest.mark.parametrize(
    "packed",
    [
        ["<i4", [2, 3], GOOD[:-1]],
        ["<i4", [2, 3], GOOD + b"\0"],
        ["<i4", [2, 3], "text"],
        ["<i4", [2, 3], [0] * 24],
        ["<i4", [2, 3]],
        ["<i4", [2, 3], GOOD, 0],
        {"dtype": "<i4"},
        None,
        [">i4", [2, 3], GOOD],
        ["|O", [2, 3], GOOD],
        ["<i4,<i4", [1, 3], GOOD],
        ["i4", [2, 3], GOOD],
        [None, [2, 3], GOOD],
        [["<i4"], [2, 3], GOOD],
        ["<i4", [2, -3], GOOD],
        ["<i4", [-2, -3], GOOD],
        ["<i4", [2, 3.0], GOOD],
        ["<i4", [2, True], GOOD],
        ["<i4", ["2", "3"], GOOD],
        ["<i4", {"2": 3}, GOOD],
        ["<i4", 6, GOOD],
        ["<i4", [0], b""],
        ["<i4", [0, 2**26, 2**26, 2**26], b""],
        ["<i4", [2**62, 2**62], b""],
        ["<i4", [2**64 - 1], b""],
        ["<i4", [1, 1, 1, 1, 1, 2, 3], GOOD],
        ["<i4", [3, 2], GOOD],
        ["<i4", [6], GOOD],
        ["<f4", [2, 3], GOOD],
    ],
)
def test_an_array_is_what_it_says_and_what_its_message_needs(packed):
    refused = refusal(with_array(packed))
    assert refused.reason is Reason.BAD_ARRAY
    assert "episode" in str(refused)


@pytest.mark.parametrize("name", ["", "a" * 81, "surprise", "latent/body", b"raw"])
def test_an_array_that_does_not_belong_is_refused(name):
    assert refusal(with_array(["<i4", [2, 3], GOOD], name=name)).reason is Reason.BAD_ARRAY


def test_more_arrays_than_any_message_has_are_refused():
    envelope = msgpack.unpackb(path("segment-babble").read_bytes())
    envelope["a"] = {f"{i}": ["<i4", [2, 3], GOOD] for i in range(241)}
    assert "at most 240" in str(refusal(msgpack.packb(envelope)))


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"episode": None}, r"has \['observation'\], but lacks \['episode'\]"),
        ({"observation": None}, r"has \['episode'\], but neither observation nor image"),
        ({"image": np.zeros((2, 3, 4), "<f4")}, r"'image' must be \|u1 of shape \(T, E, ...\)"),
        ({"surprise": np.zeros((2, 3), "<i4")}, "may have .* but not 'surprise'"),
        ({"episode": np.zeros((2, 3), "<i8")}, r"must be <i4 of shape \(T, E\) .* but it is <i8"),
        ({"episode": np.zeros((2, 4), "<i4")}, r"\(T, E\) with T=2, E=3, but it is <i4 of shape \(2, 4\)"),
        ({"episode": np.zeros((2,), "<i4")}, r"of shape \(2,\)"),
        ({"episode": np.zeros((2, 3), object)}, r"\|O"),
        ({"observation": np.zeros((2, 3, 0), "<f4")}, "each 1 or more"),
        ({"observation": np.zeros((2, 3, 1, 1, 1, 1, 1), "<f4")}, "allowed: 6 sizes"),
    ],
)
def test_the_sender_hears_of_its_own_mistake(arrays, sentence):
    segment = GOLDEN["segment-babble"]
    wrong = {name: array for name, array in {**segment.arrays, **arrays}.items() if array is not None}
    with pytest.raises(Refused, match=sentence) as caught:
        encode(segment.model_copy(update={"arrays": wrong}))
    assert caught.value.reason is Reason.BAD_ARRAY


def test_a_size_is_the_same_in_all_arrays_of_a_message():
    segment = GOLDEN["segment-practise"]
    wrong = {**segment.arrays, "goal": np.zeros((2, 3, 4), "<f4")}
    with pytest.raises(Refused, match=r"'goal' must be <f4 of shape \(T, E, d\) with T=2, E=3, d=2"):
        encode(segment.model_copy(update={"arrays": wrong}))


@pytest.mark.parametrize(
    ("arrays", "sentence"),
    [
        ({"state": None}, r"a recorder's segment of practise has .* but lacks \['state'\]"),
        ({"goal/hand": None}, r"has .* but lacks \['goal/hand'\]"),
        ({"latent/thumb": None}, r"has .* but lacks \['latent/thumb'\]"),
        ({"goal/hand": np.zeros((2, 3, 2), "<f4")}, r"'goal/hand' must .* with T=2, E=3, d of hand=5"),
        ({"latent/hand": np.zeros((2, 3, 5), "<f8")}, r"'latent/hand' must be <f4"),
        ({"state": np.zeros((2, 4, 4), "<f4")}, r"'state' must be <f4 of shape \(T, E, s\)"),
        ({"observation": np.zeros((2, 3, 4), "<f4")}, "may have .* but not 'observation'"),
        ({"action/hand": np.zeros((2, 3, 4), "<f4")}, "may have .* but not 'action/hand'"),
        ({"latent/../x": np.zeros((2, 3, 4), "<f4")}, "may have .* but not 'latent/../x'"),
        ({"latent/hand\n": np.zeros((2, 3, 5), "<f4")}, "may have .* but not"),
        ({"latent/": np.zeros((2, 3, 4), "<f4")}, "may have .* but not 'latent/'"),
    ],
)
def test_the_recorder_is_sent_each_block_whole_and_nothing_else(arrays, sentence):
    segment = GOLDEN["segment-recorder"]
    wrong = {name: array for name, array in {**segment.arrays, **arrays}.items() if array is not None}
    with pytest.raises(Refused, match=sentence) as caught:
        encode(segment.model_copy(update={"arrays": wrong}))
    assert caught.value.reason is Reason.BAD_ARRAY


def test_the_recorder_is_sent_the_whole_body_in_a_phase_in_which_it_acts():
    segment = GOLDEN["segment-recorder"]
    with pytest.raises(Refused, match="the recorder is sent 'all', not 'body'") as caught:
        encode(segment.model_copy(update={"block": "body"}))
    assert caught.value.reason is Reason.BAD_HEADER
    with pytest.raises(Refused, match="nobody sends experience in encode"):
        encode(segment.model_copy(update={"phase": Phase.ENCODE}))


def test_a_hundred_blocks_with_the_longest_names_can_be_recorded():
    segment = GOLDEN["segment-recorder"]
    names = [f"{what}/{f'{i:03d}' + 'x' * 61}" for i in range(100) for what in ("latent", "goal")]
    arrays = {"state": segment.arrays["state"], "episode": segment.arrays["episode"]}
    full = segment.model_copy(update={"arrays": arrays | dict.fromkeys(names, np.ones((2, 3, 5), "<f4"))})
    assert decode(encode(full)) == full


@pytest.mark.parametrize(
    ("name", "arrays", "sentence"),
    [
        ("view-latent-trail", {"trail": np.zeros((5, 3), "<f4")}, r"'trail' must be <f4 of shape \(K, d\)"),
        ("view-latent-trail", {"path": np.zeros((4, 4), "<f4")}, r"\(K, p\) with p=4, K=5"),
        ("view-latent-trail", {"latent": None}, r"a latent view has .* but lacks \['latent'\]"),
        ("view-posture", {"latent": np.zeros((3, 2), "<f4")}, "a posture view may have .* but not 'latent'"),
        ("view-pose", {"quaternion": np.zeros((5, 4), "<f4")}, r"\(B, 4\) with B=6"),
        ("view-pose", {"position": np.zeros((6, 2), "<f4")}, r"\(B, 3\)"),
        ("view-pose-touch", {"touch": np.zeros((7, 3), "<f4")}, r"'touch' must be <f4 of shape \(N,\)"),
        ("view-image", {"pixels": np.zeros((2, 4, 4), "|u1")}, r"\(H, W, 3\)"),
        ("view-image", {"pixels": np.zeros((2, 4, 3), "<f4")}, r"must be \|u1"),
    ],
)
def test_a_view_has_the_arrays_of_what_it_shows(name, arrays, sentence):
    view = GOLDEN[name]
    wrong = {each: array for each, array in {**view.arrays, **arrays}.items() if array is not None}
    with pytest.raises(Refused, match=sentence) as caught:
        encode(view.model_copy(update={"arrays": wrong}))
    assert caught.value.reason is Reason.BAD_ARRAY
