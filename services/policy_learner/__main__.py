"""`python -m services.policy_learner --run-dir DIR [--index K]`: a policy learner of a run."""

import sys

from services.policy_learner.service import SERVICE, build
from services.runtime.process import run_process
from services.runtime.sharing import add_options, numbered

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, numbered(build), add_options=add_options))
