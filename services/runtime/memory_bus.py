"""The bus within one process and one thread: the whole system in a simulation, with faults on demand.

It behaves as Zenoh was measured to behave, including what hurts: what a sender retains goes with
it, a cut link loses frames without an error, and who is cut off sees everybody else vanish.
Nothing here reads a clock; all randomness comes from the seed, so a run repeats exactly.
"""

import random
import threading
from collections.abc import Callable, Set
from dataclasses import dataclass, field

from protocol.keys import DELIVERY
from services.runtime.bus import Frame, Inbox, Link, Membership, Question, Wakeup, refuse_oversized
from services.runtime.errors import BusError

PUMPS_PER_ASK = 1000
"""How often a waiting `ask` gives the other services their turn before it gives up."""
LONGEST_DELAY = 8
"""A reordered frame arrives after 1 to this many later frames of the bus."""


@dataclass(frozen=True, kw_only=True)
class Faults:
    """Chances, each per frame and receiver, of what may happen to frames of `kinds`."""

    drop: float = 0.0
    duplicate: float = 0.0
    reorder: float = 0.0
    kinds: Set[str] = frozenset({"segment", "ack"})


@dataclass(eq=False)
class _Subscription:
    life: str
    key_expr: str
    inbox: Inbox
    heard: dict[str, int] = field(default_factory=dict)
    """The number of the newest retained frame handed over, by key."""


@dataclass(frozen=True)
class _Retained:
    number: int
    life: str
    frame: Frame


@dataclass(eq=False)
class _Delayed:
    frames_left: int
    sender: str
    subscription: _Subscription
    frame: Frame


class MemoryBus:
    """The hub; each service of the simulation has a connection to it."""

    def __init__(self, seed: int = 0) -> None:
        self.faults = Faults()
        self.dropped = 0
        """Frames lost to faults and cut links, per receiver."""
        self.duplicated = 0
        self.reordered = 0
        self.pump: Callable[[], None] | None = None
        """Gives the services a turn while an `ask` waits; without it `ask` waits for other threads."""
        self._random = random.Random(seed)
        self._connections: dict[str, Connection] = {}
        self._cut: set[str] = set()
        self._subscriptions: list[_Subscription] = []
        self._tokens: dict[str, str] = {}
        self._watchers: list[_Subscription] = []
        self._link_watchers: list[tuple[str, Inbox]] = []
        self._answerers: dict[str, tuple[str, Inbox]] = {}
        self._retained: dict[str, _Retained] = {}
        self._delayed: list[_Delayed] = []
        self._published = 0

    def connect(self, life: str, wakeup: Wakeup | None = None) -> "Connection":
        """A new process joins under its life name. `wakeup` is rung by the inboxes, which know their own.

        Raises ValueError if the name is taken.
        """
        if life in self._connections:
            raise ValueError(f"{life!r} is already connected; a new process start has a new life name")
        self._connections[life] = Connection(self, life)
        return self._connections[life]

    def crash(self, life: str) -> None:
        """The process is killed: it says nothing more, its tokens and what it retained go."""
        self._leave(life)

    def cut(self, life: str) -> None:
        """The link between this process and the router goes down."""
        if life not in self._connections or life in self._cut:
            return
        others = [key for key, owner in self._tokens.items() if owner not in self._cut and owner != life]
        own = [key for key, owner in self._tokens.items() if owner == life]
        self._cut.add(life)
        self._tell_link(life, up=False)
        for watcher in self._watchers:
            lost = others if watcher.life == life else own if watcher.life not in self._cut else []
            for key in lost:
                _tell_member(watcher, key, present=False)

    def mend(self, life: str) -> None:
        """The link is up again: tokens come back and missed retained frames arrive."""
        if life not in self._cut:
            return
        self._cut.discard(life)
        self._tell_link(life, up=True)
        for watcher in self._watchers:
            for key, owner in self._tokens.items():
                concerned = life in (watcher.life, owner) and watcher.life != owner
                if concerned and self._reaches(owner, watcher.life):
                    _tell_member(watcher, key, present=True)
        for subscription in self._subscriptions:
            self._hand_over_retained(subscription)

    def _publish(self, life: str, kind: str, frame: Frame) -> None:
        self._published += 1
        if DELIVERY[kind].promise == "latest-wins":
            self._retained[frame.key] = _Retained(self._published, life, frame)
        for subscription in list(self._subscriptions):
            if matches(subscription.key_expr, frame.key):
                self._send(life, kind, subscription, frame)
        for late in list(self._delayed):
            late.frames_left -= 1
            if late.frames_left < 0:
                self._delayed.remove(late)
                self._deliver(late.sender, late.subscription, late.frame)

    def _send(self, sender: str, kind: str, subscription: _Subscription, frame: Frame) -> None:
        if kind not in self.faults.kinds or sender == subscription.life:
            self._deliver(sender, subscription, frame)
            return
        if self._random.random() < self.faults.drop:
            self.dropped += 1
            return
        copies = 1
        if self._random.random() < self.faults.duplicate:
            self.duplicated += 1
            copies = 2
        for _ in range(copies):
            if self._random.random() < self.faults.reorder:
                self.reordered += 1
                delay = self._random.randint(1, LONGEST_DELAY)
                self._delayed.append(_Delayed(delay, sender, subscription, frame))
            else:
                self._deliver(sender, subscription, frame)

    def _deliver(self, sender: str, subscription: _Subscription, frame: Frame) -> None:
        if subscription not in self._subscriptions:
            return
        if not self._reaches(sender, subscription.life):
            self.dropped += 1
            return
        retained = self._retained.get(frame.key)
        if retained is not None and retained.frame is frame:
            subscription.heard[frame.key] = retained.number
        subscription.inbox.put(frame)

    def _subscribe(self, subscription: _Subscription) -> None:
        self._subscriptions.append(subscription)
        self._hand_over_retained(subscription)

    def _hand_over_retained(self, subscription: _Subscription) -> None:
        for key, retained in self._retained.items():
            wanted = matches(subscription.key_expr, key) and retained.number > subscription.heard.get(key, 0)
            if wanted and self._reaches(retained.life, subscription.life):
                self._deliver(retained.life, subscription, retained.frame)

    def _announce(self, life: str, key: str) -> None:
        self._tokens[key] = life
        for watcher in self._watchers:
            if self._reaches(life, watcher.life):
                _tell_member(watcher, key, present=True)

    def _watch(self, watcher: _Subscription) -> None:
        self._watchers.append(watcher)
        for key, owner in self._tokens.items():
            if self._reaches(owner, watcher.life):
                _tell_member(watcher, key, present=True)

    def _ask(self, life: str, key: str, data: bytes, timeout_secs: float) -> bytes | None:
        owner, inbox = self._answerers.get(key, ("", None))
        if inbox is None or not self._reaches(life, owner):
            return None
        answers: list[bytes] = []
        answered = threading.Event()

        def reply(answer: bytes) -> None:
            if not answered.is_set():
                answers.append(answer)
                answered.set()

        inbox.put(Question(key, data, reply))
        if self.pump is None:
            answered.wait(timeout_secs)
        else:
            for _ in range(PUMPS_PER_ASK):
                if answered.is_set():
                    break
                self.pump()
        return answers[0] if answers and self._reaches(life, owner) else None

    def _leave(self, life: str) -> None:
        connection = self._connections.pop(life, None)
        if connection is None:
            return
        connection.closed = True
        gone = [key for key, owner in self._tokens.items() if owner == life]
        self._subscriptions = [s for s in self._subscriptions if s.life != life]
        self._watchers = [w for w in self._watchers if w.life != life]
        self._link_watchers = [(owner, inbox) for owner, inbox in self._link_watchers if owner != life]
        self._answerers = {key: held for key, held in self._answerers.items() if held[0] != life}
        self._retained = {key: held for key, held in self._retained.items() if held.life != life}
        for key in gone:
            del self._tokens[key]
            for watcher in self._watchers:
                if self._reaches(life, watcher.life):
                    _tell_member(watcher, key, present=False)
        self._cut.discard(life)

    def _reaches(self, one: str, other: str) -> bool:
        return one == other or (one not in self._cut and other not in self._cut)

    def _tell_link(self, life: str, *, up: bool) -> None:
        for owner, inbox in self._link_watchers:
            if owner == life:
                inbox.put(Link(up))


class Connection:
    """One process's `Bus` on the hub."""

    def __init__(self, hub: MemoryBus, life: str) -> None:
        self.life = life
        self.closed = False
        self._hub = hub

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        """See `Bus.publish`. Raises `BusError` once closed, as the other calls do."""
        refuse_oversized(key, frame)
        self._open_hub()._publish(self.life, kind, Frame(key, frame))

    def subscribe(self, kind: str, key_expr: str, inbox: Inbox) -> None:
        """See `Bus.subscribe`."""
        if kind not in DELIVERY:
            raise KeyError(kind)
        self._open_hub()._subscribe(_Subscription(self.life, key_expr, inbox))

    def announce(self, key: str) -> None:
        """See `Bus.announce`."""
        self._open_hub()._announce(self.life, key)

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        """See `Bus.watch`."""
        self._open_hub()._watch(_Subscription(self.life, key_expr, inbox))

    def watch_link(self, inbox: Inbox) -> None:
        """See `Bus.watch_link`."""
        self._open_hub()._link_watchers.append((self.life, inbox))

    def linked(self) -> bool:
        """See `Bus.linked`."""
        return not self.closed and self.life not in self._hub._cut

    def answer(self, key: str, inbox: Inbox) -> None:
        """See `Bus.answer`."""
        self._open_hub()._answerers[key] = (self.life, inbox)

    def ask(self, key: str, frame: bytes, timeout_secs: float) -> bytes | None:
        """See `Bus.ask`; with a `pump` on the hub the deadline counts turns instead of seconds."""
        refuse_oversized(key, frame)
        return self._open_hub()._ask(self.life, key, frame, timeout_secs)

    def close(self) -> None:
        """See `Bus.close`."""
        if not self.closed:
            self._hub._leave(self.life)

    def _open_hub(self) -> MemoryBus:
        if self.closed:
            raise BusError(f"the connection of {self.life} is closed and can no longer be used")
        return self._hub


def matches(key_expr: str, key: str) -> bool:
    """Whether a key expression covers a key: `*` is one chunk, `**` any number of chunks, also none."""
    return _chunks_match(key_expr.split("/"), key.split("/"))


def _chunks_match(pattern: list[str], chunks: list[str]) -> bool:
    if not pattern:
        return not chunks
    if pattern[0] == "**":
        return any(_chunks_match(pattern[1:], chunks[skipped:]) for skipped in range(len(chunks) + 1))
    return bool(chunks) and pattern[0] in ("*", chunks[0]) and _chunks_match(pattern[1:], chunks[1:])


def _tell_member(watcher: _Subscription, key: str, *, present: bool) -> None:
    if matches(watcher.key_expr, key):
        watcher.inbox.put(Membership(key, present))
