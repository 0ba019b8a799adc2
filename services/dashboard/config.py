"""What a dashboard is told on its command line, and what it takes from the run's folder."""

import argparse
import contextlib
import json
import os
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from pydantic import ValidationError

from protocol.messages import Score
from services.runtime.errors import UserError

DEFAULT_BIND = "127.0.0.1"
DEFAULT_WEB_PORT = 9090
DEFAULT_GRPC_PORT = 9876
DEFAULT_SERVER_MEMORY_MB = 256
LEAST_SERVER_MEMORY_MB = 16
MAX_PORT = 65535
PAST_SCORES_BYTES = 1 << 18
"""Of the newest scores of a run so much is read."""


@dataclass(frozen=True, kw_only=True)
class DashboardOptions:
    """Where the dashboard serves, and how much of the past it holds for viewers that join late."""

    bind: str = DEFAULT_BIND
    web_port: int = DEFAULT_WEB_PORT
    grpc_port: int = DEFAULT_GRPC_PORT
    allow_origin: tuple[str, ...] = ()
    server_memory_mb: int = DEFAULT_SERVER_MEMORY_MB


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the dashboard's options to a command line."""
    parser.add_argument(
        "--bind",
        default=DEFAULT_BIND,
        help=f"the address to serve at; 0.0.0.0 for all hosts, with no password (default: {DEFAULT_BIND})",
    )
    parser.add_argument(
        "--web-port",
        type=int,
        default=DEFAULT_WEB_PORT,
        help=f"port of the page (default: {DEFAULT_WEB_PORT})",
    )
    parser.add_argument(
        "--grpc-port",
        type=int,
        default=DEFAULT_GRPC_PORT,
        help=f"port of the data that the page shows (default: {DEFAULT_GRPC_PORT})",
    )
    parser.add_argument(
        "--allow-origin",
        action="append",
        default=[],
        metavar="URL",
        help="the page's address where it is opened under another host name, such as http://lab:9090; "
        "may be given several times",
    )
    parser.add_argument(
        "--server-memory-mb",
        type=int,
        default=DEFAULT_SERVER_MEMORY_MB,
        help="so much of the past (10^6 bytes) is held for pages that are opened late "
        f"(default: {DEFAULT_SERVER_MEMORY_MB})",
    )


def options_of(arguments: argparse.Namespace) -> DashboardOptions:
    """The options of a parsed command line; the defaults for those it lacks. Raises `UserError`."""
    defaults = DashboardOptions()
    given = {name: getattr(arguments, name, getattr(defaults, name)) for name in vars(defaults)}
    options = DashboardOptions(**{**given, "allow_origin": tuple(given["allow_origin"])})
    for name, port in (("--web-port", options.web_port), ("--grpc-port", options.grpc_port)):
        if not 0 <= port <= MAX_PORT:
            raise UserError(f"{name} is {port}; give a number from 1 to {MAX_PORT}, or 0 for any free port")
    if options.web_port == options.grpc_port != 0:
        raise UserError(f"--web-port and --grpc-port are both {options.web_port}; give two different ports")
    if options.server_memory_mb < LEAST_SERVER_MEMORY_MB:
        raise UserError(
            f"--server-memory-mb is {options.server_memory_mb}; give {LEAST_SERVER_MEMORY_MB} or more, "
            "or pages that are opened late would show nothing"
        )
    return options


def past_scores(run_dir: Path) -> list[Score]:
    """The newest scores that the coordinator has left in `scores.jsonl`, in its order."""
    try:
        with (run_dir / "scores.jsonl").open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(0, size - PAST_SCORES_BYTES))
            lines = file.read(PAST_SCORES_BYTES).splitlines()
    except OSError:
        return []
    found = []
    for line in lines:
        # The first line may be cut off here, the last by a crash.
        with contextlib.suppress(ValidationError):
            found.append(Score.model_validate_json(line))
    return found


def created_secs(run_dir: Path) -> float:
    """When the run was made, in seconds since the Unix epoch: the zero of its time line.

    Where `run.json` does not say, it is the time of that file. Raises `UserError` if it cannot be read.
    """
    path = run_dir / "run.json"
    try:
        created = json.loads(path.read_text(encoding="utf-8")).get("created")
        if created is None:
            return path.stat().st_mtime
        return datetime.fromisoformat(created).timestamp()
    except OSError as error:
        sentence = f"cannot read {path}: {error.strerror}; give --run-dir the folder that `babble up` made"
        raise UserError(sentence) from None
    except (ValueError, TypeError, AttributeError):
        raise UserError(f'{path} must hold "created" as a time such as 2026-11-22T16:36:06+00:00') from None
