"""The bus between processes: Eclipse Zenoh 1.10, as clients of one router. The only file that imports zenoh.

Each process has two connections, so that a phase, an acknowledgement or a status never waits behind
experience or models (`DELIVERY.link`). The settings are those that measurements showed to matter:
a lease of 1 s, no multicast, no gossip, no shared memory, a stated size limit; in the router 16
receiving threads, and a stuck client is cut off after 400 ms, well before a healthy client's lease ends.
"""

import json
import logging
import os
import threading
import time
import weakref
from collections.abc import Callable, Sequence
from typing import Any, Protocol

import zenoh
import zenoh.ext

from protocol.keys import DELIVERY, MAX_FRAME_BYTES, Delivery
from services.runtime.bus import Frame, Inbox, Link, Membership, Question, Wakeup, refuse_oversized
from services.runtime.errors import BusError

log = logging.getLogger(__name__)

LEASE_MS = 1000
"""A process that is silent for so long is gone to the others; each side announces its own."""
CUT_OFF_US = 400_000
"""Router only; must be shorter than the lease, or a stuck subscriber costs its publishers their links."""
ENVELOPE_BYTES = 64 << 10
"""Room for key and header, so that a frame of exactly MAX_FRAME_BYTES is not silently dropped."""
ROUTER_THREADS = (
    "(rx: (worker_threads: 16), net: (worker_threads: 4), tx: (worker_threads: 8), acc: (worker_threads: 4))"
)
RETRY = {"period_init_ms": 200, "period_max_ms": 1000, "period_increase_factor": 1.5}
HEARTBEAT_SECS = 0.5
"""A subscriber that missed the newest model or phase notices within this time."""
ATTEMPT_SECS = 1.0
"""One attempt to connect; a signal is heard between attempts."""
CLOSE_SECS = 3.0
ROUTER_CLOSE_SECS = 0.5
MAX_PUBLISHERS = 512
"""Declared publishers that are kept for reuse; the oldest that retains nothing goes first."""

PRIORITIES = {
    "real-time": zenoh.Priority.REAL_TIME,
    "interactive-high": zenoh.Priority.INTERACTIVE_HIGH,
    "data-high": zenoh.Priority.DATA_HIGH,
    "data": zenoh.Priority.DATA,
    "data-low": zenoh.Priority.DATA_LOW,
    "background": zenoh.Priority.BACKGROUND,
}
CONGESTION = {"block": zenoh.CongestionControl.BLOCK, "drop": zenoh.CongestionControl.DROP}


_open_buses: weakref.WeakSet["ZenohBus"] = weakref.WeakSet()
_guard_lock = threading.Lock()
_guard: threading.Thread | None = None


class _Undeclarable(Protocol):
    def undeclare(self) -> None: ...


class ZenohBus:
    """A process's `Bus` over a router at `endpoint`, such as "tcp/127.0.0.1:7447".

    When the router goes, puts are lost without an error; when one is there again, within about a
    second everything declared here is declared there, and retained frames are exchanged.
    """

    def __init__(self, endpoint: str, life: str, wakeup: Wakeup, connect_secs: float) -> None:
        """Connects. Raises `BusError` if no router answers within `connect_secs`."""
        self._life = life
        self._wakeup = wakeup
        self._lock = threading.Lock()
        self._closed = False
        self._up = {"control": False, "data": False}
        self._link_inboxes: list[Inbox] = []
        self._publishers: dict[str, tuple[str, Any]] = {}
        self._declared: list[_Undeclarable] = []
        self._sessions: dict[str, zenoh.Session] = {}
        deadline = time.monotonic() + connect_secs
        _close_with_main_thread(self)
        try:
            for link in self._up:
                session = _connect(endpoint, deadline, connect_secs)
                self._sessions[link] = session
                self._up[link] = True
                self._declared.append(_watch_transports(session, self._link_hearer(link)))
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
        """See `Bus.watch`. When this process's own link goes, all tokens are reported gone."""

        def hear(sample: zenoh.Sample) -> None:
            inbox.put(Membership(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))

        liveliness = self._session("control").liveliness()
        self._declared.append(liveliness.declare_subscriber(key_expr, hear, history=True))

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
            priority=PRIORITIES[DELIVERY["command"].priority],
            congestion_control=CONGESTION[DELIVERY["command"].on_full],
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
        for declared in [*self._declared, *publishers]:
            try:
                declared.undeclare()
            except zenoh.ZError as error:
                log.debug("undeclaring at close: %s", error)
        for session in self._sessions.values():
            session.close()  # type: ignore[no-untyped-call]

    def _session(self, link: str) -> zenoh.Session:
        if self._closed:
            raise BusError(f"the connection of {self._life} is closed and can no longer be used")
        return self._sessions[link]

    def _declare_publisher(self, kind: str, key: str) -> tuple[str, Any]:
        if len(self._publishers) >= MAX_PUBLISHERS:
            self._forget_oldest_publisher()
        row = DELIVERY[kind]
        declare = _latest_publisher if row.promise == "latest-wins" else _plain_publisher
        self._publishers[key] = (kind, declare(self._session(row.link), key, row))
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
                after = all(self._up.values())
                if before == after or self._closed:
                    return
                for inbox in self._link_inboxes:
                    inbox.put(Link(after))
            self._wakeup.ring()

        return hear


class Router:
    """A Zenoh router inside this process; `close` ends it."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session

    def close(self) -> None:
        """Leave all clients, without waiting for a stuck one longer than ROUTER_CLOSE_SECS."""
        closer = threading.Thread(target=self._session.close, name="router-close", daemon=True)
        closer.start()
        closer.join(ROUTER_CLOSE_SECS)


def _close_with_main_thread(bus: ZenohBus) -> None:
    """Close a forgotten bus when the main thread ends, or zenoh's threads keep the process for ever."""
    global _guard
    with _guard_lock:
        _open_buses.add(bus)
        if _guard is None:
            _guard = threading.Thread(target=_close_forgotten, name="bus-guard")
            _guard.start()


def _close_forgotten() -> None:
    threading.main_thread().join()
    for bus in list(_open_buses):
        bus.close()


def open_router(endpoint: str) -> Router:
    """Listen at `endpoint` as a router. Call it before anything else of zenoh in this process.

    Raises `BusError` if the address is taken or is no address.
    """
    os.environ["ZENOH_RUNTIME"] = ROUTER_THREADS
    config = _config("router", listen=[endpoint])
    _set(config, "adminspace/enabled", True)
    _set(config, "transport/link/tx/queue/congestion_control/block/wait_before_close", CUT_OFF_US)
    try:
        return Router(zenoh.open(config))
    except zenoh.ZError as error:
        raise BusError(
            f"cannot listen at {endpoint} ({_reason(error)}); "
            "end the process that has this address, or choose another with --listen tcp/<address>:<port>"
        ) from None


def _connect(endpoint: str, deadline: float, connect_secs: float) -> zenoh.Session:
    config = _config("client", connect=[endpoint])
    _set(config, "connect/retry", RETRY)
    while (left_secs := deadline - time.monotonic()) > 0:
        _set(config, "connect/timeout_ms", max(1, round(1000 * min(ATTEMPT_SECS, left_secs))))
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            log.debug("no router yet at %s: %s", endpoint, error)
            time.sleep(min(0.05, left_secs))
    raise BusError(
        f"no router answered at {endpoint} within {connect_secs:.0f} s; "
        "start one with `python -m services.router` or check the address"
    )


def _config(mode: str, *, listen: Sequence[str] = (), connect: Sequence[str] = ()) -> zenoh.Config:
    config = zenoh.Config()
    _set(config, "mode", mode)
    try:
        _set(config, "listen/endpoints", [*listen])
        _set(config, "connect/endpoints", [*connect])
    except zenoh.ZError:
        wrong = " ".join([*listen, *connect])
        raise BusError(f"{wrong!r} is not an address; it must look like tcp/127.0.0.1:7447") from None
    _set(config, "scouting/multicast/enabled", False)
    _set(config, "scouting/gossip/enabled", False)
    _set(config, "transport/shared_memory/enabled", False)
    _set(config, "transport/link/tx/lease", LEASE_MS)
    _set(config, "transport/link/rx/max_message_size", MAX_FRAME_BYTES + ENVELOPE_BYTES)
    return config


def _set(config: zenoh.Config, path: str, value: object) -> None:
    config.insert_json5(path, json.dumps(value))


def _plain_publisher(session: zenoh.Session, key: str, row: Delivery) -> zenoh.Publisher:
    return session.declare_publisher(
        key, congestion_control=CONGESTION[row.on_full], priority=PRIORITIES[row.priority]
    )


def _latest_publisher(session: zenoh.Session, key: str, row: Delivery) -> zenoh.ext.AdvancedPublisher:
    congestion, priority = CONGESTION[row.on_full], PRIORITIES[row.priority]
    return zenoh.ext.declare_advanced_publisher(
        session,
        key,
        congestion_control=congestion,
        priority=priority,
        express=row.priority == "real-time",
        cache=zenoh.ext.CacheConfig(
            max_samples=1,
            replies_config=zenoh.ext.RepliesConfig(congestion_control=congestion, priority=priority),
        ),
        sample_miss_detection=zenoh.ext.MissDetectionConfig(
            heartbeat=HEARTBEAT_SECS, sporadic_heartbeat=None
        ),
        publisher_detection=True,
    )


def _watch_transports(session: zenoh.Session, hear: Callable[[bool], None]) -> _Undeclarable:
    return session.info.declare_transport_events_listener(
        lambda event: hear(event.kind == zenoh.SampleKind.PUT), history=False
    )


def _reason(error: zenoh.ZError) -> str:
    text = str(error)
    return "the address is in use" if "in use" in text else text.split(" at ")[0][:200]
