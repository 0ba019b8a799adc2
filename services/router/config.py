"""Where the router listens, whom it asks for a certificate, and how much it lets one client do."""

import argparse
import ipaddress
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from services.runtime.credentials import add_credential_option
from services.runtime.errors import UserError
from services.runtime.transport import MAX_SESSIONS

DEFAULT_LISTEN = "tcp/127.0.0.1:7447"
LISTEN_VARIABLE = "BABBLE_LISTEN"
"""The environment variable with the address, for containers."""
PLAIN_VARIABLE = "BABBLE_PLAIN"
UNTIL_DONE_VARIABLE = "BABBLE_UNTIL_DONE"
HOSTS_NAME = "hosts"
"""The file beside the credential that lists the hosts with actors."""
LINKS_PER_LIFE = 2
"""Each process has two connections."""


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What one identity may do; beyond it the router cuts it off."""

    mb_per_sec: float = 64.0
    """10^6 bytes received on all its connections together, over WINDOW_SECS of conduct.py"""
    messages_per_sec: float = 2000.0
    """segments, statuses and comings and goings of lives, over the same time"""
    garbage: int = 20
    """frames that nobody could use, in GARBAGE_SECS"""
    lives: int = 256
    """processes alive at once"""

    @property
    def connections(self) -> int:
        """Connections at once; never so many that there would be none left for the others."""
        return min(LINKS_PER_LIFE * self.lives, 3 * MAX_SESSIONS // 4)


@dataclass(frozen=True, kw_only=True)
class RouterConfig:
    """What a router is told."""

    listen: str = DEFAULT_LISTEN
    """a Zenoh endpoint; only this machine can reach the default"""
    credential: Path | None = None
    """needed for tls/, useless for tcp/"""
    hosts: Path | None = None
    """the list of hosts with actors; None where there is no credential"""
    plain: bool = False
    """nobody else reaches the network that it listens to, so that tcp/ will do"""
    until_done: bool = False
    """end by itself after the run"""
    limits: Limits = field(default_factory=Limits)


@dataclass(frozen=True)
class _Bound:
    """An option with a number, and the bounds it must keep."""

    option: str
    least: float
    most: float
    whole: bool
    what: str

    @property
    def variable(self) -> str:
        return "BABBLE_" + self.option[2:].replace("-", "_").upper()


BOUNDS = {
    "mb_per_sec": _Bound("--most-mb-per-sec", 0.1, 1e5, False, "10^6 bytes per second, over 5 s"),
    "messages_per_sec": _Bound("--most-messages-per-sec", 1, 1e6, False, "messages per second, over 5 s"),
    "garbage": _Bound("--most-garbage", 1, 1e6, True, "frames in 10 s that nobody could use"),
    "lives": _Bound("--most-lives", 1, 1e4, True, "processes at once, each with two connections"),
}
"""The options that set `Limits`, by its fields."""


def parse(argv: Sequence[str] | None = None) -> RouterConfig:
    """The configuration of the command line and the environment; a number out of bounds ends the process."""
    given = _parser().parse_args(argv)
    hosts = given.hosts
    if hosts is None and given.credential is not None:
        hosts = given.credential.parent / HOSTS_NAME
    return RouterConfig(
        listen=given.listen,
        credential=given.credential,
        hosts=hosts,
        plain=given.plain,
        until_done=given.until_done,
        limits=Limits(**{name: getattr(given, name) for name in BOUNDS}),
    )


def check_address(config: RouterConfig) -> None:
    """Raise `UserError` for an address at which anybody could join: not encrypted, reached from elsewhere."""
    protocol, slash, rest = config.listen.partition("/")
    if slash and (protocol not in ("tcp", "tls") or not {"?", "#"}.isdisjoint(rest)):
        raise UserError(
            f"cannot listen at {config.listen}; give --listen an address such as tls/0.0.0.0:7447, or "
            f"{DEFAULT_LISTEN} for this machine alone"
        )
    if protocol == "tcp" and slash and not config.plain and not _is_loopback(rest):
        raise UserError(
            f"{config.listen} would let anybody who reaches it take part without a certificate; use tls/ "
            "with a --credential of `babble certs`, or say with --plain that nobody else reaches it"
        )


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m services.router",
        description="The Zenoh router that all processes of a run connect to.",
    )
    parser.add_argument(
        "--listen",
        default=os.environ.get(LISTEN_VARIABLE, DEFAULT_LISTEN),
        help="address to listen at; tls/0.0.0.0:7447 with a credential for other hosts too "
        f"(default: ${LISTEN_VARIABLE}, else {DEFAULT_LISTEN})",
    )
    add_credential_option(parser)
    parser.add_argument(
        "--hosts",
        type=Path,
        metavar="FILE",
        help="the hosts whose actors may connect, one label per line, read again when it changes "
        f"(default: the file {HOSTS_NAME} beside the credential)",
    )
    _add_flag(
        parser, "--plain", PLAIN_VARIABLE, "nobody else reaches the network, so listen on it without TLS"
    )
    _add_flag(parser, "--until-done", UNTIL_DONE_VARIABLE, "end once the run is done and all have left")
    for name, bound in BOUNDS.items():
        default = getattr(Limits, name)
        parser.add_argument(
            bound.option,
            dest=name,
            type=_number(bound),
            default=os.environ.get(bound.variable, str(default)),
            metavar="N",
            help=f"cut off who does more: {bound.what} (default: ${bound.variable}, else {default:g})",
        )
    return parser


def _add_flag(parser: argparse.ArgumentParser, option: str, variable: str, text: str) -> None:
    parser.add_argument(
        option,
        action="store_true",
        default=os.environ.get(variable, "") not in ("", "0"),
        help=f"{text} (or ${variable}=1)",
    )


def _number(bound: _Bound) -> Callable[[str], float]:
    def parsed(text: str) -> float:
        try:
            number = int(text) if bound.whole else float(text)
        except ValueError:
            number = float("nan")
        if not bound.least <= number <= bound.most:
            kind = "a whole number" if bound.whole else "a number"
            raise argparse.ArgumentTypeError(
                f"must be {kind} from {bound.least:g} to {bound.most:g}, got {text!r} "
                f"(${bound.variable} sets it too)"
            )
        return number

    return parsed


def _is_loopback(address: str) -> bool:
    host = address.rpartition(":")[0].strip("[]")
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
