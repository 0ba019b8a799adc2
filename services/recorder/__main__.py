"""`python -m services.recorder --run-dir DIR`: the recorder of a run."""

import sys

from services.recorder.service import SERVICE, build
from services.runtime.process import run_process

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, build))
