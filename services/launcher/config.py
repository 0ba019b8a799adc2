"""What `babble up` is told, checked before any process starts: the scenario's settings and the address."""

import socket
from dataclasses import dataclass
from pathlib import Path

from services.runtime.errors import BusError
from services.runtime.settings import RunSettings, SettingsError, load, parse

ROOT = Path(__file__).resolve().parents[2]
"""The repository, where this is an editable install of one."""
SUFFIX = ".toml"


@dataclass(frozen=True, kw_only=True)
class Address:
    """Where the router listens, and how processes of this machine reach it."""

    listen: str
    connect: str


def scenario_path(scenario: str) -> Path:
    """The TOML file of a scenario, given by its path or by the bare name of a file in scenarios/.

    Raises `SettingsError` that names the known ones.
    """
    given = Path(scenario).expanduser()
    if given.is_file():
        return given
    known = known_scenarios()
    name = scenario.removesuffix(SUFFIX)
    if name in known:
        return known[name]
    names = ", ".join(sorted(known)) or "none (there is no folder scenarios/ here)"
    raise SettingsError(
        f"there is no scenario {scenario!r}; give the path of a TOML file, or one of: {names}"
    )


def known_scenarios() -> dict[str, Path]:
    """Bare name -> file of the scenarios of the working directory, else of the repository."""
    for folder in (Path("scenarios"), ROOT / "scenarios"):
        if found := {path.stem: path for path in sorted(folder.glob(f"*{SUFFIX}"))}:
            return found
    return {}


def scenario_settings(scenario: str, *, actors: int | None, seed: int | None) -> RunSettings:
    """The whole settings of a run, with its world and tree of blocks tried out. Raises `SettingsError`."""
    path = scenario_path(scenario)
    settings = load(path) if seed is None else load(path, seed=seed)
    if actors is not None:
        table = settings.model_dump()
        table["actors"]["count"] = actors
        settings = parse(table, origin="--actors")
    check_world(settings, origin=str(path))
    return settings


def check_world(settings: RunSettings, *, origin: str) -> None:
    """Raise `SettingsError` if the world or the tree of blocks cannot be built."""
    from babble.blocks import BlockTree
    from babble.worlds import make

    try:
        world = make(settings.world.id, settings.world.parameters, columns=1, seed=0)
        tree = BlockTree.of(settings.block, world.observation_size, world.action_size)
    except (ValueError, TypeError) as error:
        raise SettingsError(f"{origin}: {error}") from None
    if tree.levels > 1:
        parents = ", ".join(spec.name for spec in tree.level(1))
        raise SettingsError(f"{origin}: block {parents} has children, and such blocks cannot act yet")


def address_of(listen: str | None) -> Address:
    """The address that was asked for, if it is free, else one of this machine alone on a free port.

    Raises `BusError` if it is no address or is taken.
    """
    host, port = ("127.0.0.1", 0) if listen is None else _host_and_port(listen)
    port = _free_port(host, port, listen)
    bracketed = f"[{host}]" if ":" in host else host
    reachable = {"0.0.0.0": "127.0.0.1", "::": "[::1]"}.get(host, bracketed)
    return Address(listen=f"tcp/{bracketed}:{port}", connect=f"tcp/{reachable}:{port}")


def _host_and_port(address: str) -> tuple[str, int]:
    scheme, _, rest = address.partition("/")
    host, _, port = rest.rpartition(":")
    if scheme != "tcp" or not host or not port.isdecimal() or int(port) > 65535:
        raise BusError(f"--listen {address}: not an address; it must look like tcp/127.0.0.1:7447")
    return host.removeprefix("[").removesuffix("]"), int(port)


def _free_port(host: str, port: int, asked: str | None) -> int:
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
        with socket.socket(family, kind, protocol) as probe:
            # As the router binds: a port that is only waiting out its last connections is free.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
            return int(probe.getsockname()[1])
    except OSError as error:
        raise BusError(
            f"cannot listen at {asked or host} ({error.strerror}); "
            "choose another address with --listen tcp/<address>:<port>, or leave it out for a free port"
        ) from None
