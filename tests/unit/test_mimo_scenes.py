"""The body put down on a floor."""

import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import HANDS, load
from babble.worlds.mimo.scenes import POSTURES, add_face, add_floor, hold_head, place, set_angles

UP = np.array([0, 0, 1])


def put_down(posture: str, hands: str = "mitten", held: bool = False) -> tuple[mujoco.MjModel, mujoco.MjData]:
    spec = infant(load(hands))
    add_floor(spec)
    angles = place(spec, posture)
    if held:
        hold_head(spec)
    model = spec.compile()
    data = mujoco.MjData(model)
    set_angles(model, data, angles)
    mujoco.mj_forward(model, data)
    return model, data


@pytest.mark.parametrize("hands", HANDS)
@pytest.mark.parametrize("posture", POSTURES)
def test_posture_touches_neither_floor_nor_itself_and_falls_less_than_a_centimetre(hands, posture):
    model, data = put_down(posture, hands)
    assert data.ncon == 0
    inside = (data.qpos[7:] >= model.jnt_range[1:, 0]) & (data.qpos[7:] <= model.jnt_range[1:, 1])
    assert inside.all()
    height = data.qpos[2]
    while data.ncon == 0:
        mujoco.mj_step(model, data)
        assert height - data.qpos[2] < 0.01


@pytest.mark.parametrize(("posture", "chest_up"), [("supine", 1), ("prone", -1), ("standing", 0)])
def test_infant_lies_on_its_back_or_belly(posture, chest_up):
    _, data = put_down(posture)
    forward = data.body("upper_body").xmat.reshape(3, 3)[:, 0]
    assert forward @ UP == pytest.approx(chest_up, abs=1e-9)


def test_sitting_infant_has_its_head_above_its_hip_and_its_feet_in_front():
    _, data = put_down("sitting")
    head, hip, foot = (data.body(name).xpos for name in ("head", "hip", "left_foot"))
    assert head[2] - hip[2] > 0.25
    assert foot[0] - hip[0] > 0.2
    assert data.body("left_foot").xpos[1] - data.body("right_foot").xpos[1] > 0.15, "legs apart"


@pytest.mark.parametrize("posture", ["supine", "prone"])
def test_lying_infant_stays_where_it_lies(posture):
    model, data = put_down(posture)
    before = data.body("upper_body").xpos.copy()
    mujoco.mj_step(model, data, 400)
    assert np.abs(data.body("upper_body").xpos - before).max() < 0.05
    assert np.abs(data.qvel).max() < 1


def test_held_head_does_not_turn():
    model, data = put_down("supine", held=True)
    neck = [
        model.joint(name).qposadr[0]
        for name in ("robot:head_swivel", "robot:head_tilt", "robot:head_tilt_side")
    ]
    start = data.qpos[neck].copy()
    data.actuator("act:head_swivel").ctrl = 1
    mujoco.mj_step(model, data, 200)
    assert np.abs(data.qpos[neck] - start).max() < 0.02
    free, turning = put_down("supine")
    turning.actuator("act:head_swivel").ctrl = 1
    mujoco.mj_step(free, turning, 200)
    assert turning.joint("robot:head_swivel").qpos[0] > 0.2


def test_face_changes_nothing_of_the_physics():
    plain, seen = infant(load("mitten")), infant(load("mitten"))
    add_face(seen)
    before, after = plain.compile(), seen.compile()
    assert after.nsite == before.nsite + 3
    assert after.ngeom == before.ngeom
    np.testing.assert_array_equal(after.body_inertia, before.body_inertia)


def test_unknown_posture_gives_one_sentence():
    with pytest.raises(
        ValueError, match="no posture 'flying'; the postures are standing, supine, prone, sitting"
    ):
        place(infant(load("mitten")), "flying")
