"""Where the router listens."""

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
LISTEN_VARIABLE = "BABBLE_LISTEN"
"""The environment variable with the address, for containers."""


@dataclass(frozen=True, kw_only=True)
class RouterConfig:
    """What a router is told."""

    listen: str = DEFAULT_LISTEN
    """a Zenoh endpoint; only this machine can reach the default"""


def parse(argv: Sequence[str] | None = None) -> RouterConfig:
    """The configuration of the command line and the environment."""
    parser = argparse.ArgumentParser(
        prog="python -m services.router",
        description="The Zenoh router that all processes of a run connect to.",
    )
    parser.add_argument(
        "--listen",
        default=os.environ.get(LISTEN_VARIABLE, DEFAULT_LISTEN),
        help=f"address to listen at; tcp/0.0.0.0:7447 for other hosts too (default: ${LISTEN_VARIABLE}, "
        f"else {DEFAULT_LISTEN})",
    )
    return RouterConfig(listen=parser.parse_args(argv).listen)
