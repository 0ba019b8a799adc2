"""The dashboard as a process on a real router, seen by a real viewer that joins late."""

import json
import re
import threading
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from rerun.experimental import ViewerClient

from protocol import keys
from protocol.codec import decode, encode
from protocol.messages import Phase, Status
from services.dashboard.colours import of_index
from services.dashboard.config import created_secs
from services.dashboard.viewer_files import quiet_environment, rerun_program
from services.launcher.run_folder import config_text
from services.runtime.bus import Frame, Inbox
from services.runtime.settings import RunSettings
from services.runtime.zenoh_bus import ZenohBus
from tests.processes.owned import Owner, Process, RunningRouter, free_port, wait_for
from tests.unit.dashboard_feed import RUN, Feed, announced, key_of, settings_of
from tests.unit.dashboard_reading import parts_of, states
from tests.unit.dashboard_trees import HAND, tree_settings

pytestmark = pytest.mark.processes

DRIVERS = ("/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d")
CREATED_AGO_SECS = 60.0
BUSY_SECS = 60.0
"""So long may a step take on a busy machine."""
HISTORY_VIEWS = 40
"""views of each block that are drawn before the viewer joins"""
SHOT_PX = 960
"""longest side of the screenshot"""


class Play:
    """Says over the bus what a run's processes would, five times a second, until it is told to stop."""

    def __init__(self, bus: ZenohBus, feed: Feed) -> None:
        self._bus, self._feed = bus, feed
        self._stopping = threading.Event()
        self._thread = threading.Thread(target=self._play, daemon=True)
        self.phase, self.term = Phase.WALK, 5
        for service, life in feed.lives:
            bus.announce(keys.alive(RUN, service, life))
        self._heard, self._drawn = Inbox(), 0
        bus.subscribe("status", keys.status(RUN, "dashboard", "*"), self._heard)
        self._thread.start()

    def drawn(self) -> int:
        """How many views the dashboard says that it has drawn."""
        for arrival in self._heard.take_all():
            if isinstance(arrival, Frame) and isinstance(status := decode(arrival.data), Status):
                self._drawn = status.totals["views"]
        return self._drawn

    def stop(self) -> None:
        """End it."""
        self._stopping.set()
        self._thread.join(10.0)

    def _play(self) -> None:
        turn = 0
        while not self._stopping.wait(0.2):
            messages = list(self._feed.views()) if self.phase is not Phase.DONE else []
            if turn % 5 == 0:
                messages += self._feed.statuses(self.phase, self.term)
                messages.append(announced(self.phase, self.term, iteration=1))
            for message in messages:
                kind, key = key_of(message)
                self._bus.publish(kind, key, encode(message))
            turn += 1


@pytest.fixture
def viewer(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[ViewerClient]:
    """A native viewer without a window, which sends nothing to anybody."""
    if not any(Path(folder).glob("*.json") for folder in DRIVERS):
        pytest.skip("no Vulkan driver for a viewer without a window; install mesa-vulkan-drivers")
    for name, value in quiet_environment(tmp_path).items():
        monkeypatch.setenv(name, value)
    with ViewerClient.spawn(
        headless=True, port=free_port(), hide_welcome_screen=True, executable_path=str(rerun_program())
    ) as client:
        yield client


SHOWN = {
    "one block": (settings_of(3), "/latent/block/now"),
    "a tree": (tree_settings(HAND, hand=3), "/goals/tree/discs"),
}
"""Runs with a block of three vertices, and what is seen of them at first."""


@pytest.fixture(params=SHOWN)
def shown(request: pytest.FixtureRequest) -> tuple[RunSettings, str]:
    """A run's settings, and an entity of its first tab."""
    return SHOWN[request.param]


@pytest.fixture
def play(connect: Callable[[str], ZenohBus], shown: tuple[RunSettings, str]) -> Iterator[Play]:
    """A run of three actors."""
    playing = Play(connect("everybody"), Feed(shown[0], actors=3))
    yield playing
    playing.stop()


def run_folder(path: Path, settings: RunSettings) -> Path:
    """A run's folder, made a minute ago."""
    path.mkdir()
    created = datetime.now(UTC) - timedelta(seconds=CREATED_AGO_SECS)
    (path / "run.json").write_text(json.dumps({"run": RUN, "created": created.isoformat()}))
    (path / "config.toml").write_text(config_text(settings))
    return path


def line_of(process: Process, pattern: str) -> re.Match[str]:
    """The first match in what a process logged."""
    compiled = re.compile(pattern)

    def look() -> re.Match[str] | None:
        assert process.running(), process.report()
        return next((found for line in list(process.err) if (found := compiled.search(line))), None)

    return wait_for(f"{pattern!r} from {process.name}", look, BUSY_SECS)


def run_secs(folder: Path) -> float:
    """The run's time now."""
    return time.time() - created_secs(folder)


def end_secs(viewer: ViewerClient) -> float:
    """Until when the viewer has data on the run's time; 0 before there is any."""
    timelines = [line for recording in viewer.get_state().recordings for line in recording.timelines]
    return max((line.end or 0) / 1e9 for line in timelines if line.name == "run_time") if timelines else 0.0


def entities_in(viewer: ViewerClient, store_id: str) -> set[str]:
    """The paths that the viewer has of a recording."""
    return {entity.entity_path for entity in viewer.get_recording_schema(store_id, paths_only=True).entities}


def test_a_viewer_that_joins_late_sees_history_and_what_is_new(
    owner: Owner,
    router: RunningRouter,
    play: Play,
    shown: tuple[RunSettings, str],
    tmp_path: Path,
    viewer: ViewerClient,
) -> None:
    settings, entity = shown
    folder = run_folder(tmp_path / "run", settings)
    port = free_port()
    dashboard = owner.start_service(
        *("dashboard", "--run-dir", str(folder), "--connect", router.endpoint),
        *("--web-port", "0", "--grpc-port", str(port)),
    )
    line_of(dashboard, r"the dashboard is at (http://127\.0\.0\.1:\d+)")
    line_of(dashboard, "ready in run")
    wait_for("some history", lambda: play.drawn() >= HISTORY_VIEWS * len(settings.block), BUSY_SECS)
    joined_secs = run_secs(folder)
    viewer.open(f"rerun+http://127.0.0.1:{port}/proxy")
    wait_for("rows newer than its joining", lambda: end_secs(viewer) > joined_secs + 1.0, BUSY_SECS)

    (recording,) = viewer.get_state().recordings
    assert recording.store_id == f"Recording:babble:{RUN}"
    (run_time,) = [line for line in recording.timelines if line.name == "run_time"]
    assert run_time.start is not None
    assert CREATED_AGO_SECS < run_time.start / 1e9 < joined_secs - 1.0, "what was before is there too"
    assert recording.current_timeline == "run_time"
    expected = {entity, "/state/phase", "/members/a2", "/system/steps_per_sec/a0"}
    wait_for("entities", lambda: expected <= entities_in(viewer, recording.store_id), BUSY_SECS)
    views = viewer.get_state().views
    assert len(views) > 20
    assert [view.reports for view in views if view.reports] == []
    assert [entry.message for entry in viewer.get_logs() if entry.level == "ERROR"] == []
    (tmp_path / "shot.png").write_bytes(viewer.take_screenshot(max_size=SHOT_PX))
    pixels = np.asarray(Image.open(tmp_path / "shot.png").convert("RGB"), np.int64)
    for vertex in range(3):
        colour = [(of_index(vertex) >> shift) & 0xFF for shift in (24, 16, 8)]
        near = np.abs(pixels - colour).max(axis=2) < 40
        assert near.sum() > 20, f"nothing is painted in the colour of vertex {vertex}"

    play.phase, play.term = Phase.DONE, 6
    assert dashboard.ended(BUSY_SECS) == 0
    assert states(parts_of(folder), "/state/phase") == ["walk 1", "done"]
