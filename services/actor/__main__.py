"""`python -m services.actor --run-dir DIR --index I`: an actor of a run."""

import sys

from services.actor.service import SERVICE, build
from services.runtime.process import run_process

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, build))
