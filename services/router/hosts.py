"""The list of hosts with actors: a file that the operator edits while the router runs."""

import os
import re
from pathlib import Path

from services.runtime.credentials import HOST_PATTERN
from services.runtime.errors import UserError

MOST_HOSTS = 1024
LARGEST_FILE_BYTES = 1 << 16


class HostsError(UserError):
    """The list of hosts is not there or holds something else; the text is one sentence."""


def read_hosts(path: Path) -> frozenset[str]:
    """The host labels in the file, one per line; blank lines and what follows a `#` do not count.

    Raises `HostsError`.
    """
    again = "`babble certs` writes it, and you may edit it"
    try:
        with path.open("rb") as file:
            held = file.read(LARGEST_FILE_BYTES + 1)
    except OSError as error:
        raise HostsError(f"cannot read the list of hosts {path}: {error.strerror}; {again}") from None
    if len(held) > LARGEST_FILE_BYTES:
        raise HostsError(f"{path} is too large for a list of hosts; {again}")
    try:
        return parse_hosts(held.decode())
    except ValueError as error:
        raise HostsError(f"{path} is no list of hosts: {error}; {again}") from None


def parse_hosts(text: str) -> frozenset[str]:
    """The labels in the text. Raises ValueError with the line that is none."""
    found = set()
    for number, line in enumerate(text.splitlines(), start=1):
        label = line.partition("#")[0].strip()
        if label and not re.fullmatch(HOST_PATTERN, label):
            raise ValueError(f"line {number} is {label[:40]!r} and not a label of 1 to 24 of a-z, 0-9 and _")
        if label:
            found.add(label)
    if len(found) > MOST_HOSTS:
        raise ValueError(f"it has {len(found)} hosts, and {MOST_HOSTS} are the most")
    return frozenset(found)


class WatchedFile:
    """Notices that a file is another one than before, once it has kept still between two looks."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._taken = self._last = self._look()

    def changed(self) -> bool:
        """True once for each change; a file that vanished or is there again has changed."""
        found = self._look()
        still, self._last = found == self._last, found
        if found == self._taken or not still:
            return False
        self._taken = found
        return True

    def _look(self) -> tuple[int, int, int] | None:
        try:
            found = os.stat(self._path)
        except OSError:
            return None
        return found.st_mtime_ns, found.st_size, found.st_ino
