"""`python -m services.encoder_learner --run-dir DIR`: the encoder learner of a run."""

import sys

from services.encoder_learner.service import SERVICE, build
from services.runtime.process import run_process

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, build))
