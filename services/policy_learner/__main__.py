"""`python -m services.policy_learner --run-dir DIR`: the policy learner of a run."""

import sys

from services.policy_learner.service import SERVICE, build
from services.runtime.process import run_process

if __name__ == "__main__":
    sys.exit(run_process(SERVICE, build))
