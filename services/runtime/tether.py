"""Becomes a process that dies with the one that started it: `python tether.py PARENT_ID COMMAND...`.

On Linux the kernel is asked (PR_SET_PDEATHSIG, which survives exec) for a SIGKILL when the starting
thread ends; so a process is started from a thread that outlives it, and whoever is killed leaves
nobody behind. SIGKILL, because all that must survive does survive it. Elsewhere the processes of one
that was killed go on until they end by themselves.

It is run by its path, without site packages, and not in the starting process between fork and exec,
where no Python may run safely beside other threads.
"""

import ctypes
import os
import signal
import sys
from collections.abc import Sequence

PR_SET_PDEATHSIG = 1


def tethered(command: Sequence[str]) -> list[str]:
    """The command line that runs `command` (by its full path) tied to the calling thread."""
    return [sys.executable, "-I", "-S", __file__, str(os.getpid()), *command]


def main(arguments: list[str]) -> int:
    """Replace this process by the command; 1 if the parent was gone before the kernel knew."""
    parent, command = int(arguments[0]), arguments[1:]
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGKILL))
        if os.getppid() != parent:
            return 1
    os.execv(command[0], command)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
