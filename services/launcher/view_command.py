"""`babble view`: the recording of a run, in a browser.

This process becomes the dashboard's replay; the launcher itself knows nothing of viewers.
"""

import argparse
import os
import sys
from importlib.util import find_spec
from typing import NoReturn

from services.launcher.run_folder import RunFolder
from services.runtime.errors import UserError

REPLAY = "services.dashboard.replay"
LOOPBACK = "127.0.0.1"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble view`."""
    parser.add_argument("run", metavar="RUN", help="a run folder, or the name of one under runs/")
    how = parser.add_mutually_exclusive_group()
    how.add_argument("--no-browser", action="store_true", help="only say the address; open no browser")
    how.add_argument("--native", action="store_true", help="in rerun's own window instead of a browser")
    parser.add_argument("--port", type=_port, help="of the web page (default: 9090, or a free one)")
    parser.add_argument(
        "--bind", default=LOOPBACK, metavar="ADDRESS", help=f"where to serve the page (default: {LOOPBACK})"
    )
    parser.add_argument(
        "--allow-origin",
        action="append",
        default=[],
        metavar="HOST",
        help="another host name under which the page may be opened; may be given again",
    )


def run(arguments: argparse.Namespace) -> NoReturn:
    """Become the replay of the run's recording. Raises `UserError` if there is no such run or no viewer."""
    folder = RunFolder.find(arguments.run)
    if find_spec("rerun_cli") is None:
        raise UserError(
            "rerun-sdk, which has the viewer, is not installed here; install it with `make setup`, "
            "or `.venv/bin/uv sync --locked --inexact --extra dashboard`"
        )
    sys.stdout.flush()
    os.execv(sys.executable, [sys.executable, "-m", REPLAY, *replay_arguments(folder, arguments)])


def replay_arguments(folder: RunFolder, arguments: argparse.Namespace) -> list[str]:
    """The command line of the replay."""
    given = ["--run-dir", str(folder.path), "--bind", arguments.bind]
    given += ["--port", str(arguments.port)] if arguments.port is not None else []
    given += ["--no-browser"] if arguments.no_browser else []
    given += ["--native"] if arguments.native else []
    return given + [word for host in arguments.allow_origin for word in ("--allow-origin", host)]


def _port(text: str) -> int:
    try:
        port = int(text)
    except ValueError:
        port = -1
    if not 0 < port < 65536:
        raise argparse.ArgumentTypeError(f"must be a port, 1 to 65535, got {text}")
    return port
