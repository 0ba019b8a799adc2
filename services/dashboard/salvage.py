"""How much of a recording is whole: one that a crash cut off ends within a message.

An .rrd is a header of 12 bytes (`RRF2`, version, options), then messages: kind and length as
little-endian 64-bit numbers, and so many bytes. A message of kind 0 ends the stream; behind it are 32
bytes that say where its index is, with the mark `RRF2FOOT`. A process that was killed wrote no end,
and perhaps half a message; readers that seek refuse such a file as a whole, while they read its whole
messages like any other. (Seen in files of rerun 0.41; the layout is that of its re_log_encoding.)
"""

import os
import struct
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from services.runtime.errors import UserError

MAGIC = b"RRF2"
STREAM_HEADER_BYTES = 12
MESSAGE_HEADER = struct.Struct("<QQ")
END = 0
LAST_KIND = 3
FOOTER_BYTES = 32
FOOTER_MARK = b"RRF2FOOT"
FOOTER_MARK_AT = 20


class RecordingError(UserError):
    """A recording that cannot be shown."""


@dataclass(frozen=True)
class Whole:
    """So much of a file can be read."""

    whole_bytes: int
    """From the start of the file to the end of its last whole message."""
    file_bytes: int
    messages: int

    @property
    def cut_bytes(self) -> int:
        """What lies behind the last whole message."""
        return self.file_bytes - self.whole_bytes


def measure(path: Path) -> Whole:
    """How much of the recording is whole; nothing of a file that is no recording.

    Reads 16 bytes per message. Raises `RecordingError` if the file cannot be read.
    """
    try:
        with path.open("rb") as file:
            file_bytes = os.fstat(file.fileno()).st_size
            at = messages = 0
            while (step := _step(file, at, file_bytes)) is not None:
                at, messages = at + step, messages + (step > STREAM_HEADER_BYTES)
            return Whole(whole_bytes=at, file_bytes=file_bytes, messages=messages)
    except OSError as error:
        raise RecordingError(f"cannot read the recording {path}: {error.strerror}") from None


def _step(file: BinaryIO, at: int, file_bytes: int) -> int | None:
    """Bytes of the header or message that begins here; None if none does, or not a whole one."""
    start = _read(file, at, MESSAGE_HEADER.size)
    if start.startswith(MAGIC):
        return STREAM_HEADER_BYTES if at + STREAM_HEADER_BYTES <= file_bytes else None
    if at == 0 or len(start) < MESSAGE_HEADER.size:
        return None
    kind, payload_bytes = MESSAGE_HEADER.unpack(start)
    size = MESSAGE_HEADER.size + payload_bytes
    if kind > LAST_KIND or at + size > file_bytes:
        return None
    return size if kind != END else _end(file, at + size, size, file_bytes)


def _end(file: BinaryIO, at: int, size: int, file_bytes: int) -> int | None:
    """Bytes of an end with what belongs behind it; what a disk left as zeros looks like one, but is none.

    What was written after the file was measured does not count.
    """
    footer = _read(file, at, min(FOOTER_BYTES, file_bytes - at))
    if footer[FOOTER_MARK_AT:].startswith(FOOTER_MARK) and len(footer) == FOOTER_BYTES:
        return size + FOOTER_BYTES
    without_index = size == MESSAGE_HEADER.size and (not footer or footer.startswith(MAGIC))
    return size if without_index else None


def _read(file: BinaryIO, at: int, count: int) -> bytes:
    file.seek(at)
    return file.read(count)
