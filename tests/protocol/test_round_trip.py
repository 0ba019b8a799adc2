"""What goes in comes out: golden frames, and every message that can be."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from protocol import keys
from protocol.codec import decode, encode
from protocol.gate import Gate
from protocol.messages import (
    MAX_CONFIG_CHARS,
    MAX_REPLY_CHARS,
    MESSAGES,
    Progress,
    Reply,
    Score,
    Status,
    WithArrays,
)
from tests.protocol.golden.make import GOLDEN, header, path
from tests.protocol.strategies import messages, progresses, scores


@pytest.mark.parametrize("name", GOLDEN)
def test_a_golden_frame_means_what_it_meant(name):
    frame = path(name).read_bytes()
    message = decode(frame)
    assert message == GOLDEN[name]
    assert type(message) is type(GOLDEN[name])
    assert encode(message) == frame


def test_every_kind_has_a_golden_frame_and_every_golden_frame_a_message():
    assert {message.kind for message in GOLDEN.values()} == set(MESSAGES)
    assert {file.stem for file in path("ack").parent.glob("*.bin")} == set(GOLDEN)


def test_messages_with_arrays_differ_if_only_the_arrays_do():
    golden = GOLDEN["view"]
    assert golden.model_copy(update={"arrays": {"latent": golden.arrays["latent"]}}) != golden
    assert (
        golden.model_copy(update={"arrays": {n: a.astype("<f8") for n, a in golden.arrays.items()}}) != golden
    )
    assert golden.model_copy(update={"arrays": {n: a + 1 for n, a in golden.arrays.items()}}) != golden
    assert golden.model_copy(update={"title": "another"}) != golden
    assert len({golden, decode(encode(golden))}) == 1


@pytest.mark.parametrize("kind", MESSAGES)
@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_every_message_comes_back_the_same(kind, data):
    message = data.draw(messages[kind])
    frame = encode(message)
    back = decode(frame)
    assert encode(back) == frame
    assert type(back) is type(message)
    if "nan" not in repr(message):
        assert back == message
    if isinstance(back, WithArrays):
        assert not any(array.flags.writeable for array in back.arrays.values())


@pytest.mark.parametrize("kind", sorted(set(MESSAGES) - {"model"}))
@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(data=st.data())
def test_every_message_passes_the_gate_on_its_own_key(kind, data):
    message = data.draw(messages[kind])
    gate = Gate(message.run, {kind}, getattr(message, "fingerprint", None))
    key = keys.of(message).replace("*", "coordinator")
    assert gate.admit(key, encode(message)) is not None, gate.last_refusal


@given(progress=progresses, score=scores)
def test_nested_messages_come_back_as_themselves(progress, score):
    status = Status(**header(), service="policy_learner", progress=[progress], scores=[score])
    back = decode(encode(status))
    assert isinstance(back.progress[0], Progress)
    assert isinstance(back.scores[0], Score)
    assert back == status


def test_the_fullest_status_the_longest_reply_and_the_longest_settings_travel():
    status = GOLDEN["status"]
    full = status.model_copy(
        update={
            **{
                name: {f"{i}": 2**53 for i in range(256)}
                for name in ("versions", "totals", "metrics", "refused")
            },
            "progress": list(status.progress) * 256,
            "scores": [status.scores[0].model_copy(update={"encoder_version": 1, "policy_version": 1})] * 256,
        }
    )
    assert decode(encode(full)) == full
    reply = Reply(**header(), id="q", ok=True, text="\U0001f40c" * MAX_REPLY_CHARS)
    assert decode(encode(reply)) == reply
    settings = GOLDEN["settings"].model_copy(update={"config": "~" * MAX_CONFIG_CHARS})
    assert decode(encode(settings)) == settings


def test_a_default_does_not_travel_but_is_there_on_arrival():
    bare = GOLDEN["segment-evaluate"]
    assert b"encoder_version" not in encode(bare)
    assert decode(encode(bare)).encoder_version == 0


def test_arrays_that_are_not_contiguous_travel_as_they_look():
    golden = GOLDEN["segment-babble"]
    wide = np.arange(2 * 3 * 8, dtype="<f4").reshape(2, 3, 8)
    sliced = golden.model_copy(
        update={"arrays": {"observation": wide[:, :, ::2], "episode": golden.arrays["episode"].T.copy().T}}
    )
    assert np.array_equal(decode(encode(sliced)).arrays["observation"], wide[:, :, ::2])
