"""A dashboard on a memory bus, a hand clock and free ports, with everybody it could hear."""

import argparse
import json
from collections.abc import Iterable
from datetime import UTC, datetime
from pathlib import Path

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Phase, PhaseAnnounced, Status, View
from services.dashboard.service import Dashboard
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.clock import HandClock
from services.runtime.memory_bus import Connection, MemoryBus
from services.runtime.process import Context
from services.runtime.settings import RunSettings
from tests.unit.dashboard_feed import RUN, Feed, key_of

BEGAN_SECS = 1_800_000_000.0


class Stage:
    """Plays a run to a dashboard, with the time in hand."""

    def __init__(self, run_dir: Path, settings: RunSettings, *, actors: int = 3, columns: int = 8) -> None:
        self.run_dir = run_dir
        self.settings = settings
        self.hub = MemoryBus()
        self.clock = HandClock(BEGAN_SECS)
        self.feed = Feed(settings, actors=actors, columns=columns)
        self.dashboard: Dashboard | None = None
        self._lives: dict[str, Connection] = {}
        self._starts = 0
        self._said = Inbox()
        self.hub.connect("listener").subscribe("status", keys.status(RUN, "dashboard", "*"), self._said)
        created = datetime.fromtimestamp(BEGAN_SECS, UTC).isoformat()
        (run_dir / "run.json").write_text(json.dumps({"run": RUN, "created": created}))

    def start(self, **options: object) -> Dashboard:
        """A dashboard process begins."""
        self._starts += 1
        life = f"dashboard-{self._starts}"
        given = {"bind": "127.0.0.1", "web_port": 0, "grpc_port": 0, **options}
        context = Context(
            bus=self.hub.connect(life),
            clock=self.clock,
            settings=self.settings,
            run=RUN,
            run_dir=self.run_dir,
            life=life,
            wakeup=Wakeup(),
            options=argparse.Namespace(**given),
        )
        self.dashboard = Dashboard(context)
        return self.dashboard

    def end(self) -> None:
        """The dashboard is asked to stop."""
        if self.dashboard is not None:
            self.dashboard.stop()
            assert self.dashboard.poll(self.clock.now_secs()) is None
            self.dashboard = None

    def poll(self, secs: float = 0.1) -> float | None:
        """Let time pass, then give the dashboard a turn."""
        assert self.dashboard is not None
        self.clock.advance(secs)
        return self.dashboard.poll(self.clock.now_secs())

    def join(self, service: str, life: str) -> Connection:
        """A member is there."""
        self._lives[life] = self.hub.connect(life)
        self._lives[life].announce(keys.alive(RUN, service, life))
        return self._lives[life]

    def everybody_joins(self) -> None:
        """All of the feed are there."""
        for service, life in self.feed.lives:
            self.join(service, life)

    def say(
        self, messages: Iterable[View | Status | PhaseAnnounced] | View | Status | PhaseAnnounced
    ) -> None:
        """Publish messages, each as the life in its header; the dead say nothing."""
        for message in [messages] if isinstance(messages, View | Status | PhaseAnnounced) else messages:
            kind, key = key_of(message)
            if not self._lives[message.life].closed:
                self._lives[message.life].publish(kind, key, encode(message))

    def play(self, secs: float, phase: Phase, term: int, *, views_per_sec: int = 5) -> None:
        """A while of a phase: views, statuses each second, ten polls a second."""
        for tick in range(round(secs * 10)):
            if tick % (10 // views_per_sec) == 0:
                self.say(self.feed.views())
            if tick % 10 == 0:
                self.say(self.feed.statuses(phase, term))
            assert self.poll() is not None

    def said(self) -> list[Status]:
        """The dashboard's own statuses since the last look."""
        frames = [arrival for arrival in self._said.take_all() if isinstance(arrival, Frame)]
        statuses = [decode(frame.data) for frame in frames]
        return [status for status in statuses if isinstance(status, Status)]
