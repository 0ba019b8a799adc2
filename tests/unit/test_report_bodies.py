"""Reports of simulated bodies: pictures of where goals lead, and the latent over a plane of postures."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from babble.policy.act import EncoderModel
from babble.worlds import make
from babble.worlds.physics.world import MujocoWorld
from babble.worlds.senses.screen import RendererError
from services.launcher import bodies
from services.launcher.bodies import is_posable, postures_in, sensed, states_of
from services.launcher.body_pictures import choose, cropped
from services.launcher.evaluate import Rollout, load_models, open_run, roll_out
from services.launcher.figures import Ends
from services.launcher.posture_map import Map, cells, draw_map, plane_of
from services.launcher.report import write_report
from tests.unit.analytic_run import encoder, policy, write_run
from tests.unit.toy_room import skip_without_renderer

BENT = (1.0, 1.0, 1.0)
"""Flexed for goal 0, stretched for goal 1."""


def finger(folder: Path, settings: str = "") -> Path:
    return write_run(folder, [{"body": (encoder(BENT), policy(BENT))}], world="MimoFinger", settings=settings)


def rolled(folder: Path) -> Rollout:
    run = open_run(finger(folder))
    version = run.version("body")
    return roll_out(run, [version], {"body": load_models(run, version)}, columns=8)


def finger_world(**parameters: Any) -> MujocoWorld:
    world = make("MimoFinger", parameters, columns=3, seed=0)
    assert isinstance(world, MujocoWorld)
    return world


def test_the_body_is_pictured_where_each_goal_leads(tmp_path: Path) -> None:
    skip_without_renderer()
    folder = finger(tmp_path / "run")
    text = write_report(folder).read_text()
    names = ("reached", "map", "postures", "way", "learning")
    assert [f"figures/body-{name}.png" in text for name in names] == [True] * len(names)
    for name in names:
        assert imread(folder / f"figures/body-{name}.png")[..., :3].std() > 0.05
    reached = imread(folder / "figures/body-reached.png")[..., :3]
    above, below = reached[: len(reached) // 2], reached[-(len(reached) // 2) :]
    assert (np.abs(above - below).max(axis=2) > 0.1).mean() > 0.02, "both rows show the same"


def test_without_a_renderer_the_report_says_so_and_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def blind(*_: object, **__: object) -> None:
        raise RendererError("there is no OpenGL here; install libosmesa6")

    monkeypatch.setattr(bodies, "picture", blind)
    text = write_report(finger(tmp_path / "run")).read_text()
    assert "not pictured: there is no OpenGL here; install libosmesa6.\n" in text
    assert "body-reached" not in text
    assert "figures/body-map.png" in text


def test_the_most_typical_end_comes_first_and_others_began_elsewhere(tmp_path: Path) -> None:
    rollout = rolled(tmp_path / "run")
    legs = rollout.legs["body"]
    rows = choose(rollout, "body", np.ones(legs.goal.shape, np.bool_))
    assert [row[0].vertex for row in rows] == [0, 1]
    for row in rows:
        assert len({end.column for end in row}) == len(row) == 4
        assert min(end.z for end in row) > 0.9
        ends = legs.posture[legs.goal == row[0].vertex]
        first = legs.posture[row[0].leg, row[0].column]
        off = np.linalg.norm(ends - ends.mean(axis=0), axis=1)
        assert np.linalg.norm(first - ends.mean(axis=0)) == pytest.approx(off.min())


def test_an_end_whose_body_has_begun_a_new_episode_is_not_pictured(tmp_path: Path) -> None:
    rollout = rolled(tmp_path / "run")
    goal = rollout.legs["body"].goal
    rows = choose(rollout, "body", goal == 1)
    assert [row[0].vertex for row in rows] == [1]


def test_states_are_those_at_the_ends_of_the_legs(tmp_path: Path) -> None:
    rollout = rolled(tmp_path / "run")
    legs, states = rollout.legs["body"], rollout.states
    assert states is not None
    assert states.shape[:2] == legs.goal.shape
    postures = postures_in(finger_world(), states.reshape(-1, states.shape[2]))
    np.testing.assert_allclose(postures.reshape(legs.posture.shape), legs.posture, atol=1e-6)


def test_a_state_put_back_is_the_same_body() -> None:
    world = finger_world()
    world.reset("random")
    for _ in range(5):
        world.step(np.full((3, world.action_size), 0.5, np.float32))
    states = states_of(world)
    assert states is not None
    np.testing.assert_allclose(postures_in(world, states), world.posture(), atol=1e-6)
    assert states_of(make("Cuboid", {}, columns=1, seed=0)) is None


def test_a_posed_body_senses_what_it_senses_there() -> None:
    """100 postures are more than are sensed at once."""
    world = finger_world(senses=["position", "velocity"], angles="radians")
    rng = np.random.default_rng(0)
    postures = rng.uniform(-1, 1, (100, world.posture_size)).astype(np.float32)
    assert is_posable(world)
    observation = sensed(world.blueprint, postures)
    assert observation.shape == (100, world.observation_size)
    model, joints = world.blueprint.model, world.blueprint.joints
    low, high = model.jnt_range[joints].T
    np.testing.assert_allclose(
        observation[:, : len(joints)], low + (high - low) * (postures + 1) / 2, atol=1e-5
    )
    assert not observation[:, len(joints) :].any(), "it is at rest"


@pytest.mark.parametrize(
    ("id", "parameters"),
    [
        ("MimoRollover", {}),
        ("MimoFinger", {"degradation": {"position": {"noise_std": 0.1}}}),
        ("Cuboid", {}),
    ],
)
def test_what_is_more_than_its_joints_is_not_posed(id: str, parameters: dict[str, Any]) -> None:
    assert not is_posable(make(id, parameters, columns=1, seed=0))


def ends_at(means: np.ndarray, *, spread: float = 0.0) -> Ends:
    rng, goals = np.random.default_rng(0), np.repeat(np.arange(len(means)), 5)
    posture = means[goals] + spread * rng.normal(size=(len(goals), means.shape[1]))
    way = np.linspace(np.zeros_like(posture), posture, 6).swapaxes(0, 1)
    return Ends(goals, posture, way, goals, way, len(means))


@pytest.mark.parametrize("joints", [1, 2, 14])
@pytest.mark.parametrize("vertices", [2, 3, 4, 9])
@pytest.mark.parametrize("posed", [True, False])
def test_a_map_is_drawn_for_any_number_of_joints_and_vertices(
    tmp_path: Path, joints: int, vertices: int, posed: bool
) -> None:
    rng = np.random.default_rng(1)
    ends = ends_at(rng.uniform(-0.9, 0.9, (vertices, joints)), spread=0.01)
    visited = rng.uniform(-1, 1, (500, joints))
    plane = plane_of(ends, visited)
    place, reach = cells(plane, ends, visited)
    if not posed:
        place = plane.of(visited)
    latent = rng.dirichlet(np.ones(vertices), len(place))
    latent[::7] = np.nan if posed else latent[::7]
    side = int(len(place) ** 0.5)
    drawn = Map(plane, place, latent, (side, side) if posed else None, reach)
    draw_map(tmp_path / "map.png", drawn, ends, "a body")
    assert imread(tmp_path / "map.png")[..., :3].std() > 0.05


def test_a_plane_goes_through_up_to_three_goals() -> None:
    rng = np.random.default_rng(0)
    visited = rng.normal(size=(300, 6)) * [3, 1, 1, 1, 1, 1]
    for vertices in (2, 3):
        ends = ends_at(rng.uniform(-1, 1, (vertices, 6)))
        plane = plane_of(ends, visited)
        np.testing.assert_allclose(plane.at(plane.of(ends.posture)), ends.posture, atol=1e-9)
        np.testing.assert_allclose(plane.axes @ plane.axes.T, np.eye(2), atol=1e-9)
        assert plane.held == pytest.approx(1.0)
    # The second axis of two goals is where the body went most, of what is left.
    two = plane_of(ends_at(np.array([[0, 1.0, 0, 0, 0, 0], [0, -1, 0, 0, 0, 0]])), visited)
    assert abs(two.axes[1, 0]) > 0.95
    corners = ends_at(np.eye(4, 6))
    assert plane_of(corners, visited).held == pytest.approx(2 / 3)


def test_pictures_are_cut_to_what_is_in_any_of_them() -> None:
    one = np.full((100, 100, 3), 240, np.uint8)
    other = one.copy()
    one[40:50, 30:60], other[60:70, 50:70] = 10, 10
    cut = cropped([one, other])
    assert [image.shape for image in cut] == [(42, 52, 3)] * 2
    assert all((image < 100).any() for image in cut)
    other[0] = 0
    assert [image.shape for image in cropped([one, other])] == [(100, 100, 3)] * 2


def test_the_map_of_a_run_is_of_its_encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    maps: list[Map] = []
    monkeypatch.setattr("services.launcher.block_pictures.of_body", lambda *_: [])
    monkeypatch.setattr(
        "services.launcher.posture_map.draw_map", lambda path, drawn, ends, title: maps.append(drawn)
    )
    folder = finger(tmp_path / "run")
    write_report(folder)
    (drawn,) = maps
    posture = drawn.plane.at(drawn.place)
    outside = np.abs(posture).max(axis=1) > 1
    np.testing.assert_array_equal(np.isnan(drawn.latent[:, 0]), outside)
    model = EncoderModel((folder / "models/body/encoder-1.onnx").read_bytes())
    np.testing.assert_allclose(
        drawn.latent[~outside], model.latent(posture[~outside].astype(np.float32)), atol=1e-5
    )
