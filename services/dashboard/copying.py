"""A file that rerun writes through a pipe, so that a disk that refuses is ours to handle.

Rerun's own file sink waits for ever in its flush, and again at the end of the process, once a write has
failed; here it only ever writes to a pipe that is always emptied.
"""

import logging
import os
import threading
from pathlib import Path

import rerun as rr

log = logging.getLogger(__name__)

CHUNK_BYTES = 1 << 16


class CopiedFile:
    """Copies what comes through a pipe to a new file, on a thread. Raises OSError if there can be no file."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bytes = 0
        """written so far"""
        self.error = ""
        """why no more is written; what comes then is thrown away"""
        self._file = path.open("xb", buffering=0)
        self._reading, self._writing = os.pipe()
        self._thread = threading.Thread(target=self._copy, name="recording", daemon=True)
        self._thread.start()

    def sink(self) -> rr.FileSink:
        """Where a stream writes to; give it to one stream at once, then call `opened`."""
        return rr.FileSink(f"/dev/fd/{self._writing}", write_footer=True)

    def opened(self) -> None:
        """The stream has opened the pipe: from now on the end of what it writes is the end of the file."""
        os.close(self._writing)

    def wait(self, timeout_secs: float) -> None:
        """Wait until all is written, after the stream has ended."""
        self._thread.join(timeout_secs)

    def _copy(self) -> None:
        while data := os.read(self._reading, CHUNK_BYTES):
            while data and not self.error:
                try:
                    written = self._file.write(data) or 0
                    data, self.bytes = data[written:], self.bytes + written
                except OSError as error:
                    self.error = error.strerror or str(error)
        os.close(self._reading)
        self._file.close()


def end(stream: rr.RecordingStream, timeout_secs: float) -> None:
    """End a stream. One whose viewer or disk hangs is left to itself after `timeout_secs`."""
    ending = threading.Thread(target=stream.disconnect, name="end-of-stream", daemon=True)
    ending.start()
    ending.join(timeout_secs)
    if ending.is_alive():
        log.warning("a stream did not end within %.0f s; its last rows are lost", timeout_secs)
