"""Frames: a MessagePack envelope around a checked header and checked arrays.

    {"p": protocol number, "k": kind, "h": header, "a": {name: [dtype, shape, bytes]}}

Nothing here unpickles. Whatever does not check is refused with a reason and one sentence, both when
it arrives and when it is about to be sent: what `encode` lets out, `decode` lets in.
"""

from typing import Any, cast

import msgpack
from pydantic import ValidationError

from protocol import PROTOCOL
from protocol.arrays import pack, restore
from protocol.contents import check_arrays
from protocol.keys import MAX_FRAME_BYTES
from protocol.messages import MAX_ENTRIES, MAX_REPLY_CHARS, MESSAGES, Message, WithArrays
from protocol.refusal import Reason, Refused, shown

__all__ = ["Reason", "Refused", "decode", "encode"]

MAX_TEXT_BYTES = 4 * MAX_REPLY_CHARS
"""The longest text of a header in UTF-8."""
MAX_NODES = 1 << 14
"""The most values in a frame, containers and entries together; the fullest Status has 13,000."""


def encode(message: Message) -> bytes:
    """The frame of a message; fields that have their default value do not travel.

    Raises `Refused` if the message is larger than a frame may be or its arrays are not those of
    its kind.
    """
    header = message.model_dump(exclude_defaults=True)
    envelope: dict[str, Any] = {"p": PROTOCOL, "k": message.kind, "h": header}
    if isinstance(message, WithArrays):
        check_arrays(message)
        envelope["a"] = pack(message.arrays)
    try:
        frame = cast(bytes, msgpack.packb(envelope))
    except ValueError as error:
        raise Refused(Reason.OVERSIZED, f"a {message.kind} cannot be packed ({error})") from None
    if len(frame) > MAX_FRAME_BYTES:
        raise Refused(
            Reason.OVERSIZED,
            f"a {message.kind} of {len(frame)} bytes is over the limit of {MAX_FRAME_BYTES}; "
            "send fewer steps or columns per segment",
        )
    return frame


def decode(frame: bytes) -> Message:
    """The message of a frame; its arrays are read-only.

    Raises `Refused`, never anything else, whatever the bytes are. Needs at most four times the
    frame's length of memory, plus 32 MiB.
    """
    if len(frame) > MAX_FRAME_BYTES:
        raise Refused(
            Reason.OVERSIZED, f"a frame of {len(frame)} bytes is over the limit of {MAX_FRAME_BYTES}"
        )
    envelope = _unpack(frame)
    spoken = envelope.get("p")
    if type(spoken) is not int or spoken != PROTOCOL:
        raise Refused(
            Reason.WRONG_PROTOCOL,
            f"the frame speaks protocol {shown(spoken)}, this process speaks {PROTOCOL}; "
            "run the same version of babble everywhere",
        )
    kind = envelope.get("k")
    message_type = MESSAGES.get(kind) if isinstance(kind, str) else None
    if message_type is None:
        known = sorted(MESSAGES)
        raise Refused(Reason.UNKNOWN_KIND, f"no message kind is named {shown(kind)}; known: {known}")
    wanted = _WITH_ARRAYS if message_type.carries_arrays else _WITHOUT_ARRAYS
    header = envelope.get("h")
    if envelope.keys() != wanted or type(header) is not dict:
        raise Refused(
            Reason.MALFORMED, f"a {kind} frame must have exactly the fields {sorted(wanted)}, h a map"
        )
    if "arrays" in header:
        raise Refused(Reason.BAD_HEADER, f"{kind} header: arrays: belongs into the field a")
    if message_type.carries_arrays:
        header["arrays"] = restore(envelope["a"])
    try:
        message = message_type.model_validate(header)
    except ValidationError as error:
        raise Refused(Reason.BAD_HEADER, f"{kind} header: {_first_fault(error)}") from None
    if isinstance(message, WithArrays):
        check_arrays(message)
    return cast(Message, message)


_WITHOUT_ARRAYS = {"p", "k", "h"}
_WITH_ARRAYS = {"p", "k", "h", "a"}


class _Budget:
    """Counts a frame's values while they are unpacked, so that no small frame becomes a large heap."""

    __slots__ = ("left",)

    def __init__(self) -> None:
        self.left = MAX_NODES

    def list_made(self, values: list[object]) -> list[object]:
        self._spend(1 + len(values))
        return values

    def map_made(self, pairs: list[tuple[object, object]]) -> dict[object, object]:
        self._spend(1 + 2 * len(pairs))
        made = dict(pairs)
        if len(made) != len(pairs):
            raise Refused(Reason.MALFORMED, "a map of the frame has the same key twice")
        return made

    def _spend(self, values: int) -> None:
        self.left -= values
        if self.left < 0:
            raise Refused(Reason.MALFORMED, f"the frame holds more than {MAX_NODES} values")


def _unpack(frame: bytes) -> dict[str, Any]:
    budget = _Budget()
    try:
        envelope = msgpack.unpackb(
            frame,
            list_hook=budget.list_made,
            object_pairs_hook=budget.map_made,
            max_str_len=MAX_TEXT_BYTES,
            max_array_len=MAX_ENTRIES,
            max_map_len=MAX_ENTRIES,
            max_ext_len=0,
        )
    except Refused:
        raise
    except Exception as error:  # noqa: BLE001 - msgpack documents no closed set of errors
        raise Refused(Reason.MALFORMED, f"not a MessagePack frame ({type(error).__name__})") from None
    if type(envelope) is not dict:
        raise Refused(Reason.MALFORMED, f"a frame must be a MessagePack map, not {shown(envelope)}")
    return envelope


def _first_fault(error: ValidationError) -> str:
    fault = error.errors(include_url=False, include_context=False)[0]
    place = ".".join(str(part)[:80] for part in fault["loc"])
    return f"{place[:160]}: {fault['msg']}, got {shown(fault['input'])}"
