"""Which actor of the run this is, where nobody counted: the replica number of a container, or one of its own.

The index seeds the worlds together with the life, so two actors of one index do no harm; those below
`view.shown_actors` are the ones that people see.
"""

import argparse
import re
import socket
import threading
from typing import Literal

from services.runtime.process import NO_FOLDER, Context

AUTO: Literal["auto"] = "auto"
LOOK_UP_SECS = 0.4
"""The start waits no longer for a name server."""
FIRST_OWN = 1000
"""The least index of an actor that made up its own: beyond those that people are shown."""
LOCAL_HOSTS = ("", "local")
"""The host labels of the run's own machine; only its actors are counted from 0."""
_REPLICA = re.compile(r"(?:.*[-_])?actor[-_]([1-9]\d{0,5})(?:\..*)?")
"""What Docker's name server calls the containers of a service `actor`: `babble-actor-3.babble_actors`."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """The option `--index`."""
    parser.add_argument(
        "--index",
        type=index_or_auto,
        help="which actor this is, a number from 0, or auto: that of the container among those of its "
        f"service, else one from {FIRST_OWN} on (default: 0 with --run-dir, auto with --run)",
    )


def index_or_auto(text: str) -> int | Literal["auto"]:
    """What `--index` may be. Raises `argparse.ArgumentTypeError`."""
    if text == AUTO:
        return AUTO
    if not (text.isascii() and text.isdecimal()):
        raise argparse.ArgumentTypeError(f"must be a whole number of at least 0, or auto; got {text!r}")
    return int(text)


def index_of(context: Context) -> int:
    """The index of this actor, after LOOK_UP_SECS at most."""
    told: int | Literal["auto"] | None = context.options.index
    if told is None:
        told = AUTO if context.run_dir == NO_FOLDER else 0
    if told != AUTO:
        return told
    host, _, own = context.life.removeprefix("actor-").rpartition("-")
    replica = replica_of(_own_name(context.options.connect)) if host in LOCAL_HOSTS else None
    return FIRST_OWN + int(own, 16) if replica is None else replica


def replica_of(name: str) -> int | None:
    """The number from 0 of a container of the service `actor`, by its name; None for any other name."""
    found = _REPLICA.fullmatch(name)
    return None if found is None else int(found[1]) - 1


def _own_name(endpoint: str) -> str:
    """What the name server calls this machine in the network of the router; "" if nobody says so in time."""
    names: list[str] = []
    asking = threading.Thread(target=lambda: names.append(_look_up(endpoint)), name="own-name", daemon=True)
    asking.start()
    asking.join(LOOK_UP_SECS)
    return names[0] if names else ""


def _look_up(endpoint: str) -> str:
    host, _, port = endpoint.partition("/")[2].rpartition(":")
    try:
        family, kind, _, _, address = socket.getaddrinfo(host.strip("[]"), int(port), type=socket.SOCK_DGRAM)[
            0
        ]
        with socket.socket(family, kind) as towards:
            # Sends nothing: the kernel only says from which of its addresses it would.
            towards.connect(address)
            return socket.gethostbyaddr(towards.getsockname()[0])[0]
    except (OSError, ValueError):
        return ""
