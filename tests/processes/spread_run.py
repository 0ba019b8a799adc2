"""A whole run over several hosts behind TLS: router, coordinator and learners at home, actors elsewhere."""

import json
import sys
from pathlib import Path

from protocol.messages import Status
from services.launcher.certs_folder import CertsFolder
from tests.processes.distributed import LEARNERS, RUN_SECS, WatchedRun
from tests.processes.namespaces import Host
from tests.processes.owned import Owner, Process, wait_for

RUN = "spread"
PORT = 7447
SCENARIO = """
scenario = "spread"
[actors]
envs_per_actor = 2
[phases]
babble_steps = 500000
ground_steps = 8192
walk_steps = 4096
practise_steps = 4096
iterations = 1
[encoder.encode]
updates = 100
[encoder.refine]
updates = 50
[wire]
status_secs = 0.2
"""
"""BABBLE takes some 10 s of two actors, time enough for what a test does to them; the rest is short."""
EARS = """
import json, sys, time
from pathlib import Path
from protocol import keys
from protocol.codec import decode
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.credentials import read_credential
from services.runtime.zenoh_bus import ZenohBus
endpoint, run, credential = sys.argv[1:]
wakeup = Wakeup()
bus = ZenohBus(endpoint, "launcher-0", wakeup, 10.0, read_credential(Path(credential)))
inbox = Inbox(wakeup, max_frames=keys.DELIVERY["status"].keep)
bus.subscribe("status", keys.status(run, "*", "*"), inbox)
print("listening")
while True:
    wakeup.wait(1.0)
    for arrival in inbox.take_all():
        if isinstance(arrival, Frame):
            print(json.dumps([time.monotonic(), decode(arrival.data).model_dump(mode="json")]))
"""
"""The test itself has no way into a namespace, so a process there hears for it."""


class SpreadRun(WatchedRun):
    """A run whose actors are on hosts that have nothing of it but a credential; `home` has its folder."""

    def __init__(self, owner: Owner, folder: Path, home: Host, hosts: list[Host]) -> None:
        self.run_dir = folder / "run"
        self.run_dir.mkdir()
        (self.run_dir / "config.toml").write_text(SCENARIO)
        (self.run_dir / "run.json").write_text(json.dumps({"run": RUN}))
        self.home = home
        self.endpoint = f"tls/{home.address}:{PORT}"
        self.running: dict[str, Process] = {}
        self.heard_secs: dict[str, float] = {}
        """When each life was last heard at home, by time.monotonic."""
        self._statuses: dict[str, Status] = {}
        self._read_lines = 1
        self._owner = owner
        self._certs = CertsFolder.create(folder / "certs", [home.address])
        for host in hosts:
            self._certs.add(host.name)
        self.router = self.start_router()
        ears = (EARS, self.endpoint, RUN, str(self._certs.path_of("launcher")))
        self._ears = home.start(owner, "ears", sys.executable, "-c", *ears)
        self._ears.expect("listening")
        for service in ("coordinator", *LEARNERS):
            self._start(service)

    def close(self) -> None:
        """Nothing of the test's own process is connected; the owner ends the ears."""

    def start_router(self) -> Process:
        """A router at home, ready."""
        arguments = ("--listen", self.endpoint, *self._shown("router"))
        router = self.home.start_service(self._owner, "router", *arguments)
        router.expect("ready")
        return router

    def join(self, host: Host, name: str) -> Process:
        """An actor on a host, under a name for the test."""
        shown = self._shown(f"actor.{host.name}")
        arguments = ("--run", RUN, "--connect", self.endpoint, *shown)
        self.running[name] = host.start_service(self._owner, "actor", *arguments)
        return self.running[name]

    def kill(self, name: str) -> None:
        """kill -9."""
        self.running.pop(name).kill()

    def statuses(self) -> dict[str, Status]:
        """The newest status of every life heard of."""
        lines = self._ears.out[self._read_lines :]
        self._read_lines += len(lines)
        for line in lines:
            at_secs, fields = json.loads(line)
            status = Status.model_validate_json(json.dumps(fields))
            self._statuses[status.life] = status
            self.heard_secs[status.life] = at_secs
        return self._statuses

    def actors(self, host: Host) -> dict[str, Status]:
        """The newest status of each actor of a host, dead or alive."""
        beginning = f"actor-{host.name}-"
        return {life: status for life, status in self.statuses().items() if life.startswith(beginning)}

    def sent(self, host: Host) -> int:
        """Segments that the actors of a host have sent, in total."""
        return sum(status.totals["segments"] for status in self.actors(host).values())

    def at_work(self, host: Host) -> int:
        """How many actors of a host, dead or alive, have sent something."""
        return sum(status.totals["segments"] > 0 for status in self.actors(host).values())

    def received(self) -> int:
        """Segments that the learners have taken, in total."""
        found = self.statuses().values()
        return sum(status.totals["segments"] for status in found if status.service in LEARNERS)

    def wait_for_segments(self, more: int) -> None:
        """Until the learners have taken so many more."""
        before = self.received()
        wait_for(f"{more} more segments", lambda: self.received() >= before + more, RUN_SECS)

    def end(self) -> None:
        """Wait until all have ended by themselves with code 0."""
        for name, process in self.running.items():
            assert process.ended(RUN_SECS) == 0, f"{name}: {process.report()}"
        self.statuses()

    def assert_all_explained(self) -> None:
        """Each segment that was sent was learned from once; what came twice was known to be sent twice."""
        self.assert_nothing_lost_or_counted_twice()
        statuses = self.statuses().values()
        resent = sum(status.totals["resent"] for status in statuses if status.service == "actor")
        assert sum(status.duplicated for status in statuses) <= resent
        assert sum(status.lost for status in statuses) == 0

    def _start(self, service: str) -> None:
        arguments = ("--run-dir", str(self.run_dir), "--connect", self.endpoint, *self._shown(service))
        self.running[service] = self.home.start_service(self._owner, service, *arguments)

    def _shown(self, identity: str) -> tuple[str, str]:
        return "--credential", str(self._certs.path_of(identity))
