"""Nothing is converted on arrival: what is not exactly of its type is refused as a bad header."""

from typing import Any

import msgpack
import pytest

from protocol.codec import Reason, Refused, decode, encode
from protocol.messages import Phase, Score, Segment, Status
from tests.protocol.golden.make import GOLDEN, path


def changed(name: str, change: dict[str, Any], *, of: str | None = None) -> bytes:
    """A golden frame with other header fields, or other fields of the first entry of a list."""
    envelope = msgpack.unpackb(path(name).read_bytes())
    target = envelope["h"] if of is None else envelope["h"][of][0]
    target.update(change)
    return msgpack.packb(envelope)


def refusal(frame: bytes) -> Refused:
    """Why the frame is refused."""
    with pytest.raises(Refused) as caught:
        decode(frame)
    return caught.value


WRONG: list[tuple[str, str, Any]] = [
    ("ack", "upto", "1"),
    ("ack", "upto", 1.0),
    ("ack", "upto", True),
    ("ack", "upto", None),
    ("ack", "upto", b"1"),
    ("ack", "upto", -1),
    ("ack", "upto", 2**53 + 1),
    ("ack", "upto", 2**64 - 1),
    ("ack", "upto", [1]),
    ("ack", "to", 7),
    ("ack", "to", b"actor"),
    ("ack", "to", "actor\n"),
    ("ack", "to", "../x"),
    ("ack", "to", "*"),
    ("ack", "to", ""),
    ("ack", "to", "a" * 65),
    ("ack", "progress", 1.5),
    ("ack", "progress", -0.1),
    ("ack", "progress", float("nan")),
    ("ack", "progress", "0.5"),
    ("ack", "progress", True),
    ("ack", "want", "all"),
    ("ack", "want", b"mean"),
    ("ack", "want", 1),
    ("ack", "extra", 1),
    ("phase", "phase", "WALK"),
    ("phase", "phase", b"walk"),
    ("phase", "phase", 3),
    ("phase", "evaluates", b"walk"),
    ("phase", "evaluates", True),
    ("phase", "blocks", [["body", {}]]),
    ("phase", "blocks", {"body": []}),
    ("phase", "blocks", {"body": None}),
    ("phase", "blocks", {"body": {"encoder": "1"}}),
    ("phase", "blocks", {"body": {"encoder": 1, "other": 1}}),
    ("phase", "blocks", {"Body": {}}),
    ("status", "metrics", {"loss": "0.1"}),
    ("status", "metrics", {"loss": True}),
    ("status", "metrics", {"loss": None}),
    ("status", "totals", {"a": 0.0}),
    ("status", "totals", {"a" * 201: 0}),
    ("status", "last_error", "a" * 2001),
    ("status", "progress", {}),
    ("settings", "config", {"scenario": "cuboid"}),
    ("settings", "config", b"{}"),
    ("settings", "config", "{\n}"),
    ("settings", "config", '{"scenario": "Würfel"}'),
    ("settings", "began_ms", 0.5),
    ("model", "version", 0),
    ("model", "digest", "a" * 63),
    ("model", "fingerprint", "0123456789ABCDEF"),
    ("model", "fingerprint", "0123456789abcdef\n"),
    ("segment-babble", "steps", 0),
    ("segment-babble", "level", -1),
    ("segment-babble", "iteration", 0.5),
    ("segment-babble", "phase", "encode"),
    ("segment-babble", "arrays", {}),
    ("reply", "ok", 1),
    ("reply", "ok", "true"),
]


@pytest.mark.parametrize(("name", "field", "value"), WRONG)
def test_a_field_of_another_type_or_range_is_refused_and_named(name, field, value):
    refused = refusal(changed(name, {field: value}))
    assert refused.reason is Reason.BAD_HEADER
    assert field in str(refused)


@pytest.mark.parametrize("value", ["0.5", True, None, float("nan"), float("inf"), -float("inf"), b"1", [0.5]])
@pytest.mark.parametrize("field", ["separation", "z_min", "switch_success"])
def test_a_score_is_a_finite_number(field, value):
    refused = refusal(changed("status", {field: value}, of="scores"))
    assert refused.reason is Reason.BAD_HEADER
    assert f"scores.0.{field}" in str(refused)


def test_a_score_that_is_not_finite_cannot_even_be_made():
    with pytest.raises(ValueError, match="finite"):
        Score(**{**GOLDEN["status"].scores[0].model_dump(), "crossing": float("inf")})


@pytest.mark.parametrize("change", [{"finished": 1}, {"finished": "true"}, {"done": "3"}, {"unit": "hours"}])
def test_progress_is_strict_too(change):
    assert refusal(changed("status", change, of="progress")).reason is Reason.BAD_HEADER


def test_an_integer_is_a_number_where_a_score_or_metric_stands():
    assert decode(changed("status", {"z_min": 1}, of="scores")).scores[0].z_min == 1.0
    assert decode(changed("status", {"metrics": {"loss": 2**64 - 1}})).metrics == {"loss": 2.0**64}


def test_metrics_may_have_diverged():
    status = decode(changed("status", {"metrics": {"loss": float("nan"), "bound": -float("inf")}}))
    assert status.metrics["loss"] != status.metrics["loss"]
    assert decode(encode(status)).metrics["bound"] == -float("inf")


def test_phases_arrive_as_phases_and_may_be_given_as_text():
    assert decode(path("phase").read_bytes()).evaluates is Phase.PRACTISE
    assert Status(**{**GOLDEN["status"].model_dump(), "phase": "walk"}).phase is Phase.WALK


def test_lists_and_maps_are_bounded():
    assert len(decode(changed("status", {"totals": {str(i): i for i in range(256)}})).totals) == 256
    assert refusal(changed("status", {"totals": {str(i): i for i in range(257)}})).reason is Reason.MALFORMED
    with pytest.raises(ValueError, match="at most 256"):
        Status(**{**GOLDEN["status"].model_dump(), "totals": {str(i): i for i in range(257)}})


def test_a_missing_field_is_named():
    envelope = msgpack.unpackb(path("ack").read_bytes())
    del envelope["h"]["upto"]
    assert "ack header: upto: Field required" in str(refusal(msgpack.packb(envelope)))


def test_a_message_cannot_be_changed():
    segment = GOLDEN["segment-babble"]
    assert isinstance(segment, Segment)
    with pytest.raises(ValueError, match="frozen"):
        segment.seq = 5
    with pytest.raises(ValueError, match="read-only"):
        decode(encode(segment)).arrays["episode"][0, 0] = 1
