import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import load
from babble.worlds.mimo.scenes import add_floor, place
from babble.worlds.senses.nearby import Nearby
from babble.worlds.senses.skin import SkinError
from babble.worlds.senses.touch import Touch
from tests.unit.plain_touch import body_forces, plain_touch

HEAP = """
<mujoco>
  <option timestep="0.002" cone="{cone}"/>
  <default><geom condim="{condim}" friction="0.8 0.01 0.001"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
    <body name="box" pos="0 0 0.05" euler="0 0 30">
      <freejoint/><geom type="box" size="0.06 0.05 0.04" mass="1"/>
    </body>
    <body name="log" pos="0.01 0 0.13" euler="90 0 10">
      <freejoint/><geom type="capsule" size="0.03 0.05" mass="0.5"/>
    </body>
    <body name="ball" pos="0.02 0.005 0.2">
      <freejoint/><geom type="sphere" size="0.03" mass="0.3"/>
    </body>
    <body name="drum" pos="0.2 0 0.2" euler="20 0 0">
      <freejoint/><geom type="cylinder" size="0.04 0.03" mass="0.4"/>
    </body>
  </worldbody>
</mujoco>
"""


def heap(cone="elliptic", condim=3, steps=150):
    """Things that fall on one another."""
    model = mujoco.MjModel.from_xml_string(HEAP.format(cone=cone, condim=condim))
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, steps)
    return model, data


@pytest.fixture(scope="module")
def lying():
    """MIMo on its belly, moving at random, and its touch; copies in which the floor and the body touch it."""
    spec = infant(load("mitten"))
    add_floor(spec)
    place(spec, "prone")
    model = spec.compile()
    rng = np.random.default_rng(3)
    copies = [mujoco.MjData(model) for _ in range(3)]
    for data in copies:
        for _ in range(40):
            data.ctrl[:] = rng.uniform(-1, 1, model.nu)
            mujoco.mj_step(model, data, 10)
    return model, Touch(model), copies


def split(touch, felt):
    """One copy's values, patch by patch: (n, 3) each."""
    ends = np.cumsum([len(patch.points) for patch in touch.patches])
    return np.split(felt.reshape(-1, 3), ends[:-1])


def in_world(data, patch, forces):
    return data.xmat[patch.body].reshape(3, 3) @ forces.sum(axis=0)


def between_parts(model, data):
    """Contacts of the body with itself."""
    bodies = model.geom_bodyid[data.contact.geom]
    return ((bodies > 0).all(axis=1) & (bodies[:, 0] != bodies[:, 1])).sum()


def test_mimo_feels_by_the_published_rule(lying):
    model, touch, copies = lying
    assert sum(between_parts(model, data) for data in copies) > 0
    assert all((data.contact.geom == 0).any() for data in copies)
    felt = touch.read(copies)
    assert felt.shape == (3, *touch.shape)
    assert felt.dtype == np.float32
    for data, values in zip(copies, felt, strict=True):
        expected = np.concatenate(plain_touch(model, data, touch.patches))
        np.testing.assert_allclose(values.reshape(-1, 3), expected, rtol=1e-4, atol=1e-5)


def test_what_a_part_feels_adds_up_to_the_contact_forces_on_it(lying):
    model, touch, copies = lying
    for data, felt in zip(copies, touch.read(copies), strict=True):
        for patch, forces in zip(touch.patches, split(touch, felt), strict=True):
            np.testing.assert_allclose(
                in_world(data, patch, forces), body_forces(model, data, patch.body), atol=1e-4
            )


@pytest.mark.parametrize("condim", [1, 3, 4, 6])
@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_all_kinds_of_contacts_are_felt_by_the_published_rule(cone, condim):
    model, data = heap(cone, condim)
    touch = Touch(model)
    assert data.ncon > 5
    expected = np.concatenate(plain_touch(model, data, touch.patches))
    np.testing.assert_allclose(touch.read([data])[0].reshape(-1, 3), expected, rtol=1e-4, atol=1e-5)


def test_two_parts_that_touch_feel_opposite_forces_where_they_face_each_other():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <option gravity="0 0 0" cone="elliptic"/>
          <worldbody>
            <body name="trunk">
              <geom type="sphere" size="0.001"/>
              <body name="left" pos="0 0 0.2" euler="0 70 0">
                <joint type="slide" axis="0.34 0 0.94"/><geom type="sphere" size="0.05" mass="1"/>
              </body>
              <body name="right" pos="0.1 0 0.2" euler="20 0 0">
                <joint type="slide" axis="1 0 0"/><geom type="sphere" size="0.05" mass="1"/>
              </body>
            </body>
          </worldbody>
        </mujoco>
    """)
    data = mujoco.MjData(model)
    data.qvel[:] = 0.0, -0.5
    mujoco.mj_step(model, data, 3)
    touch = Touch(model, ["left", "right"], resolution=2)
    (left, right), forces = touch.patches, split(touch, touch.read([data])[0])
    on_left, on_right = in_world(data, left, forces[0]), in_world(data, right, forces[1])
    assert on_right[0] > 1
    np.testing.assert_allclose(on_left, -on_right, atol=1e-5)
    for patch, force, facing in ((left, forces[0], 1.0), (right, forces[1], -1.0)):
        felt_at = np.average(patch.points, axis=0, weights=np.linalg.norm(force, axis=1))
        assert (data.xmat[patch.body].reshape(3, 3) @ felt_at)[0] * facing > 0.03


@pytest.mark.parametrize("cone", ["elliptic", "pyramidal"])
def test_reading_changes_nothing(cone):
    model, data = heap(cone)
    touch = Touch(model)
    before = [np.array(part) for part in parts(data)]
    first, second = touch.read([data]), touch.read([data])
    for was, part in zip(before, parts(data), strict=True):
        np.testing.assert_array_equal(was, part)
    np.testing.assert_array_equal(first, second)


def parts(data):
    state = (data.qpos, data.qvel, data.qacc, data.ctrl, data.xpos, data.xmat, data.sensordata)
    contact = data.contact
    return *state, data.efc_force, contact.frame, contact.pos, contact.dist, contact.geom, contact.efc_address


def test_copies_feel_what_each_would_alone(lying):
    _, touch, copies = lying
    together = touch.read(copies)
    for data, felt in zip(copies, together, strict=True):
        np.testing.assert_allclose(touch.read([data])[0], felt, atol=1e-6)


def test_nothing_is_felt_in_the_air():
    model, data = heap(steps=1)
    touch = Touch(model)
    other = mujoco.MjData(model)
    mujoco.mj_step(model, other, 150)
    data.qpos[2::7] += 5
    mujoco.mj_forward(model, data)
    felt = touch.read([data, other])
    assert not felt[0].any()
    assert felt[1].any()
    assert not touch.read([data]).any()


def test_what_is_near_but_does_not_press_is_not_felt():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <option cone="elliptic" gravity="0 0 -9.81"/>
          <worldbody>
            <geom type="plane" size="0 0 1"/>
            <body name="resting" pos="0 0 0.0999"><freejoint/><geom type="sphere" size="0.1"/></body>
            <body name="held" pos="0.5 0 0.11"><geom type="sphere" size="0.1" gap="0.05"/>
              <joint type="slide" axis="0 0 1" stiffness="10000" damping="10"/></body>
          </worldbody>
        </mujoco>
    """)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 100)
    assert data.ncon == 2
    touch = Touch(model)
    resting, held = split(touch, touch.read([data])[0])
    assert np.linalg.norm(resting.sum(axis=0)) > 1
    assert not held.any()


def test_places_anywhere_are_shared_by_the_rule_among_the_points_of_their_own_patch():
    model, _ = heap(steps=1)
    patches = Touch(model).patches
    nearby = Nearby(patches, np.array([2 * patch.distance_m for patch in patches]))
    rng = np.random.default_rng(0)
    patch = rng.integers(len(patches), size=600)
    place = rng.uniform(-1, 1, (600, 3)) * rng.choice([0.03, 0.08, 0.3], (600, 1))
    rows, points, shares = nearby.shares(patch, place)
    found = np.zeros((600, sum(len(each.points) for each in patches)))
    np.add.at(found, (rows, points), shares)
    starts = np.cumsum([0, *(len(each.points) for each in patches)])
    for row in range(600):
        each, start = patches[patch[row]], starts[patch[row]]
        away = np.linalg.norm(each.points - place[row], axis=1)
        weights = np.maximum(1 - away / (2 * each.distance_m), 0)
        if not weights.any():
            weights[np.argmin(away)] = 1
        expected = np.zeros(found.shape[1])
        expected[start : start + len(weights)] = weights / weights.sum()
        np.testing.assert_allclose(found[row], expected, atol=1e-9)


def test_norms_are_the_lengths_of_the_vectors():
    model, data = heap()
    vectors, norms = Touch(model), Touch(model, components="norm")
    assert norms.shape == (vectors.shape[0] // 3,)
    lengths = np.linalg.norm(vectors.read([data, data]).reshape(2, -1, 3), axis=2)
    np.testing.assert_allclose(norms.read([data, data]), lengths, rtol=1e-5, atol=1e-6)


def test_the_chosen_parts_feel_as_they_would_among_all():
    model, data = heap()
    every, some = Touch(model), Touch(model, ["b*", "!box"])
    assert [patch.name for patch in some.patches] == ["ball"]
    expected = split(every, every.read([data])[0])[2]
    np.testing.assert_allclose(some.read([data])[0].reshape(-1, 3), expected, atol=1e-6)


def test_force_far_from_every_point_goes_to_the_nearest():
    model = mujoco.MjModel.from_xml_string("""
        <mujoco>
          <option cone="elliptic"/>
          <worldbody>
            <body name="ground">
              <geom type="plane" size="0 0 1"/><geom type="sphere" size="0.01" pos="0.5 0 0"/>
              <geom type="sphere" size="0.01" pos="0.8 0 0"/>
            </body>
            <body pos="0 0 0.0999"><freejoint/><geom type="sphere" size="0.1" mass="2"/></body>
          </worldbody>
        </mujoco>
    """)
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 500)
    touch = Touch(model, ["ground"])
    felt = touch.read([data])[0].reshape(-1, 3)
    np.testing.assert_allclose(felt.sum(axis=0), [0, 0, -2 * 9.81], atol=0.05)
    np.testing.assert_allclose(touch.patches[0].points[felt.any(axis=1)], [[0.5, 0, 0]])


def test_a_broken_copy_leaves_the_others_as_they_are():
    model, data = heap()
    touch = Touch(model)
    broken = mujoco.MjData(model)
    mujoco.mj_step(model, broken, 150)
    broken.contact.pos[1] = np.nan
    broken.efc_force[:3] = np.inf
    broken.xpos[2] = 1e300
    felt = touch.read([data, broken, data])
    np.testing.assert_array_equal(felt[::2], touch.read([data, data]))


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"bodies": ["hand"]}, "no body matches 'hand'"),
        ({"bodies": ["world"]}, "no body that matches world has a geom"),
        ({"resolution": 0}, "resolution is a number above 0 and at most 4, got 0"),
        ({"resolution": float("nan")}, "resolution is a number"),
        ({"components": "tensor"}, 'components are "vector" or "norm", got \'tensor\''),
    ],
)
def test_bad_options_are_told_in_one_sentence(options, says):
    model, _ = heap(steps=1)
    with pytest.raises(ValueError, match=says) as found:
        Touch(model, **options)
    assert "\n" not in str(found.value)


def test_a_model_without_geoms_has_no_touch():
    model = mujoco.MjModel.from_xml_string(
        '<mujoco><worldbody><body name="dot"><freejoint/><inertial pos="0 0 0" mass="1" '
        'diaginertia="1 1 1"/></body></worldbody></mujoco>'
    )
    with pytest.raises(SkinError, match="leave touch out"):
        Touch(model)
