"""What an actor shows: how often, of whom, how far back; and that nothing it cannot show ends it."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import services.actor.views
from babble.worlds.showing import Pose
from protocol import keys
from protocol.gate import Gate
from protocol.messages import View
from services.actor.views import Views
from services.runtime.bus import Frame, Inbox, Wakeup
from services.runtime.clock import HandClock
from services.runtime.errors import BusError
from services.runtime.memory_bus import MemoryBus
from services.runtime.process import Context
from services.runtime.settings import parse

RUN, COLUMNS = "shown", 20


class Drawn:
    """A body with one eye, of which every picture can be told by the step it was taken at."""

    def __init__(self, world: "Line") -> None:
        self.world = world

    def pose(self) -> Pose | None:
        step = float(self.world.steps)
        return Pose(np.full((3, 3), step, "<f4"), np.zeros((3, 4), "<f4"), np.ones(7, "<f4"))

    def images(self, observation: np.ndarray) -> dict[str, np.ndarray]:
        return {"left eye": np.full((2, 2, 3), observation[0, 0], np.uint8)}


class Bodiless(Drawn):
    """A world of which nothing can be seen."""

    def pose(self) -> Pose | None:
        return None

    def images(self, observation: np.ndarray) -> dict[str, np.ndarray]:
        return {}


class Line:
    """Columns that go on by 1 in each step, each a thousand apart."""

    columns = COLUMNS

    def __init__(self) -> None:
        self.steps = 0

    def posture(self) -> np.ndarray:
        return (self.steps + 1000 * np.arange(COLUMNS, dtype=np.float32))[:, None]


class Showing:
    """An actor's views, its steps as long as the test says, and all that was heard of it."""

    def __init__(self, index: int = 0, **view: Any) -> None:
        hub, self.clock = MemoryBus(), HandClock(1_000.0)
        self.inbox = Inbox(max_frames=100_000)
        hub.connect("dashboard").subscribe("view", keys.view(RUN, "*", "*"), self.inbox)
        self.gate = Gate(RUN, {"view"})
        self.world = Line()
        self.context = Context(
            bus=hub.connect("actor-1"),
            clock=self.clock,
            settings=parse({"scenario": "shown", "view": view}, origin="test"),
            run=RUN,
            run_dir=Path(),
            life="actor-1",
            wakeup=Wakeup(),
            index=index,
        )
        self.views = Views(self.context, self.world)  # type: ignore[arg-type]
        self.heard: list[tuple[float, View]] = []

    def enter(self, term: int) -> None:
        self.views.enter(term, self.world)  # type: ignore[arg-type]

    def step(self, secs: float, blocks: tuple[str, ...] = ("body",), acts: bool = True) -> None:
        """One turn of the actor's loop; the latent tells the step, and the goal its negative."""
        if self.clock.now_secs() >= self.views.quiet_secs:
            self.views.turn(self.clock.now_secs(), self.world.steps * COLUMNS)
        self._hear()
        if acts:
            if self.views.looking:
                latent = np.repeat(self.world.posture(), 2, axis=1)
                self.views.see(
                    np.full((COLUMNS, 1), self.world.steps % 256, np.float32),
                    {block: (latent, -latent) for block in blocks} or {"body": None},
                )
            self._hear()
            self.world.steps += 1
        self.clock.advance(secs)

    def run(self, secs: float, step_secs: float, **how: Any) -> "Showing":
        for _ in range(round(secs / step_secs)):
            self.step(step_secs, **how)
        return self

    def of(self, view: str) -> list[View]:
        return [message for _, message in self.heard if message.view == view]

    def times(self, view: str) -> np.ndarray:
        return np.array([secs for secs, message in self.heard if message.view == view])

    def _hear(self) -> None:
        for arrival in self.inbox.take_all():
            assert isinstance(arrival, Frame)
            message = self.gate.admit(arrival.key, arrival.data)
            assert isinstance(message, View), self.gate.last_refusal
            self.heard.append((self.clock.now_secs(), message))


@pytest.fixture(autouse=True)
def drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services.actor.views, "shown", Drawn)


@pytest.mark.parametrize("step_secs", [0.0002, 0.004, 0.03])
def test_each_picture_comes_at_its_rate_however_fast_the_steps_are(step_secs: float) -> None:
    showing = Showing(latents_per_sec=5, poses_per_sec=10, images_per_sec=2).run(6, step_secs)
    for view, per_sec in (("latent", 5), ("pose", 10), ("image", 2)):
        times = showing.times(view)
        assert len(times) == pytest.approx(6 * per_sec, abs=2), view
        assert np.max(np.diff(times)) < 1 / per_sec + max(step_secs, 70 * 0.0002) + 1e-6, view


def test_of_a_body_slower_than_the_rates_each_step_is_shown_as_it_is_done() -> None:
    showing = Showing().run(9, 0.3)
    assert [pose.env_step for pose in showing.of("pose")] == list(range(30))
    assert [latent.env_step for latent in showing.of("latent")] == list(range(30))
    np.testing.assert_allclose(showing.times("pose"), 1000 + 0.3 * np.arange(30))


def test_at_rate_0_nothing_is_shown_and_no_step_is_looked_at() -> None:
    showing = Showing(latents_per_sec=0, poses_per_sec=0, images_per_sec=0)
    for _ in range(200):
        showing.step(0.05)
        assert not showing.views.looking
    assert showing.heard == []


@pytest.mark.parametrize("silent", ["latent", "pose", "image"])
def test_one_rate_of_0_leaves_the_other_pictures(silent: str) -> None:
    showing = Showing(**{f"{silent}s_per_sec": 0}).run(2, 0.01)
    assert {message.view for _, message in showing.heard} == {"latent", "pose", "image"} - {silent}


@pytest.mark.parametrize(("index", "shown_actors"), [(1, 1), (0, 0), (7, 3)])
def test_actors_beyond_the_shown_ones_send_latents_alone(index: int, shown_actors: int) -> None:
    showing = Showing(index, shown_actors=shown_actors).run(3, 0.01)
    assert {message.view for _, message in showing.heard} == {"latent"}


def test_of_a_fast_body_few_steps_are_looked_at() -> None:
    showing, looked = Showing(), 0
    for _ in range(20_000):
        showing.step(0.0002)
        looked += showing.views.looking
    assert showing.of("latent")
    assert looked < 0.2 * 20_000


def test_poses_play_as_clips_of_consecutive_steps() -> None:
    showing = Showing(poses_per_sec=10).run(3, 0.002)
    steps = [pose.env_step for pose in showing.of("pose")]
    clips = [steps[first : first + 10] for first in range(0, 30, 10)]
    for clip in clips:
        assert clip == list(range(clip[0], clip[0] + 10)), "no step is left out"
    assert clips[1][0] == pytest.approx(500, abs=10), "a second later the newest steps are shown"
    for pose in showing.of("pose"):
        assert pose.arrays["position"][0, 0] == pose.env_step, "the pose is that of its step"


def test_a_clip_goes_on_while_the_actor_waits_and_ends_with_its_term() -> None:
    showing = Showing(poses_per_sec=10).run(0.5, 0.002).run(0.2, 0.02, acts=False)
    assert len(showing.of("pose")) in (7, 8)
    showing.enter(2)
    showing.run(1, 0.02, acts=False)
    assert len(showing.of("pose")) in (7, 8), "what was done in another phase is not shown as of this one"
    showing.run(0.5, 0.002)
    assert showing.of("pose")[-1].term == 2


def test_a_latent_view_has_the_newest_step_of_some_columns_and_the_way_of_the_first() -> None:
    for view in Showing(columns=16, trail_steps=60).run(2, 0.001).of("latent")[1:]:
        newest = view.env_step
        np.testing.assert_array_equal(view.arrays["latent"][:, 0], newest + 1000 * np.arange(16))
        np.testing.assert_array_equal(view.arrays["goal"], -view.arrays["latent"])
        np.testing.assert_array_equal(view.arrays["posture"][:, 0], view.arrays["latent"][:, 0])
        way = np.arange(newest - 59, newest + 1)
        np.testing.assert_array_equal(view.arrays["trail"], np.stack([way, way], axis=1))
        np.testing.assert_array_equal(view.arrays["path"][:, 0], way)


def test_within_a_step_of_a_level_each_step_of_the_body_is_numbered_and_shown_in_time() -> None:
    showing = Showing(poses_per_sec=10)
    showing.step(0.0, acts=False)
    for _ in range(90):
        latent = np.zeros((COLUMNS, 2), np.float32)
        if showing.views.looking:
            showing.views.see(np.zeros((COLUMNS, 1), np.float32), {"body": (latent, latent)})
        showing.world.steps += 1
        showing.clock.advance(0.03)
        showing.views.passed()
    showing.step(0.0, acts=False)
    times = [view.env_step for view in showing.of("latent")]
    assert len(times) == pytest.approx(2.7 * 5, abs=3)
    assert times == sorted(set(times)), "no two pictures are of one step"
    steps = [pose.env_step for pose in showing.of("pose")]
    assert len(steps) == pytest.approx(27, abs=3)
    assert [pose.arrays["position"][0, 0] for pose in showing.of("pose")] == steps


def test_where_only_limbs_act_on_latents_the_body_is_shown_all_the_same() -> None:
    showing = Showing()
    showing.views.enter(1, showing.world, ["finger"])  # type: ignore[arg-type]
    showing.run(1, 0.01, blocks=("finger",))
    assert showing.of("posture"), "as the block above babbles, it has no latent"
    assert all("posture" not in view.arrays for view in showing.of("latent"))


def test_each_block_has_a_view_of_its_own() -> None:
    showing = Showing().run(1, 0.01, blocks=("along", "across"))
    blocks = [view.block for view in showing.of("latent")]
    assert blocks == ["along", "across"] * (len(blocks) // 2)
    assert len(blocks) == 10


def test_where_there_is_no_latent_postures_are_shown() -> None:
    showing = Showing(columns=3, poses_per_sec=0).run(2, 0.01, blocks=())
    assert showing.of("latent") == []
    assert len(showing.of("posture")) == 10
    last = showing.of("posture")[-1]
    assert (last.block, last.arrays["posture"].shape) == ("all", (3, 1))
    assert last.arrays["path"][-1] == last.arrays["posture"][0]


@pytest.mark.parametrize("step_secs", [0.0005, 0.05])
def test_a_trail_never_leads_across_a_cut_nor_from_one_term_to_the_next(step_secs: float) -> None:
    showing = Showing(trail_steps=60)
    cuts = [0]
    for step in range(round(5 / step_secs)):
        if step % 37 == 0:
            cuts.append(step)
            if step % 74 == 0:
                showing.enter(step)
            else:
                showing.views.cut()
        showing.step(step_secs)
    views = showing.of("latent")
    assert len(views) >= 20
    for view in views:
        began = max(cut for cut in cuts if cut <= view.env_step)
        assert view.arrays["trail"][:, 0].min() >= began
        assert view.arrays["trail"][-1, 0] == view.env_step
    assert max(len(view.arrays["trail"]) for view in views) > 20


def test_of_a_world_without_a_body_there_is_neither_pose_nor_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services.actor.views, "shown", Bodiless)
    showing, looked = Showing(latents_per_sec=0), 0
    for _ in range(3000):
        showing.step(0.001)
        looked += showing.views.looking
    assert showing.heard == []
    assert showing.views.unshown == 0
    assert looked < 50, "asking again is rare"


def fails(*_: Any) -> Any:
    raise RuntimeError("no renderer")


@pytest.mark.parametrize(("method", "lost", "per_sec"), [("pose", "pose", 10), ("images", "image", 2)])
def test_what_cannot_be_drawn_is_counted_and_the_rest_goes_on(
    monkeypatch: pytest.MonkeyPatch, method: str, lost: str, per_sec: int
) -> None:
    monkeypatch.setattr(Drawn, method, fails)
    showing = Showing().run(3, 0.01)
    assert {message.view for _, message in showing.heard} == {"latent", "pose", "image"} - {lost}
    assert showing.views.unshown == pytest.approx(3 * per_sec, abs=1)
    assert showing.views.last_error == f"a view ({lost}) could not be shown: no renderer"


def test_a_body_that_cannot_be_drawn_at_all_is_tried_once(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(services.actor.views, "shown", fails)
    showing = Showing().run(3, 0.01)
    assert {message.view for _, message in showing.heard} == {"latent"}
    assert showing.views.unshown == 1


def test_a_view_too_large_for_a_frame_is_counted_and_the_smaller_ones_are_sent(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("protocol.codec.MAX_FRAME_BYTES", 400)
    showing = Showing().run(3, 0.01)
    assert {message.view for _, message in showing.heard} == {"pose", "image"}
    assert showing.views.unshown == pytest.approx(15, abs=1)
    assert "400" in showing.views.last_error


def test_a_bus_that_refuses_a_view_does_not_end_the_actor(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(kind: str, key: str, frame: bytes) -> None:
        raise BusError("the connection is closed")

    showing = Showing()
    monkeypatch.setattr(showing.context.bus, "publish", refuse)
    showing.run(3, 0.01)
    assert showing.heard == []
    assert showing.views.unshown > 30
