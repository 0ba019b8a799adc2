import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import load
from babble.worlds.senses.skin import SkinError, skin

PUBLISHED = {
    "hip": 119,
    "lower_body": 116,
    "head": 404,
    "left_eye": 1,
    "left_upper_arm": 54,
    "left_lower_arm": 47,
    "left_hand": 172,
    "left_fingers": 1944,
    "left_upper_leg": 82,
    "left_lower_leg": 35,
    "left_foot": 79,
    "left_toes": 48,
}
"""Points of MIMo's own package (mimoTouch.TrimeshTouch, geoms posed before it is set up)."""
POLYHEDRA = {"left_hand": 12, "left_lower_leg": 1, "left_foot": 4, "left_toes": 10}
"""So many points differ there: it takes round geoms for polyhedra when it looks what lies inside."""

SHAPES = {
    "sphere": '<geom type="sphere" size="0.05"/>',
    "capsule": '<geom type="capsule" size="0.03 0.05" pos="0.1 0 0" euler="30 40 0"/>',
    "cylinder": '<geom type="cylinder" size="0.04 0.05" euler="90 0 20"/>',
    "disc": '<geom type="cylinder" size="0.08 0.005"/>',
    "box": '<geom type="box" size="0.06 0.03 0.05" pos="0 0.1 0" euler="0 0 45"/>',
    "ellipsoid": '<geom type="ellipsoid" size="0.06 0.05 0.04"/>',
    "mesh": '<geom type="mesh" mesh="wedge" euler="0 20 0"/>',
    "overlapping": '<geom type="box" size="0.06 0.03 0.05"/><geom type="sphere" size="0.05" pos="0.04 0 0"/>'
    '<geom type="cylinder" size="0.03 0.05" pos="-0.05 0 0"/><geom type="capsule" size="0.02 0.1"/>',
}
DISTANCE_M = 0.012


def body_of(geoms):
    return mujoco.MjModel.from_xml_string(f"""
        <mujoco>
          <asset><mesh name="wedge" vertex="0 0 0  0.1 0 0  0 0.1 0  0 0 0.1"/></asset>
          <worldbody><body name="thing"><freejoint/>{geoms}</body>
          <geom name="probe" type="sphere" size="0.001" pos="9 9 9"/></worldbody>
        </mujoco>
    """)


def gaps(model, points):
    """How far each point is from the nearest of the body's geoms by MuJoCo; below 0 inside."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    probe = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, "probe")
    geoms = np.flatnonzero(model.geom_bodyid == model.body("thing").id)
    found = []
    for point in points:
        data.geom_xpos[probe] = data.body("thing").xmat.reshape(3, 3) @ point + data.body("thing").xpos
        found.append(min(mujoco.mj_geomDistance(model, data, geom, probe, 1.0, None) for geom in geoms))
    return np.array(found) + model.geom_size[probe, 0]


def test_mimos_parts_have_as_many_points_as_published():
    patches = {patch.name: len(patch.points) for patch in skin(infant(load("mitten")).compile())}
    for name, number in PUBLISHED.items():
        assert abs(patches[name] - number) <= POLYHEDRA.get(name, 0), name
        assert patches[name.replace("left", "right")] == patches[name]
    assert abs(sum(patches.values()) - 5725) < 40


def test_fingers_feel_finer_than_the_trunk():
    patches = {patch.name: patch for patch in skin(infant(load("five_finger")).compile())}
    assert patches["right_ffdistal"].distance_m == 0.002
    assert patches["right_ffmiddle"].distance_m == 0.004
    assert patches["upper_body"].distance_m == 0.03
    for name, patch in patches.items():
        if len(patch.points) > 1:
            apart = np.linalg.norm(patch.points[:, None] - patch.points, axis=2) + np.eye(len(patch.points))
            assert 0.4 < np.median(apart.min(axis=1)) / patch.distance_m < 1.5, name


@pytest.mark.parametrize("shape", SHAPES)
def test_points_lie_on_the_surface_and_none_inside(shape):
    model = body_of(SHAPES[shape])
    (patch,) = skin(model, ["thing"], distances_m={"thing": DISTANCE_M})
    assert len(patch.points) > 10
    np.testing.assert_allclose(gaps(model, patch.points), 0, atol=2e-4)


@pytest.mark.parametrize("shape", SHAPES)
def test_no_place_on_the_surface_is_far_from_a_point(shape):
    model = body_of(SHAPES[shape])
    (coarse,) = skin(model, ["thing"], distances_m={"thing": DISTANCE_M})
    (fine,) = skin(model, ["thing"], 4, distances_m={"thing": DISTANCE_M})
    nearest = np.linalg.norm(fine.points[:, None] - coarse.points, axis=2).min(axis=1)
    assert nearest.max() < 1.5 * DISTANCE_M


@pytest.mark.parametrize("kind", ["capsule", "cylinder"])
def test_a_part_thinner_than_the_distance_has_points_along_its_axis(kind):
    model = body_of(f'<geom type="{kind}" size="0.001 0.1"/>')
    (patch,) = skin(model, ["thing"], distances_m={"thing": DISTANCE_M})
    assert not patch.points[:, :2].any()
    heights = np.sort(patch.points[:, 2])
    assert heights[0] < -0.09
    assert heights[-1] > 0.09
    assert np.diff(heights).max() < 1.5 * DISTANCE_M


def test_half_the_resolution_leaves_about_a_quarter_of_the_points():
    model = infant(load("mitten")).compile()
    numbers = [sum(len(patch.points) for patch in skin(model, ["*hand*", "head"], r)) for r in (0.5, 1, 2)]
    assert 3 < numbers[1] / numbers[0] < 5
    assert 3 < numbers[2] / numbers[1] < 5


def test_even_the_coarsest_skin_has_a_point_on_each_part():
    model = infant(load("mitten")).compile()
    patches = skin(model, resolution=0.01)
    assert [len(patch.points) > 0 for patch in patches] == [True] * len(skin(model))


def test_only_what_can_be_touched_has_skin():
    model = body_of(
        '<geom name="skin" type="sphere" size="0.05"/>'
        '<geom type="sphere" size="0.06" contype="0" conaffinity="0"/>'
    )
    (patch,) = skin(model)
    np.testing.assert_allclose(np.linalg.norm(patch.points, axis=1), 0.05)
    with pytest.raises(SkinError, match="thing"):
        skin(body_of('<geom type="sphere" size="0.06" contype="0" conaffinity="0"/>'), ["thing"])


def test_a_skin_of_too_many_points_is_refused_in_one_sentence():
    with pytest.raises(SkinError, match=r"would have 1\d\d,\d\d\d points.*lower the resolution"):
        skin(body_of('<geom type="box" size="2 2 0.05"/>'), ["thing"], 1.5)
