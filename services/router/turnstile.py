"""Ends the connections of the unwelcome, in such a way that they do not come back at once."""

import threading
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from services.router.sockets import Connection, Peer

MUTE_POLLS = 3
"""A new connection of somebody unwelcome is not heard for so long, and then cut.

Cut at once it would come back at once, and say in between what it came to say. Left alone, its lease
would end it a little later (1 s), with its other end waiting for a farewell that it cannot hear.
"""


@dataclass
class _Visit:
    identity: str
    polls: int = 0


class Turnstile:
    """`stop` a connection as soon as it is made, `turn` at each poll."""

    def __init__(
        self,
        look: Callable[[], Mapping[Peer, Connection]],
        shut: Callable[[Peer, Connection], bool],
        hush: Callable[[Peer], bool],
    ) -> None:
        self.turned_away = 0
        """connections that were ended"""
        self._look, self._shut, self._hush = look, shut, hush
        self._guard = threading.Lock()
        self._mute: dict[Peer, _Visit] = {}
        """Connections that are not heard."""
        self._knocks: dict[str, int] = {}

    def stop(self, identity: str, peer: Peer) -> None:
        """Hear no more of a connection (called on the transport's threads)."""
        if self._hush(peer):
            with self._guard:
                self._mute[peer] = _Visit(identity)
                self._count(identity)

    def expel(self, identity: str) -> None:
        """Cut at once what it said something on before it was mute (called on the transport's threads)."""
        with self._guard:
            visits = [peer for peer, visit in self._mute.items() if visit.identity == identity]
            for peer in visits:
                del self._mute[peer]
        found = self._look() if visits else {}
        for peer in found.keys() & visits:
            self._shut(peer, found[peer])

    def turn(self, unwelcome: Mapping[str, list[Peer]], found: Mapping[Peer, Connection]) -> None:
        """Cut what was mute for long enough, and what is open and should not be."""
        with self._guard:
            expired = {peer for peer, visit in self._mute.items() if visit.polls >= MUTE_POLLS}
            for peer in expired:
                del self._mute[peer]
            for visit in self._mute.values():
                visit.polls += 1
            left_alone = expired | self._mute.keys()
        for peer in expired & found.keys():
            self._shut(peer, found[peer])
        for identity, peers in unwelcome.items():
            for peer in set(peers) - left_alone:
                if peer in found and self._shut(peer, found[peer]):
                    with self._guard:
                        self._count(identity)

    def let_go(self, peer: Peer, connection: Connection) -> None:
        """Cut a connection of nobody known."""
        if self._shut(peer, connection):
            with self._guard:
                self.turned_away += 1

    def knocks(self, identity: str) -> int:
        """How many of its connections were ended since the last call."""
        with self._guard:
            return self._knocks.pop(identity, 0)

    def _count(self, identity: str) -> None:
        self.turned_away += 1
        self._knocks[identity] = self._knocks.get(identity, 0) + 1
