"""`python -m services.router [--listen tcp/127.0.0.1:7447]`."""

import sys

from services.router.config import parse
from services.router.service import serve
from services.runtime.process import guarded, log_to_stderr, new_life


def main() -> int:
    """Run the router; returns the exit code."""
    config = parse()
    life = new_life("router")
    log_to_stderr(life)
    return guarded("router", lambda: serve(config, life))


if __name__ == "__main__":
    sys.exit(main())
