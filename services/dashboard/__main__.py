"""`python -m services.dashboard --run-dir DIR [--connect tcp/127.0.0.1:7447] [--web-port 9090]`."""

import sys

import rerun as rr

from services.dashboard.config import add_options
from services.dashboard.service import SERVICE, build
from services.runtime.process import run_process


def main() -> int:
    """Run the dashboard as this process; returns the exit code."""
    # The service ends its streams itself; rerun would wait at exit for a viewer that hangs, for ever.
    rr.unregister_shutdown()
    return run_process(SERVICE, build, add_options=add_options)


if __name__ == "__main__":
    sys.exit(main())
