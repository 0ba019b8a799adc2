"""A router that a test plays: its connections, what is heard on it, and the kernel below it."""

from collections import defaultdict
from collections.abc import Callable

from services.router.config import Limits
from services.router.sockets import Connection, Peer
from services.router.watch import Watch
from services.runtime.bus import Frame, Inbox, Membership
from services.runtime.transport import RouterLink

LIMITS = Limits(mb_per_sec=10, messages_per_sec=100, garbage=5, lives=3)


class PlayedRouter:
    """What the router's rooms ask of `zenoh_bus.Router`."""

    def __init__(self) -> None:
        self.open: dict[Peer, str | None] = {}
        self.received: dict[Peer, int] = defaultdict(int)
        self.nameless: set[Peer] = set()
        """connections that the router does not list"""
        self.cut: list[str | None] = []
        """identities of the connections that were cut"""
        self.mute: list[Peer] = []
        """connections that are not heard"""
        self.said: list[tuple[str, bytes]] = []
        self.inboxes: dict[str, Inbox] = {}

    def links(self) -> list[RouterLink]:
        return [RouterLink(identity, *peer) for peer, identity in self.open.items()]

    def hear(self, key_expr: str, inbox: Inbox) -> None:
        self.inboxes[key_expr] = inbox

    def watch(self, key_expr: str, inbox: Inbox) -> None:
        self.inboxes[key_expr] = inbox

    def watch_links(self, hear: Callable[[RouterLink], None]) -> None:
        self._hear_link = hear

    def publish(self, kind: str, key: str, frame: bytes) -> None:
        assert kind == "status"
        self.said.append((key, frame))

    def linked(self) -> bool:
        return True

    def connect(self, identity: str | None, port: int, host: str = "10.0.0.7") -> Peer:
        """A client's connection."""
        peer = (host, port)
        self.open[peer], self.received[peer] = identity, 0
        return peer

    def knock(self, identity: str, port: int) -> Peer:
        """A client's connection, of which the watch is told as it is made."""
        peer = self.connect(identity, port)
        self._hear_link(RouterLink(identity, *peer))
        return peer

    def publishes(self, key_expr: str, key: str, data: bytes, times: int = 1) -> None:
        """Clients say something."""
        for _ in range(times):
            self.inboxes[key_expr].put(Frame(key, data))

    def announces(self, key_expr: str, key: str, present: bool = True) -> None:
        """A token comes or goes."""
        self.inboxes[key_expr].put(Membership(key, present))

    def look(self) -> dict[Peer, Connection]:
        """As `sockets.connections`."""
        return {peer: Connection(self.received[peer]) for peer in [*self.open, *self.nameless]}

    def hush(self, peer: Peer) -> bool:
        """As `sockets.mute`."""
        self.mute.append(peer)
        return True

    def shut(self, peer: Peer, connection: Connection) -> bool:
        """As `sockets.cut`."""
        self.cut.append(self.open.pop(peer, "nameless"))
        self.nameless.discard(peer)
        return True


class WatchStage:
    """A watch over a played router, and its time."""

    def __init__(self, *hosts: str) -> None:
        self.now_secs = 1000.0
        self.router = PlayedRouter()
        kernel = self.router
        self.watch = Watch(
            LIMITS, look=kernel.look, shut=kernel.shut, hush=kernel.hush, clock=lambda: self.now_secs
        )
        self.watch.attach(self.router, frozenset(hosts or ("lab", "den")))

    def poll(self, after_secs: float = 0.25) -> None:
        """Let time go on and the watch look."""
        self.now_secs += after_secs
        self.watch.poll(self.now_secs)

    def total(self, name: str) -> int:
        """One of the totals that go into the router's status."""
        count: int = self.watch.report()["totals"][name]
        return count
