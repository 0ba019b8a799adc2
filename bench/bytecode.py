"""Python's compiled files: with them, as at every start but the first, torch starts twice as fast."""

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager

from bench.scene import ROOT

OPTIMISER = "import torch; torch.optim.Adam([torch.zeros(1, requires_grad=True)])"
"""The first optimiser of torch.optim in a process imports torch's compiler."""
USED = (
    OPTIMISER,
    "import services.policy_learner.service, services.encoder_learner.service, services.actor.service",
    "import services.coordinator.service, services.router.service, bench.sb3_run",
)


@contextmanager
def first_start() -> Iterator[None]:
    """Within it, children of this process find nothing compiled, as after an installation."""
    before = dict(os.environ)
    with tempfile.TemporaryDirectory() as folder:
        os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
        os.environ["PYTHONPYCACHEPREFIX"] = folder
        try:
            yield
        finally:
            os.environ.clear()
            os.environ.update(before)


@contextmanager
def compiled() -> Iterator[None]:
    """Within it, they find everything compiled, in a folder that is deleted after."""
    with first_start():
        for statement in USED:
            subprocess.run([sys.executable, "-c", statement], cwd=ROOT, check=True)
        yield
