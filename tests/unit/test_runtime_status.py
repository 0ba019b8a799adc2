"""The heart beats at its interval, at once when urged, and says what the service knows."""

import json
import subprocess
import sys

from protocol import keys
from protocol.codec import decode
from protocol.messages import Phase, Status
from protocol.refusal import Reason
from services.runtime.bus import Frame, Inbox
from services.runtime.memory_bus import MemoryBus
from services.runtime.status import Heart


class Listener:
    def __init__(self) -> None:
        hub = MemoryBus()
        self.heart = Heart(
            hub.connect("actor-1"), run="r", service="actor", life="actor-1", interval_secs=1.0
        )
        self._inbox = Inbox()
        hub.connect("coordinator").subscribe("status", keys.status("r", "actor", "actor-1"), self._inbox)

    def heard(self) -> list[Status]:
        statuses = [decode(arrival.data) for arrival in self._inbox.take_all() if isinstance(arrival, Frame)]
        assert all(isinstance(status, Status) for status in statuses)
        return [status for status in statuses if isinstance(status, Status)]


def test_it_beats_at_once_then_at_the_interval() -> None:
    listener = Listener()
    delays = [listener.heart.poll(now_secs, dict) for now_secs in (100.0, 100.4, 100.9, 101.0, 101.5, 102.2)]
    assert [status.seq for status in listener.heard()] == [0, 1, 2]
    assert [round(delay, 3) for delay in delays] == [1.0, 0.6, 0.1, 1.0, 0.5, 1.0]


def test_an_urgent_word_does_not_wait() -> None:
    listener = Listener()
    listener.heart.poll(100.0, dict)
    listener.heart.poll(100.001, dict, urgent=True)
    listener.heart.urge()
    listener.heart.poll(100.002, dict)
    listener.heart.poll(100.003, dict)
    assert [status.seq for status in listener.heard()] == [0, 1, 2]


def test_a_new_term_is_said_at_once() -> None:
    listener = Listener()
    listener.heart.poll(100.0, dict)
    listener.heart.enter(7, Phase.WALK)
    listener.heart.poll(100.1, dict)
    assert [(status.term, status.phase) for status in listener.heard()] == [(0, None), (7, Phase.WALK)]


def test_it_adds_its_own_counts_and_measurements_to_what_the_service_says() -> None:
    listener = Listener()
    heart = listener.heart
    heart.count("env_steps", 128)
    heart.count("env_steps")
    heart.refuse(Reason.STALE, "an old segment")
    heart.poll(
        1.0,
        lambda: {
            "totals": {"segments": 3},
            "refused": {Reason.STALE: 2, Reason.MALFORMED: 1},
            "metrics": {"loss": 0.5},
            "waiting_for": "w" * 3000,
            "queue_depth": 4,
        },
    )
    (status,) = listener.heard()
    assert status.totals == {"env_steps": 129, "segments": 3}
    assert status.refused == {"stale": 3, "malformed": 1}
    assert status.metrics["loss"] == 0.5
    assert status.metrics["rss_mb"] > 5
    assert status.metrics["cpu_secs"] > 0
    assert status.last_error == "an old segment"
    assert status.waiting_for == "w" * 2000
    assert (status.service, status.life, status.queue_depth) == ("actor", "actor-1", 4)


def test_building_is_left_until_it_is_time() -> None:
    listener, built = Listener(), []
    for now_secs in (0.0, 0.1, 0.2):
        listener.heart.poll(now_secs, lambda: built.append(1) or {})  # type: ignore[func-returns-value]
    assert len(built) == 1


def test_the_process_measures_itself() -> None:
    # In a process of its own: this one has memory that earlier tests gave back.
    program = (
        "import json; from services.runtime.status import process_metrics; before = process_metrics(); "
        "ballast = b'x' * 200_000_000; print(json.dumps([before, process_metrics()]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, timeout=60, check=True
    )
    before, after = json.loads(done.stdout)
    assert after["rss_mb"] - before["rss_mb"] > 150
    assert after["cpu_secs"] >= before["cpu_secs"] > 0
