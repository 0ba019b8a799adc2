"""Parts of the body by themselves, and joints coupled by springs."""

import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.coupling import couple
from babble.worlds.mimo.cuts import FINGERS, arm, cut, finger, hand
from babble.worlds.mimo.figures import load

MITTEN, FIVE = load("mitten"), load("five_finger")
WHOLE = {"mitten": infant(MITTEN).compile(), "five_finger": infant(FIVE).compile()}
CUTS = {
    "mitten arm": ("mitten", arm(MITTEN)),
    "left mitten arm": ("mitten", arm(MITTEN, side="left")),
    "mitten hand": ("mitten", hand(MITTEN)),
    "arm": ("five_finger", arm(FIVE)),
    "hand": ("five_finger", hand(FIVE)),
    "left hand": ("five_finger", hand(FIVE, side="left")),
    "index finger": ("five_finger", finger(FIVE)),
    "little finger": ("five_finger", finger(FIVE, finger="lf")),
    "left thumb on its hand": ("five_finger", finger(FIVE, finger="th", side="left", on_hand=True)),
    "trunk": ("mitten", cut(MITTEN, root="lower_body")),
}
JOINT = ("range", "axis", "stiffness", "solimp", "pos")
DOF = ("damping", "armature", "frictionloss")
MOTOR = ("gear", "forcerange", "ctrlrange", "user")
BODY = ("mass", "inertia", "ipos", "iquat")


def names(part: object, count: int) -> list[str]:
    return [part(number).name for number in range(count)]  # type: ignore[operator]


@pytest.mark.parametrize("name", CUTS)
def test_cut_keeps_the_figures_of_what_it_keeps(name):
    hands, spec = CUTS[name]
    model, whole = spec.compile(), WHOLE[hands]
    for body in names(model.body, model.nbody)[2:]:
        for field in BODY:
            kept, was = getattr(model.body(body), field), getattr(whole.body(body), field)
            np.testing.assert_allclose(kept, was, rtol=1e-12, atol=1e-15, err_msg=f"{body} {field}")
    for joint in names(model.joint, model.njnt):
        for field in JOINT:
            np.testing.assert_array_equal(
                getattr(model.joint(joint), field), getattr(whole.joint(joint), field)
            )
        one, other = model.joint(joint).dofadr[0], whole.joint(joint).dofadr[0]
        for field in DOF:
            assert getattr(model, f"dof_{field}")[one] == getattr(whole, f"dof_{field}")[other]
    for motor in names(model.actuator, model.nu):
        for field in MOTOR:
            kept, was = getattr(model.actuator(motor), field), getattr(whole.actuator(motor), field)
            np.testing.assert_array_equal(kept, was)
    assert model.opt.timestep == 0.005


@pytest.mark.parametrize(
    ("name", "joints", "motors"),
    [
        ("mitten arm", 8, 8),
        ("mitten hand", 1, 1),
        ("arm", 29, 29),
        ("hand", 22, 22),
        ("index finger", 4, 4),
        ("little finger", 5, 5),
        ("left thumb on its hand", 5, 5),
    ],
)
def test_cut_has_its_joints_motors_locks_and_torque_sensors_only(name, joints, motors):
    model = CUTS[name][1].compile()
    assert (model.njnt, model.nu, model.neq) == (joints, motors, joints)
    moving = {model.jnt_bodyid[joint] for joint in range(model.njnt)}
    assert model.nsensor == len(moving)


def test_trunk_keeps_its_tendons_and_its_balance_and_an_arm_has_none():
    trunk = CUTS["trunk"][1].compile()
    assert trunk.ntendon == 9
    assert trunk.sensor("vestibular_acc").dim[0] == 3
    assert CUTS["arm"][1].compile().ntendon == 0


def test_patterns_choose_the_joints_and_the_rest_is_stiff():
    model = cut(FIVE, root="right_hand", joints=["robot:right_ff_*", "robot:right_mf_knuckle"]).compile()
    assert names(model.joint, model.njnt) == [
        "robot:right_ff_side",
        "robot:right_ff_knuckle",
        "robot:right_ff_middle",
        "robot:right_ff_distal",
        "robot:right_mf_knuckle",
    ]
    assert model.nbody == 2 + 17, "the whole hand is still there"


@pytest.mark.parametrize("letters", FINGERS)
def test_finger_with_contacts_closes_on_its_own_hand(letters):
    """MuJoCo lets a body meet a parent that is fixed to the world; a finger must not jam in its palm."""
    model = finger(FIVE, finger=letters, on_hand=True).compile()
    data = mujoco.MjData(model)
    assert data.ncon == 0
    flexing = [
        name for name in names(model.actuator, model.nu) if name.endswith(("knuckle", "middle", "distal"))
    ]
    for name in flexing:
        data.actuator(name).ctrl = 1
    mujoco.mj_step(model, data, 200)
    for name in flexing:
        joint = model.actuator_trnid[model.actuator(name).id, 0]
        low, high = model.jnt_range[joint]
        assert (data.qpos[joint] - low) / (high - low) > 0.75, name


def test_without_contacts_nothing_touches():
    model = hand(FIVE, contacts=False).compile()
    data = mujoco.MjData(model)
    data.ctrl = 1
    for _ in range(100):
        mujoco.mj_step(model, data)
        assert data.ncon == 0


def test_without_contacts_geoms_that_slide_on_each_other_do_not_either():
    assert cut(MITTEN, root="hip").compile().npair == 1
    assert cut(MITTEN, root="hip", contacts=False).compile().npair == 0


@pytest.mark.parametrize(
    ("root", "joints", "sentence"),
    [
        ("right_hnd", None, "the infant has no body 'right_hnd' to cut out; the nearest are right_hand"),
        (
            "right_hand",
            ["robot:rigth_ff_*"],
            r"no joint of right_hand matches 'robot:rigth_ff_\*'; the nearest are robot:",
        ),
        ("right_hand", ["robot:left_ff_*"], r"no joint of right_hand matches 'robot:left_ff_\*'"),
    ],
)
def test_unknown_names_give_one_sentence(root, joints, sentence):
    with pytest.raises(ValueError, match=sentence):
        cut(FIVE, root=root, joints=joints)


def test_mitten_has_no_finger_to_cut():
    with pytest.raises(ValueError, match="no body 'right_ffknuckle' to cut out; the nearest are right_"):
        finger(MITTEN)


KNUCKLE, MIDDLE = "robot:right_ff_knuckle", "robot:right_ff_middle"


def test_coupling_pulls_two_joints_to_the_same_share_of_their_ranges():
    """Energy K/2 (f_a - f_b)^2: torque on a joint = -K (f_a - f_b) / range_a."""
    spec = cut(FIVE, root="right_ffknuckle", joints=[KNUCKLE, MIDDLE], contacts=False)
    couple(spec, KNUCKLE, MIDDLE, 0.05)
    model = spec.compile()
    model.jnt_stiffness[:] = 0
    data = mujoco.MjData(model)
    low, span = model.jnt_range[:, 0], np.ptp(model.jnt_range, axis=1)
    for shares in ((0.5, 0.5), (0.8, 0.3), (0.0, 1.0)):
        data.qpos = low + np.array(shares) * span
        mujoco.mj_forward(model, data)
        gap = shares[0] - shares[1]
        np.testing.assert_allclose(data.qfrc_spring, np.array([-0.05, 0.05]) * gap / span, atol=1e-12)


def test_coupling_damps():
    spec = cut(FIVE, root="right_ffknuckle", joints=[KNUCKLE, MIDDLE], contacts=False)
    couple(spec, KNUCKLE, MIDDLE, 0.0, damping=0.001)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel = np.ptp(model.jnt_range, axis=1)  # both shares grow alike
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(data.qfrc_damper, -model.dof_damping * data.qvel, atol=1e-12)
    data.qvel[1] = 0
    mujoco.mj_forward(model, data)
    assert data.qfrc_damper[1] > 0, "the still joint is dragged along"


@pytest.mark.parametrize(
    ("a", "stiffness", "damping", "sentence"),
    [
        (
            "robot:right_ff_knuckl",
            0.05,
            0.0,
            "no joint 'robot:right_ff_knuckl' to couple; the nearest are robot:right_ff_kn",
        ),
        (KNUCKLE, -1.0, 0.0, "needs a stiffness and a damping of at least 0, got -1.0 and 0.0"),
        (KNUCKLE, 0.05, float("nan"), "needs a stiffness and a damping of at least 0"),
    ],
)
def test_bad_coupling_gives_one_sentence(a, stiffness, damping, sentence):
    spec = cut(FIVE, root="right_ffknuckle", contacts=False)
    with pytest.raises(ValueError, match=sentence):
        couple(spec, a, MIDDLE, stiffness, damping)


def test_joint_without_a_range_cannot_be_coupled():
    spec = mujoco.MjSpec()
    body = spec.worldbody.add_body()
    for name in ("free", "other"):
        body.add_joint(name=name)
    with pytest.raises(ValueError, match="joint 'free' has no range of motion"):
        couple(spec, "free", "other", 1)
