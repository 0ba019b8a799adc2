"""What is drawn of a model lies where MuJoCo has it, and is of the size and colour that MuJoCo shows."""

from pathlib import Path

import mujoco
import numpy as np
import pytest

from babble import worlds
from babble.worlds.drawing import solids as solids_module
from babble.worlds.drawing.coarse import coarse_touch, outwards
from babble.worlds.drawing.poses import turned
from babble.worlds.drawing.solids import KINDS, drawing
from babble.worlds.drawing.wires import wire_frame
from babble.worlds.geometry import Body, CuboidBody, DumbbellBody, EllipsoidBody
from babble.worlds.physics.world import MujocoWorld
from tests.unit.drawn_things import (
    FLOOR_M,
    MESH_EULER_DEG,
    MESH_POS_M,
    MESH_VERTICES_M,
    THINGS,
    things_file,
)


def moved(id: str, parameters: dict[str, object]) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """A body after some random actions, with everything that depends on positions up to date."""
    world = worlds.make(id, parameters, 1, 0)
    assert isinstance(world, MujocoWorld)
    world.reset("random")
    rng = np.random.default_rng(0)
    for _ in range(10):
        world.step(rng.uniform(-1, 1, (1, world.action_size)).astype(np.float32))
    data = world.copies[0]
    mujoco.mj_forward(world.blueprint.model, data)
    return world.blueprint.model, data


def things() -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = mujoco.MjModel.from_xml_string(THINGS)
    data = mujoco.MjData(model)
    data.qpos[0] = 0.7
    mujoco.mj_forward(model, data)
    return model, data


def matrices(quaternion: np.ndarray) -> np.ndarray:
    """(n, 3, 3), by MuJoCo."""
    found = np.zeros((len(quaternion), 9))
    for matrix, each in zip(found, quaternion, strict=True):
        mujoco.mju_quat2Mat(matrix, np.asarray(each, np.float64))
    return found.reshape(-1, 3, 3)


@pytest.mark.parametrize("id", ["MimoHand", "MimoStandUp", "MimoKick", "Mjcf"])
def test_each_solid_is_where_mujoco_has_its_geom(id: str, tmp_path: Path) -> None:
    model, data = moved(id, {"file": things_file(tmp_path)} if id == "Mjcf" else {})
    found = drawing(model).solids
    for kind, types in KINDS.items():
        geoms = np.flatnonzero(np.isin(model.geom_type, types) & (model.geom_group < 3))
        geoms = geoms[model.geom_rgba[geoms, 3] == 1]
        if not len(geoms):
            continue
        solids, count = found[kind], len(geoms)
        position, quaternion = solids.at(data.xpos, data.xquat)
        np.testing.assert_allclose(position[:count], data.geom_xpos[geoms], atol=1e-6)
        wanted = data.geom_xmat[geoms].reshape(-1, 3, 3)
        np.testing.assert_allclose(matrices(quaternion[:count]), wanted, atol=1e-6)
        size = model.geom_size[geoms].copy()
        size[model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_SPHERE] = size[
            model.geom_type[geoms] == mujoco.mjtGeom.mjGEOM_SPHERE, :1
        ]
        np.testing.assert_array_equal(solids.size[:count], size)


def test_what_nobody_is_to_see_is_left_out() -> None:
    model, _ = things()
    found = drawing(model)
    assert {kind: len(each) for kind, each in found.solids.items()} == {
        "capsules": 1,
        "cylinders": 1,
        "boxes": 1,
        "ellipsoids": 3,  # egg, ball and the site of the face; neither hull nor mark
    }
    assert found.floor is not None
    assert found.floor.normal == (0.0, 0.0, 1.0)
    assert found.floor.distance_m == pytest.approx(FLOOR_M)


def test_colours_are_the_geoms_own_or_those_of_their_material() -> None:
    model, _ = things()
    ellipsoids = drawing(model).solids["ellipsoids"]
    assert ellipsoids.colour.tolist() == [[204, 51, 51, 255], [0, 0, 255, 255], [255, 255, 0, 255]]


def test_a_mesh_has_its_corners_where_they_were_written() -> None:
    model, data = things()
    (mesh,) = drawing(model).meshes
    position, quaternion = mesh.solids.at(data.xpos, data.xquat)
    drawn = position + turned(np.repeat(quaternion, len(mesh.vertices), axis=0), mesh.vertices)
    turn = np.zeros(4)
    mujoco.mju_euler2Quat(turn, np.radians(MESH_EULER_DEG), "xyz")
    local = matrices(turn[None])[0] @ np.array(MESH_VERTICES_M).T + np.array(MESH_POS_M)[:, None]
    base = model.body("base").id
    wanted = (data.xmat[base].reshape(3, 3) @ local).T + data.xpos[base]
    apart = np.linalg.norm(drawn[:, None] - wanted, axis=2)
    assert apart.min(axis=1).max() < 1e-6, "every corner that is drawn was written"
    assert apart[:, :4].min(axis=0).max() < 1e-6, "and the outer ones that were written are drawn"
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-5)


def test_a_mesh_of_too_many_faces_is_the_box_around_it(monkeypatch: pytest.MonkeyPatch) -> None:
    model, data = things()
    (mesh,) = drawing(model).meshes
    position, quaternion = mesh.solids.at(data.xpos, data.xquat)
    corners = position + turned(np.repeat(quaternion, len(mesh.vertices), axis=0), mesh.vertices)
    monkeypatch.setattr(solids_module, "MOST_FACES", 3)
    found = drawing(model)
    assert not found.meshes
    boxes = found.solids["boxes"]
    middle, turn = boxes.at(data.xpos, data.xquat)
    back = turned(np.repeat(turn[-1:], len(corners), axis=0) * (1, -1, -1, -1), corners - middle[-1])
    np.testing.assert_allclose(np.abs(back).max(axis=0), boxes.size[-1], atol=1e-6)


def test_mimo_has_a_face_and_its_ribbon_goes_from_ankle_to_knot() -> None:
    model, data = moved("MimoKick", {})
    found = drawing(model)
    ellipsoids = found.solids["ellipsoids"]
    position, _ = ellipsoids.at(data.xpos, data.xquat)
    mouth = data.site_xpos[model.site("mouth").id]
    assert np.linalg.norm(position - mouth, axis=1).min() < 1e-6
    (ribbon,) = found.strings
    ends = [data.site_xpos[model.site(name).id] for name in ("right_ankle", "mobile:knot")]
    np.testing.assert_allclose(ribbon.at(data.xpos, data.xquat), ends, atol=1e-6)


@pytest.mark.parametrize(
    "body",
    [
        CuboidBody((1.0, 0.6, 0.3)),
        EllipsoidBody((1.0, 0.6, 0.3)),
        DumbbellBody(0.9, 0.5, 0.15),
        DumbbellBody(0.9, 0.6, 0.55),
    ],
)
def test_wires_lie_on_the_surface_and_reach_all_ends(body: Body) -> None:
    lines = wire_frame(body)
    points = np.concatenate(lines)
    np.testing.assert_allclose(body.nearest(points), points, atol=1e-9)
    outside = points * (1, 1.01, 1.01)
    outside = outside[np.linalg.norm(points[:, 1:], axis=1) > 0.01]
    moved_back = np.linalg.norm(body.nearest(outside) - outside, axis=1)
    assert (moved_back > 1e-5).all()
    np.testing.assert_allclose(np.abs(points).max(axis=0), body.extent, rtol=0.01)


@pytest.mark.parametrize("id", ["MimoHand", "MimoStandUp", "Mjcf"])
def test_a_coarse_skin_has_a_few_hundred_points_on_all_parts(id: str, tmp_path: Path) -> None:
    parameters: dict[str, object] = {"contacts": True} if id == "MimoHand" else {}
    model, _ = moved(id, {"file": things_file(tmp_path)} if id == "Mjcf" else parameters)
    touch = coarse_touch(model)
    assert touch is not None
    assert 300 <= touch.shape[0] <= 600
    again = coarse_touch(model)
    assert again is not None
    for patch, other in zip(touch.patches, again.patches, strict=True):
        np.testing.assert_array_equal(patch.points, other.points)
    if id == "MimoStandUp":
        by_name = {patch.name: len(patch.points) for patch in touch.patches}
        assert min(by_name[name] for name in ("left_lower_leg", "right_hand", "left_foot", "chest")) > 8


def test_a_body_with_a_very_fine_mesh_has_no_skin() -> None:
    rng = np.random.default_rng(0)
    ball = rng.normal(size=(6000, 3))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    spec = mujoco.MjSpec()
    spec.add_mesh(name="ball", uservert=ball.ravel())
    spec.worldbody.add_body(name="ball").add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="ball")
    assert coarse_touch(spec.compile()) is None


def test_outwards_points_out_of_the_skin() -> None:
    model, _ = things()
    touch = coarse_touch(model)
    assert touch is not None
    (patch,) = touch.patches
    body = np.full(len(patch.points), patch.body)
    out = outwards(model, body, patch.points)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), 1, atol=1e-9)
    middle = model.geom("ball").pos
    on_ball = np.abs(np.linalg.norm(patch.points - middle, axis=1) - 0.07) < 1e-9
    assert on_ball.sum() > 5
    radial = (patch.points[on_ball] - middle) / 0.07
    np.testing.assert_allclose(out[on_ball], radial, atol=1e-9)
