"""The Body panel, read back from the file that it was recorded to."""

from collections.abc import Callable, Iterator
from pathlib import Path

import mujoco
import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb
from rerun.chunk import RrdReader

from babble import worlds
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.showing import Pose, shown
from protocol.messages import View
from services.dashboard.body import REASON, BodyPanel, eye_path
from services.dashboard.body_points import MOST_REACHED
from services.dashboard.canvas import Canvas
from services.dashboard.colours import GREY, of_index
from services.runtime.settings import RunSettings, parse

STANDING = ("MimoStandUp", {"senses": ["position", "vision"], "vision": {"resolution": 16}})


@pytest.fixture(autouse=True)
def _mistakes_are_errors() -> Iterator[None]:
    rr.set_strict_mode(True)
    yield
    rr.set_strict_mode(False)


def settings(id: str, parameters: dict[str, object] | None = None, latent_dim: int = 3) -> RunSettings:
    table = {
        "scenario": "test",
        "world": {"id": id, "parameters": parameters or {}},
        "block": [{"name": "body", "latent_dim": latent_dim}],
    }
    return parse(table, origin="the test")


def view(kind: str, arrays: dict[str, object], *, life: str = "a0", **fields: object) -> View:
    given = {name: np.asarray(array) for name, array in arrays.items()}
    header = {"run": "run", "term": 1, "block": "all", "life": life, "seq": 0, "view": kind, **fields}
    return View.model_validate({**header, "arrays": given})


def floats(values: object) -> np.ndarray:
    return np.asarray(values, np.float32)


class Recording:
    """Streams to two files, live and thin, and what is read back from them."""

    def __init__(self, folder: Path) -> None:
        self.paths = [folder / "live.rrd", folder / "file.rrd"]
        self._streams = [rr.RecordingStream("babble", recording_id="run") for _ in self.paths]
        for stream, path in zip(self._streams, self.paths, strict=True):
            stream.save(path)
        self.canvas = Canvas(*self._streams)

    def at(self, secs: float) -> Canvas:
        for stream in self._streams:
            stream.set_time("run_time", duration=secs)
        return self.canvas

    def close(self) -> None:
        for stream in self._streams:
            stream.disconnect()
        self._streams.clear()

    def rows(self, entity: str, component: str, *, static: bool = False, file: bool = False) -> list[object]:
        """The values of a component at an entity, row after row."""
        found = []
        for chunk in RrdReader(str(self.paths[file])).stream().to_chunks():
            if chunk.entity_path == entity and chunk.is_static == static:
                batch = chunk.to_record_batch()
                if component in batch.schema.names:
                    times = range(batch.num_rows) if static else batch.column("run_time").to_pylist()
                    found += list(zip(times, batch.column(component).to_pylist(), strict=True))
        return [value for _, value in sorted(found, key=lambda row: row[0])]

    def entities(self) -> set[str]:
        return {chunk.entity_path for chunk in RrdReader(str(self.paths[0])).stream().to_chunks()}


@pytest.fixture
def recording(tmp_path: Path) -> Recording:
    return Recording(tmp_path)


def body(id: str, parameters: dict[str, object] | None = None) -> tuple[MujocoWorld, Callable[[], Pose]]:
    """A world that moves, and what is seen of it after some steps more."""
    world = worlds.make(id, parameters or {}, 1, 3)
    assert isinstance(world, MujocoWorld)
    seen, rng = shown(world), np.random.default_rng(0)

    def step() -> Pose:
        for _ in range(3):
            world.copies[0].ctrl[:] = rng.uniform(-1, 1, world.blueprint.model.nu)
            mujoco.mj_step(world.blueprint.model, world.copies[0], 5)
        pose = seen.pose()
        assert pose is not None
        return pose

    mujoco.mj_forward(world.blueprint.model, world.copies[0])
    return world, step


def pose_view(pose: Pose, life: str = "a0", env_step: int = 0) -> View:
    arrays: dict[str, object] = {"position": pose.position, "quaternion": pose.quaternion}
    if pose.touch is not None:
        arrays["touch"] = pose.touch
    return view("pose", arrays, life=life, env_step=env_step)


def test_the_bodys_capsules_are_drawn_where_mujoco_has_them(recording: Recording) -> None:
    world, step = body("MimoHand")
    panel = BodyPanel(settings("MimoHand"))
    panel.begin(recording.at(0))
    pose = step()
    panel.hear_view(pose_view(pose), 1.0)
    panel.draw(recording.at(1.0), 1.0)
    recording.close()
    model, data = world.blueprint.model, world.copies[0]
    capsules = np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE)
    at_rest, moved = recording.rows("/body/capsules", "InstancePoses3D:translations")
    axis = data.geom_xmat[capsules].reshape(-1, 3, 3)[:, :, 2]
    lower_end = data.geom_xpos[capsules] - model.geom_size[capsules, 1:2] * axis
    np.testing.assert_allclose(moved, lower_end, atol=1e-6)
    assert not np.allclose(at_rest, lower_end, atol=1e-3)
    turned = np.array(recording.rows("/body/capsules", "InstancePoses3D:quaternions")[1])
    wanted = np.zeros((len(capsules), 4))
    for quaternion, matrix in zip(wanted, data.geom_xmat[capsules], strict=True):
        mujoco.mju_mat2Quat(quaternion, matrix)
    cosine = np.abs((turned[:, [3, 0, 1, 2]] * wanted).sum(axis=1))
    np.testing.assert_allclose(cosine, 1, atol=1e-6)
    (lengths,) = recording.rows("/body/capsules", "Capsules3D:lengths", static=True)
    np.testing.assert_allclose(lengths, 2 * model.geom_size[capsules, 1], rtol=1e-6)
    (radii,) = recording.rows("/body/capsules", "Capsules3D:radii", static=True)
    np.testing.assert_allclose(radii, model.geom_size[capsules, 0], rtol=1e-6)


def test_the_whole_body_is_there_before_anything_is_heard(recording: Recording) -> None:
    panel = BodyPanel(settings(*STANDING))
    panel.begin(recording.at(0))
    recording.close()
    shapes = {"/body/capsules", "/body/cylinders", "/body/boxes", "/body/ellipsoids"}
    assert shapes <= recording.entities()
    (caption,) = recording.rows("/body/caption", "Points3D:labels")
    assert caption == ["no pose was heard yet"]
    assert panel.reason == ""
    assert panel.eyes == ("left eye", "right eye")
    assert isinstance(panel.body_view("Body"), rrb.Spatial3DView)


def test_the_file_holds_few_poses_and_the_stream_all(recording: Recording) -> None:
    _, step = body("MimoHand")
    panel = BodyPanel(settings("MimoHand"))
    for tick in range(40):
        panel.hear_view(pose_view(step(), env_step=tick), tick / 10)
        panel.draw(recording.at(tick / 10), tick / 10)
        panel.draw(recording.at(tick / 10 + 0.05), tick / 10 + 0.05)
    recording.close()
    live = recording.rows("/body/capsules", "InstancePoses3D:translations")
    kept = recording.rows("/body/capsules", "InstancePoses3D:translations", file=True)
    assert len(live) == 40, "each pose once, and none where nothing was heard"
    assert 4 <= len(kept) <= 8
    assert recording.rows("/body/caption", "Points3D:labels")[-1] == ["a0, step 39"]


def test_touch_is_drawn_on_the_skin_brighter_and_larger_where_it_is_stronger(recording: Recording) -> None:
    world, step = body("MimoHand", {"contacts": True})
    panel = BodyPanel(settings("MimoHand", {"contacts": True}))
    pose = step()
    assert pose.touch is not None
    touch = np.zeros_like(pose.touch)
    touch[:3] = 0.5, 10.0, 500.0
    panel.hear_view(pose_view(Pose(pose.position, pose.quaternion, touch)), 0.0)
    panel.draw(recording.at(0), 0.0)
    recording.close()
    (places,) = recording.rows("/body/touch", "Points3D:positions")
    (colours,) = recording.rows("/body/touch", "Points3D:colors")
    (radii,) = recording.rows("/body/touch", "Points3D:radii")
    light = [sum((colour >> shift) & 0xFF for shift in (24, 16, 8)) for colour in colours]
    assert len(places) == 3, "what feels nothing is not drawn"
    assert light[0] < light[1] == light[2]
    assert radii[0] < radii[1] == radii[2]
    skin = shown(world).touch
    assert skin is not None
    patch = skin.patches[0]
    data = world.copies[0]
    exact = data.xpos[patch.body] + patch.points @ data.xmat[patch.body].reshape(3, 3).T
    off = np.linalg.norm(np.array(places) - exact[:3], axis=1)
    assert (off <= max(radii) + 1e-6).all(), "no farther from the skin than a dot is wide"


def test_one_actor_is_shown_until_it_is_silent(recording: Recording) -> None:
    _, step = body("MimoHand")
    panel = BodyPanel(settings("MimoHand"))
    for tick in range(60):
        now = tick / 10
        if now < 1:
            panel.hear_view(pose_view(step(), life="a0", env_step=tick), now)
        panel.hear_view(pose_view(step(), life="a1", env_step=tick), now)
        panel.draw(recording.at(now), now)
    recording.close()
    captions = [label[0] for label in recording.rows("/body/caption", "Points3D:labels")]
    lives = [caption.split(",")[0] for caption in captions]
    assert lives[:10] == ["a0"] * 10
    assert lives[10:] == ["a1"] * (len(lives) - 10)
    assert captions[10] == "a1, step 39", "three seconds after the last word of a0"


@pytest.mark.parametrize("what", ["bodies", "skin"])
def test_a_pose_of_another_body_is_said_and_not_drawn(recording: Recording, what: str) -> None:
    _, step = body("MimoHand")
    panel = BodyPanel(settings("MimoHand"))
    panel.begin(recording.at(0))
    pose = step()
    other = (
        Pose(pose.position[:-1], pose.quaternion[:-1], None)
        if what == "bodies"
        else Pose(pose.position, pose.quaternion, floats(np.zeros(10)))
    )
    panel.hear_view(pose_view(other), 1.0)
    panel.draw(recording.at(1.0), 1.0)
    assert "a0 shows" in panel.reason
    assert ("18 bodies" if what == "bodies" else "10 points") in panel.reason
    assert isinstance(panel.body_view("Body"), rrb.TextDocumentView)
    assert panel.ignored == 1
    sentence = panel.reason
    panel.hear_view(pose_view(pose), 2.0)
    panel.draw(recording.at(2.0), 2.0)
    assert panel.reason == ""
    recording.close()
    assert recording.rows(REASON, "TextDocument:text") == [[sentence]]
    poses = recording.rows("/body/capsules", "InstancePoses3D:translations")
    assert np.allclose(poses[0], poses[1])
    assert not np.allclose(poses[1], poses[2])
    (caption,) = recording.rows("/body/caption", "Points3D:labels")[1]
    assert "a0 shows" in caption


def test_a_world_that_cannot_be_made_here_is_said(recording: Recording) -> None:
    panel = BodyPanel(settings("Mjcf", {"file": "/nowhere/robot.xml"}))
    panel.begin(recording.at(0))
    panel.hear_view(view("pose", {"position": floats([[0] * 3]), "quaternion": floats([[1, 0, 0, 0]])}), 0.0)
    panel.draw(recording.at(1), 1.0)
    recording.close()
    assert "/nowhere/robot.xml" in panel.reason
    assert recording.rows(REASON, "TextDocument:text") == [[panel.reason]]
    assert isinstance(panel.body_view("Body"), rrb.TextDocumentView)


def test_numbers_that_are_none_are_not_drawn(recording: Recording) -> None:
    _, step = body("MimoHand")
    panel = BodyPanel(settings("MimoHand"))
    pose = step()
    pose.position[2, 1] = np.nan
    panel.hear_view(pose_view(pose), 0.0)
    panel.draw(recording.at(0), 0.0)
    recording.close()
    assert "/body/capsules" not in recording.entities()
    assert panel.ignored == 1


def test_eyes_are_drawn_by_name_and_strangers_are_not(recording: Recording) -> None:
    panel = BodyPanel(settings(*STANDING))
    pixels = np.random.default_rng(0).integers(0, 256, (16, 16, 3)).astype(np.uint8)
    panel.hear_view(view("image", {"pixels": pixels}, title="left eye"), 0.0)
    panel.hear_view(view("image", {"pixels": pixels}, title="../third eye"), 0.0)
    panel.draw(recording.at(0), 0.0)
    recording.close()
    assert eye_path("left eye") == "/eyes/left_eye"
    assert len(recording.rows("/eyes/left_eye", "EncodedImage:blob")) == 1
    assert {path for path in recording.entities() if path.startswith("/eyes")} == {"/eyes/left_eye"}
    assert panel.ignored == 1


def postures(count: int = 4, seed: int = 0) -> np.ndarray:
    return floats(np.random.default_rng(seed).uniform(-0.3, 0.3, (count, 3)))


def test_points_are_grey_in_babble_and_have_the_colour_of_their_vertex_later(recording: Recording) -> None:
    panel = BodyPanel(settings("Cuboid"))
    panel.begin(recording.at(0))
    first = postures(4, seed=0)
    panel.hear_view(view("posture", {"posture": first, "path": first[:2]}), 0.0)
    panel.draw(recording.at(0.1), 0.1)
    latent = floats([[0.8, 0.1, 0.1], [0.1, 0.8, 0.1], [0.1, 0.1, 0.8], [0.0, 0.5, 0.5001]])
    second = postures(4, seed=1)
    panel.hear_view(view("latent", {"latent": latent, "posture": second}, block="body"), 1.5)
    panel.draw(recording.at(1.5), 1.5)
    recording.close()
    points = recording.rows("/body/reached", "Points3D:positions")[-1]
    colours = recording.rows("/body/reached", "Points3D:colors")[-1]
    wanted = [GREY] * 4 + [of_index(vertex) for vertex in (0, 1, 2, 2)]
    for place, colour in zip(np.concatenate([first, second]), wanted, strict=True):
        apart = np.linalg.norm(np.array(points) - place, axis=1)
        assert apart.min() < 1e-6
        assert colours[int(apart.argmin())] == colour
    (path,) = recording.rows("/body/path", "LineStrips3D:strips")[0]
    np.testing.assert_allclose(path, first[:2], atol=1e-6)
    assert recording.rows("/body/now/names", "Points3D:labels")[0] == ["a0"]
    np.testing.assert_allclose(recording.rows("/body/now", "Points3D:positions")[-1], second[:1], atol=1e-6)
    assert len(recording.rows("/body/shape", "LineStrips3D:strips", static=True)) == 1


def test_points_reached_are_bounded_and_recent_ones_come_in(recording: Recording) -> None:
    panel = BodyPanel(settings("Cuboid"))
    rng = np.random.default_rng(0)
    for tick in range(1000):
        place = 0.1 if tick < 500 else 0.2
        posture = floats(np.column_stack([np.full(16, place), rng.uniform(-0.3, 0.3, (16, 2))]))
        panel.hear_view(view("posture", {"posture": posture}), tick / 5)
        panel.draw(recording.at(tick / 5), tick / 5)
    recording.close()
    reached = recording.rows("/body/reached", "Points3D:positions")
    assert 150 <= len(reached) <= 201, "once a second"
    assert max(len(points) for points in reached) == MOST_REACHED
    recent = np.mean([point[0] > 0.15 for point in reached[-1]])
    assert recent > 0.7, "most are of the last minutes"
    kept = recording.rows("/body/reached", "Points3D:positions", file=True)
    assert len(kept) < len(reached) / 5


def test_an_actor_that_is_silent_is_no_longer_drawn(recording: Recording) -> None:
    panel = BodyPanel(settings("Cuboid"))
    for tick in range(50):
        now = tick / 10
        if now < 1:
            panel.hear_view(view("posture", {"posture": postures()}, life="a0"), now)
        panel.hear_view(view("posture", {"posture": postures(seed=tick) + 0.3}, life="a1"), now)
        panel.draw(recording.at(now), now)
    recording.close()
    names = recording.rows("/body/now/names", "Points3D:labels")
    assert names[5] == ["a0", "a1"]
    assert names[-1] == ["a1"]


def test_a_latent_that_is_no_number_has_no_vertex_and_no_colour(recording: Recording) -> None:
    panel = BodyPanel(settings("Cuboid"))
    latent = floats([[0.1, 0.8, 0.1], [0.1, np.nan, 0.1]])
    panel.hear_view(view("latent", {"latent": latent, "posture": postures(2)}, block="body"), 0.0)
    panel.draw(recording.at(0), 0.0)
    recording.close()
    assert sorted(recording.rows("/body/reached", "Points3D:colors")[0]) == sorted([of_index(1), GREY])


@pytest.mark.parametrize(
    "wrong",
    [np.zeros((4, 2)), np.full((4, 3), np.nan), np.zeros((0, 3))],
    ids=["of another world", "not numbers", "none"],
)
def test_postures_that_are_none_of_this_world_are_counted(recording: Recording, wrong: np.ndarray) -> None:
    panel = BodyPanel(settings("Cuboid"))
    panel.hear_view(view("posture", {"posture": floats(wrong)}), 0.0)
    panel.draw(recording.at(0), 0.0)
    recording.close()
    assert panel.ignored == 1
    assert "/body/now" not in recording.entities()
