"""A whole run of real processes over a real router, whose parts a test kills and starts again."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from protocol import keys
from protocol.codec import decode
from protocol.messages import Status
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.checkpoint import Checkpoints
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import ROOT, Owner, Process, wait_for

RUN = "crash-test"
LEARNERS = ("encoder_learner", "policy_learner")
RUN_SECS = 180.0


class WatchedRun:
    """A run that is heard on its bus and read in its folder."""

    def __init__(self, run: str, run_dir: Path, endpoint: str) -> None:
        self.run_dir = run_dir
        self._bus = ZenohBus(endpoint, "test-0", Wakeup(), connect_secs=10.0)
        self._inbox = Inbox(max_frames=keys.DELIVERY["status"].keep)
        self._bus.subscribe("status", keys.status(run, "*", "*"), self._inbox)
        self._statuses: dict[str, Status] = {}

    def close(self) -> None:
        """Hear no more."""
        self.statuses()
        self._bus.close()

    def events(self, what: str) -> list[str]:
        """The texts of one kind of milestone so far."""
        path = self.run_dir / "events.jsonl"
        lines = path.read_text().splitlines() if path.exists() else []
        return [event["text"] for event in map(json.loads, lines) if event["what"] == what]

    def wait_for_phase(self, phase: str, times: int = 1) -> None:
        """Until a phase was announced so many times."""
        seen: Callable[[], bool] = lambda: (  # noqa: E731
            sum(text.startswith(phase) for text in self.events("phase")) >= times
        )
        wait_for(f"phase {phase}", seen, RUN_SECS)

    def statuses(self) -> dict[str, Status]:
        """The newest status of every life heard of."""
        for arrival in self._inbox.take_all():
            if isinstance(arrival, Frame):
                status = decode(arrival.data)
                assert isinstance(status, Status)
                self._statuses[status.life] = status
        return self._statuses

    def scores(self) -> list[dict[str, Any]]:
        """All score rows."""
        return [json.loads(line) for line in (self.run_dir / "scores.jsonl").read_text().splitlines()]

    def book(self, learner: str) -> dict[str, Any]:
        """What a learner's newest checkpoint says of the experience it took."""
        found = Checkpoints(self.run_dir / "checkpoints" / learner).newest()
        assert found is not None
        assert isinstance(found[1], dict)
        book: dict[str, Any] = json.loads(found[1]["book"])
        return book

    def assert_reached_both_ends(self) -> None:
        """The best iteration meets the thresholds of success."""
        best = json.loads((self.run_dir / "best.json").read_text())["body"]["iteration"]
        row = next(s for s in self.scores() if s["iteration"] == best and s["policy"] == "mean")
        assert row["separation"] >= 0.9
        assert row["z_min"] >= 0.9

    def assert_nothing_lost_or_counted_twice(self) -> None:
        """Each learner took each stream's segments once, without a gap, and all that was sent."""
        held: dict[str, int] = {}
        for learner in LEARNERS:
            book = self.book(learner)
            streams = book["ledger"]["streams"]
            assert book["received"] == sum(upto for _, _, upto, _ in streams)
            for life, _, upto, _ in streams:
                held[life] = held.get(life, 0) + upto
        for life, status in self.statuses().items():
            if status.service == "actor":
                sent, unacknowledged = status.totals["segments"], status.queue_depth
                assert held.get(life, 0) >= sent - unacknowledged, f"segments of {life} were lost"


class DistributedRun(WatchedRun):
    """The processes of one run, and what they said of themselves."""

    def __init__(self, owner: Owner, run_dir: Path, scenario: str = "cuboid", seed: int = 1) -> None:
        self.router = owner.router()
        self.running: dict[str, Process] = {}
        self._owner = owner
        text = (ROOT / "scenarios" / f"{scenario}.toml").read_text()
        (run_dir / "config.toml").write_text(f"seed = {seed}\n{text}")
        (run_dir / "run.json").write_text(json.dumps({"run": RUN}))
        super().__init__(RUN, run_dir, self.router.endpoint)

    def start(self, name: str) -> Process:
        """Start a service; actors are named actor-0, actor-1..."""
        service, _, index = name.partition("-")
        arguments = ["--run-dir", str(self.run_dir), "--connect", self.router.endpoint]
        numbered = ["--index", index] if index else []
        process = self._owner.start_service(service, *arguments, *numbered)
        self.running[name] = process
        return process

    def start_all(self, actors: int) -> None:
        """The coordinator, both learners and the actors."""
        for name in ("coordinator", *LEARNERS, *(f"actor-{index}" for index in range(actors))):
            self.start(name)

    def kill(self, name: str) -> None:
        """kill -9."""
        self.running.pop(name).kill()

    def end(self) -> None:
        """Wait until all have ended by themselves with code 0."""
        for name, process in self.running.items():
            assert process.ended(RUN_SECS) == 0, f"{name}: {process.report()}"
        self.close()
