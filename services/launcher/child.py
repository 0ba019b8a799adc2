"""A service as a child process of the launcher, in a session of its own, with its output in a log file."""

import os
import signal
import subprocess
import sys

from services.launcher.supervisor import Exit, Part
from services.runtime.errors import UserError
from services.runtime.tether import tethered

ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
"""A process is one of several on this machine; libraries that start a thread per core are in the way."""

NOT_INHERITED = ("BABBLE_CREDENTIAL", "BABBLE_HEALTH", "BABBLE_RUN", "BABBLE_UNTIL_DONE")
"""What is meant for one process is said on its command line; these would be meant for the launcher."""


def child_environment() -> dict[str, str]:
    """The environment of a process that is one of several here: this one's, but for what is meant for it."""
    inherited = {name: value for name, value in os.environ.items() if name not in NOT_INHERITED}
    return {**dict.fromkeys(ONE_THREAD, "1"), **inherited}


class ChildProcess:
    """A started process; only `poll` waits for it."""

    def __init__(self, part: Part) -> None:
        """Starts it. Raises `UserError` if the operating system refuses."""
        # On Linux it dies with the thread that calls here: the launcher starts all from its main thread.
        command = tethered([sys.executable, *part.arguments])
        try:
            part.log.parent.mkdir(parents=True, exist_ok=True)
            with part.log.open("ab") as log:
                # A session of its own: Ctrl-C in the terminal reaches the launcher alone.
                self._child = subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=log,
                    stderr=log,
                    env=child_environment(),
                    start_new_session=True,
                )
        except OSError as error:
            raise UserError(f"cannot start {part.name} with its log {part.log}: {error.strerror}") from None

    def poll(self) -> Exit | None:
        """How it ended and what it cost, once; None while it runs."""
        pid, status, usage = os.wait4(self._child.pid, os.WNOHANG)
        if pid == 0:
            return None
        self._child.returncode = os.waitstatus_to_exitcode(status)
        return Exit(code=self._child.returncode, cpu_secs=usage.ru_utime + usage.ru_stime)

    def send(self, number: signal.Signals) -> None:
        """Send it a signal."""
        os.kill(self._child.pid, number)
