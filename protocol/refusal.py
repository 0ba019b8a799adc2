"""Why a frame is not accepted: one reason for the counter, one sentence for people."""

from enum import StrEnum

MAX_SENTENCE_CHARS = 400
MAX_VALUE_CHARS = 80


class Reason(StrEnum):
    """Why a frame was not accepted; the names of the counters in `Status.refused`."""

    OVERSIZED = "oversized"
    MALFORMED = "malformed"
    WRONG_PROTOCOL = "wrong-protocol"
    UNKNOWN_KIND = "unknown-kind"
    BAD_HEADER = "bad-header"
    BAD_ARRAY = "bad-array"
    FOREIGN_RUN = "foreign-run"
    WRONG_KEY = "wrong-key"
    WRONG_FINGERPRINT = "wrong-fingerprint"
    WRONG_DIGEST = "wrong-digest"
    UNEXPECTED = "unexpected"
    STALE = "stale"
    DUPLICATE = "duplicate"
    OUT_OF_ORDER = "out-of-order"
    NO_ROOM = "no-room"


class Refused(ValueError):
    """A frame that is not accepted: `reason` for the counter, the text for people."""

    def __init__(self, reason: Reason, sentence: str) -> None:
        super().__init__(clip(sentence, MAX_SENTENCE_CHARS))
        self.reason = reason


def clip(text: str, limit: int) -> str:
    """The text, cut to `limit` characters with an ellipsis."""
    return text if len(text) <= limit else text[: limit - 3] + "..."


def shown(value: object) -> str:
    """A value from a stranger, fit for a sentence: never longer than `MAX_VALUE_CHARS`, whatever it holds."""
    if isinstance(value, str):
        return clip(repr(value[:MAX_VALUE_CHARS]), MAX_VALUE_CHARS)
    if value is None or isinstance(value, bool | int | float):
        return clip(str(value), MAX_VALUE_CHARS)
    if isinstance(value, bytes):
        return f"{len(value)} raw bytes"
    if isinstance(value, list) and len(value) <= 8 and all(type(n) is int for n in value):
        return clip(str(value), MAX_VALUE_CHARS)
    if isinstance(value, list | dict):
        return f"a {type(value).__name__} of {len(value)}"
    return f"a {type(value).__name__}"
