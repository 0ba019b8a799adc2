"""The open router, and the two files that say who may come in; it opens anew when they change."""

import logging
import time
from collections.abc import Callable
from typing import TypeVar

from services.router.access import access_control
from services.router.config import RouterConfig
from services.router.hosts import WatchedFile, read_hosts
from services.router.sockets import connections, cut, hurry
from services.runtime.credentials import Credential, credential_for
from services.runtime.errors import BusError, UserError
from services.runtime.zenoh_bus import Router, open_router

log = logging.getLogger(__name__)

REOPEN_SECS = 5.0
"""The own address may be in use for so long after closing."""
RETRY_SECS = 0.1
T = TypeVar("T")


class Door:
    """A router that is open for the hosts in the list, or on plain TCP for everybody who reaches it.

    Raises `UserError` for a credential, a list or an address that cannot be used.
    """

    def __init__(self, config: RouterConfig) -> None:
        self.hosts: frozenset[str] = frozenset()
        """Labels of the hosts with actors; empty on plain TCP."""
        self._listen = config.listen
        self._credential_path, self._hosts_path = config.credential, config.hosts
        self._watched: dict[str, WatchedFile] = {}
        if config.credential is not None and config.hosts is not None:
            # Before they are read, so that no change is missed.
            self._watched = {
                "credential": WatchedFile(config.credential),
                "hosts": WatchedFile(config.hosts),
            }
        self._credential = credential_for("router", config.listen, config.credential)
        if self._credential is not None:
            self.hosts = self._new_hosts()
        self.router = self._open()

    @property
    def closed_to_strangers(self) -> bool:
        """True if who connects needs a certificate."""
        return self._credential is not None

    def renew(self) -> bool:
        """Open anew if the files have changed; True if it did.

        Clients come back by themselves within about a second. Files that cannot be used change
        nothing but the log. Raises `BusError` if the address cannot be had again.
        """
        changed = {name for name, file in self._watched.items() if file.changed()}
        if not changed:
            return False
        credential = self._read("credential", self._new_credential, self._credential)
        hosts = self._read("hosts", self._new_hosts, self.hosts)
        if credential == self._credential and hosts == self.hosts:
            return False
        log.info("opening anew: %s", _difference(self.hosts, hosts) or "the router's own credential is new")
        self._credential, self.hosts = credential, hosts
        self._leave()
        self.router = self._open_again()
        return True

    def close(self) -> None:
        """Leave all clients."""
        self.router.close()

    def _leave(self) -> None:
        """Close the router, with nobody left behind in it: not who takes nothing, not who came meanwhile."""
        hurry()
        self.router.close()
        for peer, connection in connections().items():
            cut(peer, connection)

    def _new_credential(self) -> Credential | None:
        return credential_for("router", self._listen, self._credential_path)

    def _new_hosts(self) -> frozenset[str]:
        assert self._hosts_path is not None
        return read_hosts(self._hosts_path)

    def _read(self, what: str, read: Callable[[], T], before: T) -> T:
        try:
            return read()
        except UserError as error:
            log.error("%s; the router goes on with the %s it had", error, what)
            return before

    def _open(self) -> Router:
        access = access_control(self.hosts) if self._credential is not None else None
        return open_router(self._listen, credential=self._credential, access=access)

    def _open_again(self) -> Router:
        deadline_secs = time.monotonic() + REOPEN_SECS
        while True:
            try:
                return self._open()
            except BusError:
                if time.monotonic() > deadline_secs:
                    raise
                time.sleep(RETRY_SECS)


def _difference(before: frozenset[str], after: frozenset[str]) -> str:
    parts = [("added", after - before), ("taken out", before - after)]
    return "; ".join(f"{what} {', '.join(sorted(hosts))}" for what, hosts in parts if hosts)
