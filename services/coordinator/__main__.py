"""`python -m services.coordinator --run-dir DIR [--connect tcp/127.0.0.1:7447]`."""

import sys

from services.coordinator.service import SERVICE, build
from services.runtime.process import run_process


def main() -> int:
    """Run the coordinator as this process; returns the exit code."""
    return run_process(SERVICE, build)


if __name__ == "__main__":
    sys.exit(main())
