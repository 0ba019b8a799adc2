"""Becomes a process that dies with the one that started it: `python tether.py PARENT_ID COMMAND...`.

On Linux the kernel is asked (PR_SET_PDEATHSIG, which survives exec) for a SIGKILL when the starting
thread ends; so the launcher starts processes from its main thread only, and a launcher that is killed
leaves nobody behind who writes into the run folder. SIGKILL, because all that must survive does
survive it. Elsewhere a killed launcher leaves its processes; they end with the run.

It is run by its path, without site packages, and not in the launcher between fork and exec, where
no Python may run safely beside Zenoh's threads.
"""

import ctypes
import os
import signal
import sys

PR_SET_PDEATHSIG = 1


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
