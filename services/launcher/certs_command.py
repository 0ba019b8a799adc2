"""`babble certs`: the certificates of runs over several hosts, from the first to the last day."""

import argparse
import ipaddress
import os
import re
from collections.abc import Callable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from services.launcher.authority import AUTHORITY_DAYS, CREDENTIAL_DAYS
from services.launcher.certs_folder import CA_KEY, CA_PEM, HOSTS, CertsError, CertsFolder, Held, Owner
from services.runtime.credentials import ACTOR, ROUTER, WARN_DAYS

FOLDER = Path("certs")
PORT = 7447
NEAR_NAMES = ("localhost", "127.0.0.1", "router")
"""The router's names on its own host, and the one it has in compose.yaml."""
CONTAINER_UID = 1000
"""The user of the project's images."""

_LABEL = "[a-z0-9_]([a-z0-9_-]{0,61}[a-z0-9])?"
_NAME = re.compile(rf"{_LABEL}(\.{_LABEL})*")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments of `babble certs`."""
    actions = parser.add_subparsers(dest="action", metavar="ACTION", required=True, title="actions")
    init = _action(actions, "init", _init, "make an authority, and a credential for each process")
    _hosts_option(init, "a name or address by which other hosts reach the router; may be given again")
    _making_options(init)
    add = _action(actions, "add", _add, "admit the actors of a further host")
    add.add_argument("host", metavar="HOST", help="your label for it: 1 to 24 of a-z, 0-9 and _")
    _making_options(add)
    _action(actions, "list", _list, "who may connect, and until when")
    renew = _action(actions, "renew", _renew, "new keys and certificates for the same identities")
    renew.add_argument("identities", nargs="*", metavar="IDENTITY", help="as `babble certs list` shows them")
    renew.add_argument("--all", action="store_true", help="all of them")
    renew.add_argument("--soon", action="store_true", help=f"those that expire within {WARN_DAYS} days")
    _hosts_option(renew, "of the router: new names in place of the present ones; may be given again")
    _making_options(renew)
    revoke = _action(actions, "revoke", _revoke, "admit a host no more, for good")
    revoke.add_argument("host", metavar="HOST", help="its label")


def run(arguments: argparse.Namespace) -> int:
    """Do what is asked; returns 0. Raises `UserError`s."""
    perform: Callable[[argparse.Namespace], None] = arguments.perform
    perform(arguments)
    return 0


def _init(arguments: argparse.Namespace) -> None:
    if not arguments.host:
        raise CertsError(
            "the router needs a name that other hosts find it by; say it with --host NAME_OR_ADDRESS"
        )
    owner = _owner(arguments)
    names = _with_near_names(arguments.host)
    folder = CertsFolder.create(arguments.dir, names, days=arguments.days, owner=owner)
    held = folder.held()
    print(f"{folder.path}: a new authority until {_day(folder.authority_end())}, and credentials of it")
    for each in held:
        print(f"  {_file(folder, each):<22} until {_day(each.not_after)}  for the {_whose(each.identity)}")
    print(f"The router may be addressed as {', '.join(names)}.")
    print(
        f"Whoever has {folder.path / CA_KEY} can be anybody: it stays here, and none of this belongs in git."
    )
    where = "" if folder.path == FOLDER else f" --dir {folder.path}"
    print(f"For each further host with actors: babble certs add HOST{where}")
    if owner is None and os.geteuid() != CONTAINER_UID:
        print(_words_on_containers(os.geteuid(), os.getegid()))


def _add(arguments: argparse.Namespace) -> None:
    folder = CertsFolder(arguments.dir, _owner(arguments))
    address = f"tls/{_bracketed((folder.router_names or [ROUTER])[0])}:{PORT}"
    made = folder.add(arguments.host.removeprefix(f"{ACTOR}."), days=arguments.days)
    print(f"{made.path}: the credential of {made.identity}, until {_day(made.not_after)}")
    print(
        "Take this one file, with its private key, to that host by a way you trust, and start actors there:"
    )
    print(f"  babble actor --connect {address} --run RUN --credential {made.path.name}")


def _list(arguments: argparse.Namespace) -> None:
    folder = CertsFolder(arguments.dir)
    authority = Held("authority", folder.path / CA_PEM, folder.authority_end())
    rows = [authority, *folder.held()]
    widths = [max(len(each.identity) for each in rows), max(len(_file(folder, each)) for each in rows)]
    now = datetime.now(UTC)
    print(f"{'identity':<{widths[0]}}  {'file':<{widths[1]}}  expires     days left")
    for each in rows:
        until = f"{_day(each.not_after)}  {_days_left(each, now):>9}" if each.not_after else f"-  {'-':>18}"
        marks = ", ".join(word for word in (_age(each, now), each.problem) if word)
        print(f"{each.identity:<{widths[0]}}  {_file(folder, each):<{widths[1]}}  {until}  {marks}".rstrip())
    print(f"hosts admitted: {', '.join(folder.hosts) or 'none'}")
    if folder.revoked:
        print(f"hosts revoked: {', '.join(folder.revoked)}")
    if not rows[1].problem:
        print(f"names of the router: {', '.join(folder.router_names)}")
    if _age(authority, now):
        print("no credential outlives the authority; make a new one: babble certs init --dir ANOTHER")
    elif any(_age(each, now) for each in rows):
        print("renew what expires with: babble certs renew --soon")


def _renew(arguments: argparse.Namespace) -> None:
    folder = CertsFolder(arguments.dir, _owner(arguments))
    identities = _to_renew(folder, arguments)
    if arguments.host and ROUTER not in identities:
        raise CertsError("--host gives the router its names; say `babble certs renew router --host NAME`")
    if not identities:
        print(f"nothing in {folder.path} expires within {WARN_DAYS} days")
        return
    for identity in identities:
        names = _with_near_names(arguments.host) if identity == ROUTER and arguments.host else ()
        made = folder.renew(identity, days=arguments.days, names=names)
        print(f"{made.path}: {identity} until {_day(made.not_after)}")
    print(
        "Take those of other hosts there, and start the processes again. The old ones stay good until they "
        "expire: if one was stolen, revoke its host, or for a role make a new authority."
    )


def _revoke(arguments: argparse.Namespace) -> None:
    host = arguments.host.removeprefix(f"{ACTOR}.")
    folder = CertsFolder(arguments.dir)
    folder.revoke(host)
    print(f"{host} is admitted no more by the router that reads {folder.path / HOSTS}.")
    print(f"The label is spent: if the host comes back, give it another, such as {host[:22]}_2.")


def _to_renew(folder: CertsFolder, arguments: argparse.Namespace) -> list[str]:
    ways = [bool(arguments.identities), arguments.all, arguments.soon]
    if sum(ways) != 1:
        raise CertsError(
            "say which to renew: identities as `babble certs list` shows them, or --soon, or --all"
        )
    if arguments.identities:
        return list(dict.fromkeys(arguments.identities))
    admitted = {f"{ACTOR}.{host}" for host in folder.hosts}
    now = datetime.now(UTC)
    return [
        each.identity
        for each in folder.held()
        if (arguments.all or _age(each, now))
        and (each.identity in admitted or not each.identity.startswith(f"{ACTOR}."))
    ]


def _action(
    actions: "argparse._SubParsersAction[argparse.ArgumentParser]",
    name: str,
    perform: Callable[[argparse.Namespace], None],
    words: str,
) -> argparse.ArgumentParser:
    parser = actions.add_parser(name, help=words, description=words.capitalize() + ".")
    parser.set_defaults(perform=perform)
    parser.add_argument(
        "--dir", type=Path, default=FOLDER, metavar="FOLDER", help=f"of the certificates (default: {FOLDER})"
    )
    return parser


def _hosts_option(parser: argparse.ArgumentParser, words: str) -> None:
    parser.add_argument(
        "--host", action="append", default=[], type=_host_name, metavar="NAME_OR_ADDRESS", help=words
    )


def _making_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--days",
        type=_days,
        default=CREDENTIAL_DAYS,
        metavar="N",
        help=f"credentials expire after so many days (default: {CREDENTIAL_DAYS})",
    )
    parser.add_argument(
        "--owner",
        type=_user_and_group,
        metavar="UID[:GID]",
        help="give all but the authority to this user, as only root can; the project's containers run as "
        f"{CONTAINER_UID} (default: the owner of router/router.pem, else whoever runs this)",
    )


def _owner(arguments: argparse.Namespace) -> Owner | None:
    owner: Owner | None = arguments.owner
    if owner is not None and os.geteuid() not in (0, owner[0]):
        raise CertsError(
            f"only root can give files to user {owner[0]}; run this with sudo, or leave --owner out"
        )
    return owner


def _words_on_containers(uid: int, gid: int) -> str:
    way = (
        f"let them run as that user, with BABBLE_UID={uid} and BABBLE_GID={gid} in .env"
        if uid
        else f"delete the folder and make it again with --owner {CONTAINER_UID}"
    )
    return f"All belongs to user {uid}, and containers run as user {CONTAINER_UID}: if you use them, {way}."


def _with_near_names(names: Sequence[str]) -> list[str]:
    return list(dict.fromkeys([*names, *NEAR_NAMES]))


def _whose(identity: str) -> str:
    return "actors on the router's host" if identity.startswith(ACTOR) else identity.replace("_", " ")


def _file(folder: CertsFolder, held: Held) -> str:
    return str(held.path.relative_to(folder.path))


def _day(moment: datetime | None) -> str:
    return f"{moment:%Y-%m-%d}" if moment else "-"


def _days_left(held: Held, now: datetime) -> str:
    return str(max(0, (held.not_after - now).days)) if held.not_after else "-"


def _age(held: Held, now: datetime) -> str:
    if held.not_after is None or held.not_after - now > timedelta(days=WARN_DAYS):
        return ""
    return "expired" if held.not_after <= now else "soon"


def _bracketed(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _host_name(text: str) -> str:
    name = text.lower()
    try:
        return str(ipaddress.ip_address(name))
    except ValueError:
        pass
    # What looks like a number is a mistyped address: no host name ends in digits only.
    if len(name) > 253 or not _NAME.fullmatch(name) or name.rpartition(".")[2].isdigit():
        raise argparse.ArgumentTypeError(f"must be a host name or an IP address without a port, got {text!r}")
    return name


def _days(text: str) -> int:
    if not text.isdecimal() or not 1 <= int(text) <= AUTHORITY_DAYS:
        raise argparse.ArgumentTypeError(f"must be 1 to {AUTHORITY_DAYS} days, got {text!r}")
    return int(text)


def _user_and_group(text: str) -> Owner:
    found = re.fullmatch(r"(\d{1,9})(?::(\d{1,9}))?", text)
    if found is None:
        raise argparse.ArgumentTypeError(f"must be numbers, UID or UID:GID, got {text!r}")
    return int(found[1]), int(found[2]) if found[2] else -1
