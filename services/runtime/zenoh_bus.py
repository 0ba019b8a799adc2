"""The bus between processes: Eclipse Zenoh 1.10, as clients of one router. The only file that imports zenoh.

Each process has two connections, so that a phase, an acknowledgement or a status never waits behind
experience or models (`DELIVERY.link`). How Zenoh is configured, and why, is in `transport.py`.
"""

import json
import logging
import os
import threading
import time
from collections.abc import Callable, Mapping
from typing import Any, Protocol

import zenoh
import zenoh.ext

from protocol.keys import DELIVERY, Delivery, is_member
from services.runtime import transport
from services.runtime.bus import Frame, Inbox, Link, Membership, Question, Wakeup, refuse_oversized
from services.runtime.closing import close_with_main_thread
from services.runtime.credentials import Credential
from services.runtime.diagnosis import ShortVisits, diagnose, let_in, turned_away
from services.runtime.errors import BusError, RefusedError
from services.runtime.transport import RouterLink as RouterLink

log = logging.getLogger(__name__)

HEARTBEAT_SECS = 0.5
"""A subscriber that missed the newest model or phase notices within this time."""
ATTEMPT_SECS = 1.0
"""One attempt to connect; a signal is heard between attempts."""
DOOR_SECS = 1.0
CLOSE_SECS = 3.0
ROUTER_CLOSE_SECS = 0.5
MAX_PUBLISHERS = 512
"""Declared publishers that are kept for reuse; the oldest that retains nothing goes first."""


class _Undeclarable(Protocol):
    def undeclare(self) -> None: ...


class ZenohBus:
    """A process's `Bus` over a router at `endpoint`, such as "tcp/127.0.0.1:7447".

    When the router goes, puts are lost without an error; when one is there again, within about a
    second everything declared here is declared there, and retained frames are exchanged.
    """

    def __init__(
        self,
        endpoint: str,
        life: str,
        wakeup: Wakeup,
        connect_secs: float,
        credential: Credential | None = None,
    ) -> None:
        """Connects; a credential is for a tls/ endpoint.

        Raises `BusError` with the cause if no router lets it in within about `connect_secs`, at once
        `RefusedError` if waiting does not help.
        """
        self._life = life
        self._wakeup = wakeup
        self._lock = threading.Lock()
        self._closed = False
        self._up = {"control": False, "data": False}
        self._cuts = 0
        self._visits = ShortVisits()
        self._turned_away = turned_away(endpoint, credential) if credential is not None else ""
        self._link_inboxes: list[Inbox] = []
        self._publishers: dict[str, tuple[str, Any]] = {}
        self._declared: list[_Undeclarable] = []
        self._sessions: dict[str, zenoh.Session] = {}
        deadline = time.monotonic() + connect_secs
        close_with_main_thread(self)
        try:
            for link in self._up:
                session = _connect(endpoint, credential, deadline, connect_secs)
                self._sessions[link] = session
                self._up[link] = True
                self._declared.append(_watch_transports(session, self._link_hearer(link)))
            if credential is not None and not let_in(self._ask_at_door, lambda: self._cuts):
                raise BusError(self._turned_away)
        except BaseException:
            self.close()
            raise

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """See `Bus.publish`. Raises `Refused` for an oversized frame, `BusError` once closed."""
        refuse_oversized(key, frame)
        _, publisher = self._publishers.get(key) or self._declare_publisher(kind, key)
        try:
            publisher.put(frame)
        except zenoh.ZError as error:
            raise BusError(f"{self._life} could not publish on {key}: {error}") from None

    def subscribe(self, kind: str, key_expr: str, inbox: Inbox) -> None:
        """See `Bus.subscribe`."""

        def hear(sample: zenoh.Sample) -> None:
            inbox.put(Frame(str(sample.key_expr), sample.payload.to_bytes()))

        row = DELIVERY[kind]
        session = self._session(row.link)
        if row.promise == "latest-wins":
            subscriber: _Undeclarable = zenoh.ext.declare_advanced_subscriber(
                session,
                key_expr,
                hear,
                history=zenoh.ext.HistoryConfig(max_samples=1, detect_late_publishers=True),
                recovery=zenoh.ext.RecoveryConfig(periodic_queries=None, heartbeat=True),
            )
        else:
            subscriber = session.declare_subscriber(key_expr, hear)
        self._declared.append(subscriber)

    def announce(self, key: str) -> None:
        """See `Bus.announce`."""
        self._declared.append(self._session("control").liveliness().declare_token(key))

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """See `Bus.watch`, of members only. When this process's own link goes, all are reported gone."""
        self._declared.append(_watch_tokens(self._session("control"), key_expr, inbox, is_member))

    def watch_link(self, inbox: Inbox) -> None:
        """See `Bus.watch_link`; up means that both connections are."""
        self._link_inboxes.append(inbox)

    def linked(self) -> bool:
        """See `Bus.linked`."""
        return not self._closed and all(self._up.values())

    def answer(self, key: str, inbox: Inbox) -> None:
        """See `Bus.answer`. A question that the inbox drops is answered with nothing."""

        def hear(query: zenoh.Query) -> None:
            def reply(data: bytes) -> None:
                try:
                    with query:
                        query.reply(key, data)
                except zenoh.ZError as error:
                    log.warning("nobody waits for the answer on %s any more: %s", key, error)

            payload = query.payload
            inbox.put(Question(key, b"" if payload is None else payload.to_bytes(), reply))

        self._declared.append(self._session("control").declare_queryable(key, hear, complete=True))

    def ask(self, key: str, frame: bytes, timeout_secs: float) -> bytes | None:
        """See `Bus.ask`."""
        refuse_oversized(key, frame)
        replies = self._session("control").get(
            key,
            payload=frame,
            timeout=timeout_secs,
            **_quality(DELIVERY["command"]),
        )
        for reply in replies:
            if reply.ok is not None:
                return reply.ok.payload.to_bytes()
        return None

    def close(self) -> None:
        """See `Bus.close`. Returns within CLOSE_SECS even if the router is stuck; idempotent."""
        with self._lock:
            if self._closed:
                return
            self._closed = True
        self._link_inboxes.clear()
        closer = threading.Thread(target=self._undeclare_and_close, name="bus-close", daemon=True)
        closer.start()
        closer.join(CLOSE_SECS)
        if closer.is_alive():
            log.warning("the router did not take leave of %s within %.0f s", self._life, CLOSE_SECS)

    def _undeclare_and_close(self) -> None:
        publishers = [publisher for _, publisher in self._publishers.values()]
        leave = [declared.undeclare for declared in [*self._declared, *publishers]]
        for step in [*leave, *(session.close for session in self._sessions.values())]:
            try:
                step()
            except zenoh.ZError as error:
                log.debug("at close: %s", error)

    def _ask_at_door(self) -> bool:
        replies = self._sessions["control"].get(transport.DOOR, timeout=DOOR_SECS)
        return any(reply.ok is not None for reply in replies)

    def _session(self, link: str) -> zenoh.Session:
        if self._closed:
            raise BusError(f"the connection of {self._life} is closed and can no longer be used")
        return self._sessions[link]

    def _declare_publisher(self, kind: str, key: str) -> tuple[str, Any]:
        if len(self._publishers) >= MAX_PUBLISHERS:
            self._forget_oldest_publisher()
        row = DELIVERY[kind]
        session = self._session(row.link)
        if row.promise == "latest-wins":
            self._publishers[key] = (kind, _latest_publisher(session, key, row))
        else:
            self._publishers[key] = (kind, session.declare_publisher(key, **_quality(row)))
        return self._publishers[key]

    def _forget_oldest_publisher(self) -> None:
        for key, (kind, publisher) in self._publishers.items():
            if DELIVERY[kind].promise != "latest-wins":
                publisher.undeclare()
                del self._publishers[key]
                return

    def _link_hearer(self, link: str) -> Callable[[bool], None]:
        def hear(up: bool) -> None:
            with self._lock:
                before = all(self._up.values())
                self._up[link] = up
                self._cuts += not up
                after = all(self._up.values())
                if before == after or self._closed:
                    return
                for inbox in self._link_inboxes:
                    inbox.put(Link(after))
                cut_short = self._visits.note(after, time.monotonic())
            if cut_short and self._turned_away:
                log.warning(self._turned_away)
            self._wakeup.ring()

        return hear


class Router:
    """A Zenoh router inside this process; `close` ends it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._closed = False
        self._declared: list[_Undeclarable] = []

    def links(self) -> list[RouterLink]:
        """The connections of all clients now."""
        return [RouterLink.of(link.auth_identifier, link.dst) for link in self._session.info.links()]

    def watch_links(self, hear: Callable[[RouterLink], None]) -> None:
        """Call `hear` with each connection there is and each that is made, on a thread of the transport."""

        def tell(event: zenoh.LinkEvent) -> None:
            if event.kind == zenoh.SampleKind.PUT:
                hear(RouterLink.of(event.link.auth_identifier, event.link.dst))

        self._declared.append(self._session.info.declare_link_events_listener(tell, history=True))

    def hear(self, key_expr: str, inbox: Inbox) -> None:
        """Put each `Frame` that clients may publish on matching keys into the inbox.

        It is put there by the thread that routes it, so that nothing piles up on the way.
        """

        def hear(sample: zenoh.Sample) -> None:
            inbox.put(Frame(str(sample.key_expr), sample.payload.to_bytes()))

        callback = zenoh.handlers.Callback(hear, indirect=False)
        self._declared.append(self._session.declare_subscriber(key_expr, callback))

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """Put a `Membership` into the inbox for each token present now and each change, whatever its key."""
        self._declared.append(_watch_tokens(self._session, key_expr, inbox, lambda _: True))

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """Send a frame of a kind that is not retained, such as the router's own status.

        Raises `Refused` for an oversized frame, `BusError` once closed.
        """
        refuse_oversized(key, frame)
        try:
            self._session.put(key, frame, **_quality(DELIVERY[kind]))
        except zenoh.ZError as error:
            raise BusError(f"the router could not publish on {key}: {error}") from None

    def linked(self) -> bool:
        """True until it is closed; a router needs no other to hear its clients."""
        return not self._closed

    def open_door(self) -> None:
        """Answer whoever may ask at the `transport.DOOR`, so that others can tell that they may not."""
        callback = zenoh.handlers.Callback(_welcome, indirect=False)
        self._declared.append(self._session.declare_queryable(transport.DOOR, callback, complete=True))

    def close(self) -> None:
        """Leave all clients, without waiting for a stuck one longer than ROUTER_CLOSE_SECS."""
        self._closed = True
        closer = threading.Thread(target=self._session.close, name="router-close", daemon=True)
        closer.start()
        closer.join(ROUTER_CLOSE_SECS)


def _welcome(query: zenoh.Query) -> None:
    with query:
        query.reply(transport.DOOR, b"")


def open_router(
    endpoint: str, *, credential: Credential | None = None, access: Mapping[str, object] | None = None
) -> Router:
    """Listen at `endpoint` as a router. Call it before anything else of zenoh in this process.

    With a credential it lets in only who shows one of the same authority; `access` is Zenoh's
    configuration of who may do what (default: everybody everything).
    Raises `BusError` if the address is taken or is no address.
    """
    os.environ["ZENOH_RUNTIME"] = transport.ROUTER_THREADS
    settings = transport.router_settings(endpoint, credential, access)
    try:
        router = Router(zenoh.open(_configured(settings)))
    except zenoh.ZError as error:
        raise BusError(
            f"cannot listen at {endpoint} ({_reason(error)}); end the process that has this address, or "
            "give --listen another address of this machine"
        ) from None
    router.open_door()
    return router


def _connect(
    endpoint: str, credential: Credential | None, deadline: float, connect_secs: float
) -> zenoh.Session:
    settings = transport.client_settings(endpoint, credential)
    told = False
    while True:
        left_secs = deadline - time.monotonic()
        settings["connect/timeout_ms"] = max(1, round(1000 * min(ATTEMPT_SECS, left_secs)))
        try:
            return zenoh.open(_configured(settings))
        except zenoh.ZError as error:
            log.debug("no router yet at %s: %s", endpoint, error)
        late = left_secs <= ATTEMPT_SECS
        if late or not told:
            found, told = diagnose(endpoint, credential), True
            if found.lasting:
                raise RefusedError(f"cannot connect to {endpoint}: {found.cause}")
            if late:
                raise BusError(f"no router answered at {endpoint} within {connect_secs:.0f} s: {found.cause}")
            log.info("waiting for the router at %s: %s", endpoint, found.cause)
        time.sleep(0.05)


def _configured(settings: transport.Settings) -> zenoh.Config:
    config = zenoh.Config()
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    return config


def _quality(row: Delivery) -> dict[str, Any]:
    """What a put, a question or a publisher of this kind is told of priority and congestion."""
    priority = getattr(zenoh.Priority, row.priority.replace("-", "_").upper())
    return {
        "priority": priority,
        "congestion_control": getattr(zenoh.CongestionControl, row.on_full.upper()),
    }


def _latest_publisher(session: zenoh.Session, key: str, row: Delivery) -> zenoh.ext.AdvancedPublisher:
    quality = _quality(row)
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        **quality,
        express=row.priority == "real-time",
        cache=zenoh.ext.CacheConfig(max_samples=1, replies_config=zenoh.ext.RepliesConfig(**quality)),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=HEARTBEAT_SECS, sporadic_heartbeat=None
        ),
        publisher_detection=True,
    )


def _watch_tokens(
    session: zenoh.Session, key_expr: str, inbox: Inbox, wanted: Callable[[str], bool]
) -> _Undeclarable:
    def hear(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        if wanted(key):
            inbox.put(Membership(key, sample.kind == zenoh.SampleKind.PUT))

    return session.liveliness().declare_subscriber(key_expr, hear, history=True)


def _watch_transports(session: zenoh.Session, hear: Callable[[bool], None]) -> _Undeclarable:
    return session.info.declare_transport_events_listener(
        lambda event: hear(event.kind == zenoh.SampleKind.PUT), history=False
    )


def _reason(error: zenoh.ZError) -> str:
    text = str(error)
    return "the address is in use" if "in use" in text else text.split(" at ")[0][:200]
