"""What a run says on its bus, heard by a container of the test's own in the networks of the run."""

import json
import time
from dataclasses import dataclass

from tests.compose.projects import Project
from tests.processes.owned import Process, wait_for

# Prints a line for each segment and each status: when (the machine's monotonic clock), the key, totals.
LISTEN = """
import json, os, sys, time
from pathlib import Path
from protocol import keys
from protocol.codec import decode
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.credentials import read_credential
from services.runtime.zenoh_bus import ZenohBus
given = os.environ.get("BABBLE_CREDENTIAL")
wakeup = Wakeup()
credential = read_credential(Path(given)) if given else None
bus = ZenohBus(os.environ["BABBLE_CONNECT"], "launcher-0", wakeup, 20.0, credential)
inbox = Inbox(wakeup, max_frames=100_000)
if credential is None:
    bus.subscribe("segment", keys.segment(sys.argv[1], "*", "*", "*"), inbox)
bus.subscribe("status", keys.status(sys.argv[1], "*", "*"), inbox)
print("listening", flush=True)
while True:
    wakeup.wait(1.0)
    for frame in inbox.take_all():
        if isinstance(frame, Frame):
            totals = decode(frame.data).totals if "/status/" in frame.key else {}
            print(json.dumps([time.monotonic(), frame.key, totals]), flush=True)
"""


@dataclass(frozen=True)
class Word:
    """One message that was heard."""

    secs: float
    """by time.monotonic, which all containers of a machine share"""
    kind: str
    life: str
    totals: dict[str, int]


class Ears:
    """Hears a run from now on."""

    def __init__(self, project: Project, run: str) -> None:
        command = ("run", "--rm", "--no-deps", "-T", "--entrypoint", "python", "babble", "-c", LISTEN, run)
        self._process: Process = project.start("--profile", "tools", *command)
        self._process.expect("listening", 60.0)

    def words(self) -> list[Word]:
        """All that was heard so far."""
        found = []
        for line in list(self._process.out):
            if line.startswith("["):
                secs, key, totals = json.loads(line)
                _, _, kind, *_, life = key.split("/")
                found.append(Word(secs, kind, life, totals))
        return found

    def segments(self) -> dict[str, float]:
        """Life -> when its first segment was published."""
        first: dict[str, float] = {}
        for word in self.words():
            if word.kind == "segment":
                first.setdefault(word.life, word.secs)
        return first

    def actors(self, lately_secs: float) -> set[str]:
        """The lives of actors that have said something lately."""
        since_secs = time.monotonic() - lately_secs
        return {
            word.life for word in self.words() if word.life.startswith("actor-") and word.secs >= since_secs
        }

    def wait_for_steps(self, life: str, within_secs: float) -> None:
        """Until an actor has published another segment than it had."""
        before = max(
            (word.totals.get("segments", 0) for word in self.words() if word.life == life), default=0
        )

        def more() -> bool:
            return any(w.life == life and w.totals.get("segments", 0) > before for w in self.words())

        wait_for(f"a segment of {life}", more, within_secs)
