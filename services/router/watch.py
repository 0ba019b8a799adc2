"""Watches what each client does, and shuts the door on whoever does too much.

Identities come from certificates, lives in keys are proved by the access table (`access.py`), bytes
come from the kernel: nothing here believes what a client says of itself.
"""

import logging
import time
from collections.abc import Callable
from typing import Any, Protocol

from protocol import keys
from services.router.bans import Bans
from services.router.conduct import Conduct
from services.router.config import LINKS_PER_LIFE, Limits
from services.router.samples import Samples, fault, host_of, misnamed
from services.router.sockets import COUNTS_BYTES, Connection, Peer, connections, cut, mute, peer_of
from services.router.turnstile import Turnstile
from services.runtime.bus import Arrival, Inbox, Membership
from services.runtime.credentials import ACTOR, ROUTER, role_and_host
from services.runtime.transport import RouterLink

log = logging.getLogger(__name__)

POLL_SECS = 0.25
LOOK_SHARE = 0.08
"""Of the time so much goes into looking for garbage."""
MOST_CHANGES = 1 << 16
"""Comings and goings of lives that wait for a poll."""
AGAIN_SECS = 60.0
"""That somebody unlisted knocks, or that the kernel refuses, is said so often at most."""
SHOWN_ADDRESSES = 3
SILENT_SECS = 8.0
"""Who connects, and by then has not said who he is, is let go."""


class Doorway(Protocol):
    """What the watch asks of a router; `zenoh_bus.Router` is one."""

    def links(self) -> list[RouterLink]:
        """See `Router.links`."""
        ...

    def hear(self, key_expr: str, inbox: Inbox) -> None:
        """See `Router.hear`."""
        ...

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """See `Router.watch`."""
        ...

    def watch_links(self, hear: Callable[[RouterLink], None]) -> None:
        """See `Router.watch_links`."""
        ...


class _Tokens(Inbox):
    """Holds the comings and goings of lives, and tells of each that comes on the transport's thread."""

    def __init__(self, came: Callable[[str], None]) -> None:
        super().__init__(max_frames=MOST_CHANGES)
        self._came = came

    def put(self, arrival: Arrival) -> None:
        super().put(arrival)
        if isinstance(arrival, Membership) and arrival.present:
            self._came(arrival.key)


class Watch:
    """Counts by identity, holds it against the limits, cuts off; `attach` it to an open router first."""

    def __init__(
        self,
        limits: Limits,
        *,
        look: Callable[[], dict[Peer, Connection]] = connections,
        shut: Callable[[Peer, Connection], bool] = cut,
        hush: Callable[[Peer], bool] = mute,
        clock: Callable[[], float] = time.perf_counter,
    ) -> None:
        self.totals = dict.fromkeys(("bytes", "messages", "checked", "cut_off"), 0)
        """since this process began"""
        self.refused: dict[str, int] = {}
        """Garbage by reason."""
        self.last_error = ""
        """The last cut-off in one sentence."""
        self._limits, self._clock = limits, clock
        self._look = look
        self._turnstile = Turnstile(look, shut, hush)
        self._hosts: frozenset[str] = frozenset()
        self._conduct: dict[str, Conduct] = {}
        self._bans = Bans()
        self._kept_out: frozenset[str] = frozenset()
        self._told_secs: dict[str, float] = {}
        self._received: dict[Peer, int] = {}
        self._connections = 0
        self._nameless_secs: dict[Peer, float] = {}
        """since when a connection is there and none of the router's links"""
        self._looked_secs = float("-inf")
        self._samples = Samples()
        self._changes = _Tokens(self._token_came)
        if not COUNTS_BYTES:
            log.warning("this system does not say how many bytes a connection received; they are not watched")

    def attach(self, doorway: Doorway, hosts: frozenset[str]) -> None:
        """Begin with a router that was just opened. A host that is not listed any more is forgotten."""
        for host in self._hosts - hosts:
            identity = _identity(host)
            self._bans.pardon(identity)
            self._kept_out -= {identity}
            self._conduct.pop(identity, None)
            self._samples.forget(host)
        self._hosts, self._doorway = hosts, doorway
        self._changes = _Tokens(self._token_came)
        for conduct in self._conduct.values():
            conduct.lives.clear()
        doorway.hear(keys.segment("*", "*", "*", "*"), self._samples)
        doorway.hear(keys.status("*", ACTOR, "*"), self._samples)
        doorway.watch(keys.alive("*", ACTOR, "*"), self._changes)
        doorway.watch_links(self._greet)

    def poll(self, now_secs: float) -> None:
        """Look, judge, cut; wanted each POLL_SECS."""
        links: dict[str, list[Peer]] = {}
        for link in self._doorway.links():
            links.setdefault(link.identity or "", []).append(peer_of(link.host, link.port))
        found = self._sockets(now_secs)
        self._count_connections(links, found, now_secs)
        self._count_messages(now_secs)
        self._look_for_garbage(now_secs)
        self._judge(links, now_secs)
        self._turn_away(links, found, now_secs)
        self._let_go_of_nameless(found, now_secs)
        self._let_in_again(now_secs)

    def report(self) -> dict[str, Any]:
        """The fields of `Status` that it knows."""
        now = {
            "connections": self._connections,
            "clients": -(-self._connections // LINKS_PER_LIFE),
            "banned": len(self._kept_out),
            "turned_away": self._turnstile.turned_away,
            "unchecked": self._samples.dropped,
        }
        return {"totals": {**self.totals, **now}, "refused": self.refused, "last_error": self.last_error}

    def _greet(self, link: RouterLink) -> None:
        """A connection was just made (called on the transport's thread): the unwelcome are not heard."""
        identity = link.identity or ""
        if not self._is_welcome(identity):
            self._turnstile.stop(identity, peer_of(link.host, link.port))

    def _token_came(self, key: str) -> None:
        identity = _identity(host_of(key) or "")
        if not self._is_welcome(identity):
            self._turnstile.expel(identity)

    def _sockets(self, now_secs: float) -> dict[Peer, Connection]:
        try:
            return self._look()
        except OSError as error:
            if self._is_news("sockets", now_secs):
                log.error("cannot look at the own connections (%s), so none is counted or cut", error)
            return {}

    def _count_connections(
        self, links: dict[str, list[Peer]], found: dict[Peer, Connection], now_secs: float
    ) -> None:
        received: dict[Peer, int] = {}
        for conduct in self._conduct.values():
            conduct.connections = 0
        for identity, peers in links.items():
            more = 0
            for peer in peers:
                now = received[peer] = found[peer].received_bytes if peer in found else 0
                before = self._received.get(peer, 0)
                # A port that was used again begins anew.
                more += now - before if now >= before else now
            self.totals["bytes"] += more
            if (conduct_of := self._of(identity)) is not None:
                conduct_of.received.add(now_secs, more)
                conduct_of.connections = len(peers)
        self._received = received
        self._connections = len(received)

    def _count_messages(self, now_secs: float) -> None:
        for host, count in self._samples.counts().items():
            self.totals["messages"] += count
            if (conduct := self._of(_identity(host))) is not None:
                conduct.messages.add(now_secs, count)
        for change in self._changes.take_all():
            host_or_none = host_of(change.key) if isinstance(change, Membership) else None
            if host_or_none is None or not isinstance(change, Membership):
                continue
            if (conduct := self._of(_identity(host_or_none))) is not None:
                conduct.live(change.key, change.present, now_secs, self._limits)
                if change.present and (wrong := misnamed(change)) is not None:
                    self._count_garbage(conduct, *wrong, now_secs)

    def _look_for_garbage(self, now_secs: float) -> None:
        begun_secs = self._clock()
        until_secs = begun_secs + LOOK_SHARE * min(begun_secs - self._looked_secs, POLL_SECS)
        self._looked_secs = begun_secs
        while self._clock() < until_secs and (waiting := self._samples.next_frame()) is not None:
            host, frame = waiting
            self.totals["checked"] += 1
            wrong = fault(frame)
            conduct = self._of(_identity(host))
            if wrong is not None and conduct is not None:
                self._count_garbage(conduct, *wrong, now_secs)

    def _count_garbage(self, conduct: Conduct, reason: str, sentence: str, now_secs: float) -> None:
        self.refused[reason] = self.refused.get(reason, 0) + 1
        conduct.last_garbage = sentence
        conduct.garbage.add(now_secs, 1)

    def _judge(self, links: dict[str, list[Peer]], now_secs: float) -> None:
        for identity, conduct in list(self._conduct.items()):
            excess = conduct.excess(now_secs, self._limits)
            if excess is None or self._bans.left_secs(identity, now_secs) > 0:
                continue
            secs = self._bans.ban(identity, now_secs)
            where = _addresses(links.get(identity, []))
            self.last_error = f"cut off {identity} ({where}): {excess}; it is kept out for {secs:,.0f} s"
            self.totals["cut_off"] += 1
            self._kept_out |= {identity}
            log.warning("%s", self.last_error)
            del self._conduct[identity]
            if (host := _host(identity)) is not None:
                self._samples.forget(host)

    def _turn_away(
        self, links: dict[str, list[Peer]], found: dict[Peer, Connection], now_secs: float
    ) -> None:
        """End the connections of all who are kept out or have no business here."""
        unwelcome = {who: peers for who, peers in links.items() if not self._is_welcome(who)}
        self._turnstile.turn(unwelcome, found)
        for identity, peers in unwelcome.items():
            if not self._is_listed(identity):
                self._say_unlisted(identity, peers, now_secs)

    def _let_go_of_nameless(self, found: dict[Peer, Connection], now_secs: float) -> None:
        nameless = found.keys() - self._received.keys()
        self._nameless_secs = {peer: self._nameless_secs.get(peer, now_secs) for peer in nameless}
        for peer, since_secs in self._nameless_secs.items():
            if now_secs - since_secs > SILENT_SECS:
                self._turnstile.let_go(peer, found[peer])

    def _say_unlisted(self, identity: str, peers: list[Peer], now_secs: float) -> None:
        if self._is_news(f"unlisted {identity}", now_secs):
            log.warning(
                "turned away %r (%s): its certificate is good, but it is not in the list of hosts",
                identity,
                _addresses(peers),
            )

    def _is_news(self, what: str, now_secs: float) -> bool:
        """True for the first time in AGAIN_SECS."""
        self._told_secs = {old: secs for old, secs in self._told_secs.items() if now_secs < secs + AGAIN_SECS}
        known = what in self._told_secs
        self._told_secs.setdefault(what, now_secs)
        return not known

    def _let_in_again(self, now_secs: float) -> None:
        banned = self._bans.banned(now_secs)
        for identity in sorted(self._kept_out - banned):
            knocks = self._turnstile.knocks(identity)
            log.info("%s may connect again; %d of its connections were cut", identity, knocks)
        self._kept_out = banned

    def _of(self, identity: str) -> Conduct | None:
        """Its conduct; none is kept of who is not listed."""
        return self._conduct.setdefault(identity, Conduct()) if self._is_listed(identity) else None

    def _is_welcome(self, identity: str) -> bool:
        return identity not in self._kept_out and self._is_listed(identity)

    def _is_listed(self, identity: str) -> bool:
        named = role_and_host(identity)
        if named is None:
            return False
        role, host = named
        return host in self._hosts if role == ACTOR else role != ROUTER


def _identity(host: str) -> str:
    return f"{ACTOR}.{host}"


def _host(identity: str) -> str | None:
    named = role_and_host(identity)
    return None if named is None else named[1] or None


def _addresses(peers: list[Peer]) -> str:
    hosts = sorted({host for host, _ in peers})
    more = f" and {len(hosts) - SHOWN_ADDRESSES} more" if len(hosts) > SHOWN_ADDRESSES else ""
    where = ", ".join(hosts[:SHOWN_ADDRESSES]) or "no longer connected"
    return f"{where}{more}, {len(peers)} connection{'' if len(peers) == 1 else 's'}"
