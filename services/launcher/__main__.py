"""`babble` and `python -m services.launcher`."""

import os
import sys
import threading
from contextlib import suppress

from services.launcher import cli


def main() -> int:
    """Run the command of this process; returns its exit code."""
    code = cli.main()
    if any(thread.daemon for thread in threading.enumerate()):
        # Such as one that is connecting: Python's own end would tear it out of zenoh, and abort (code 134).
        for stream in (sys.stdout, sys.stderr):
            with suppress(OSError, ValueError):
                stream.flush()
        os._exit(code)
    return code


if __name__ == "__main__":
    sys.exit(main())
