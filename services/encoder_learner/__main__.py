"""`python -m services.encoder_learner --run-dir DIR [--index K]`: an encoder learner of a run."""

import sys

from services.encoder_learner.service import SERVICE, build
from services.runtime.process import run_process
from services.runtime.sharing import add_options, numbered

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, numbered(build), add_options=add_options))
