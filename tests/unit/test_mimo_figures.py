"""The tables of figures: one number changes a limb or a muscle, and a bad one is answered by one sentence."""

import math
from typing import Any

import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import infant
from babble.worlds.mimo.figures import HANDS, FiguresError, load, load_file


def at_rest(
    edits: dict[str, Any] | None = None, hands: str = "mitten"
) -> tuple[mujoco.MjModel, mujoco.MjData]:
    """The held body at the zero pose."""
    model = infant(load(hands, edits=edits), free=False).compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def along(data: mujoco.MjData, limb: str, end: str) -> float:
    """How far out the origin of `end` lies, along the own z axis of `limb` (metres)."""
    return float((data.body(end).xpos - data.body(limb).xpos) @ data.body(limb).xmat.reshape(3, 3)[:, 2])


@pytest.mark.parametrize("hands", HANDS)
def test_longer_upper_arm_by_one_number_puts_both_hands_further_out(hands):
    usual, data = at_rest(hands=hands)
    longer, stretched = at_rest({"arm": {"upper_arm": {"length": 0.1076 + 0.05}}}, hands)
    for side in ("right", "left"):
        arm, hand = f"{side}_upper_arm", f"{side}_hand"
        assert along(stretched, arm, hand) - along(data, arm, hand) == pytest.approx(0.05, abs=1e-9)
        # The flesh reaches as close to the elbow as before.
        grown = longer.geom(f"{side}_uarm1").size[1] - usual.geom(f"{side}_uarm1").size[1]
        assert grown == pytest.approx(0.025, abs=1e-9)
        assert along(stretched, arm, hand) > 0.15
    np.testing.assert_array_equal(longer.body_mass, usual.body_mass)


def test_longer_thigh_by_one_number_puts_the_feet_further_down():
    _, data = at_rest()
    _, stretched = at_rest({"leg": {"upper_leg": {"length": 0.135 + 0.03}}})
    for foot in ("right_foot", "left_foot"):
        assert data.body(foot).xpos[2] - stretched.body(foot).xpos[2] == pytest.approx(0.03, abs=1e-9)


def test_weaker_muscle_by_one_number_gives_half_the_torque():
    def torque(model: mujoco.MjModel) -> float:
        data = mujoco.MjData(model)
        data.ctrl = 1.0
        mujoco.mj_forward(model, data)
        return float(data.qfrc_actuator[model.joint("robot:left_knee").dofadr[0]])

    usual, _ = at_rest()
    weak, _ = at_rest({"leg": {"motors": {"knee": {"torque": 5}}}})
    assert torque(usual) == pytest.approx(10)
    assert torque(weak) == pytest.approx(5)
    assert (weak.actuator_gear != usual.actuator_gear).sum() == 2, "one number, the two knees"


def test_one_side_can_differ():
    model, _ = at_rest({"leg": {"motors": {"knee": {"left": {"torque": 2}}}}})
    assert model.actuator("act:left_knee").gear[0] == 2
    assert model.actuator("act:right_knee").gear[0] == 10


def test_file_of_edits_makes_a_body(tmp_path):
    path = tmp_path / "long.toml"
    path.write_text('hands = "five_finger"\n[hand.ffdistal]\nlength = 0.02\n[settings]\nchest = true\n')
    figures = load_file(path)
    assert len(figures.motors) == 90
    tip = figures.body("left_ffdistal").geoms[0]
    assert tip.pos[2] + tip.size[1] == pytest.approx(0.02)


def test_body_is_symmetric_except_where_the_table_says_otherwise():
    """The mirror image of each right segment is the left one; only MIMo's own exceptions differ."""
    for hands, odd in (("mitten", {"hand"}), ("five_finger", set())):
        _, data = at_rest(hands=hands)
        for body in load(hands).bodies:
            if body.name.startswith("right_"):
                other = data.body(f"left_{body.name.removeprefix('right_')}")
                mirrored = data.body(body.name).xpos * (1, -1, 1)
                off = float(np.abs(other.xpos - mirrored).max())
                lopsided = bool(odd) and ("hand" in body.name or "fingers" in body.name)
                assert off == pytest.approx(0.014 * math.cos(math.radians(10)) if lopsided else 0, abs=1e-9)


TYPO = {"arm": {"upper_arm": {"lenght": 0.2}}}
BAD: list[tuple[dict[str, Any], str]] = [
    (TYPO, "arm.upper_arm.lenght is not known there; known are"),
    ({"arm": {"uper_arm": {"length": 0.2}}}, "arm.uper_arm.parent is missing"),
    (
        {"arm": {"upper_arm": {"length": "long"}}},
        "arm.upper_arm.length must be a number of at least 0, got 'long'",
    ),
    ({"arm": {"upper_arm": {"length": math.nan}}}, "arm.upper_arm.length must be a number"),
    (
        {"arm": {"lower_arm": {"length": 0.01}}},
        "arm.lower_arm.length is 0.01, too short for flesh that spans",
    ),
    ({"arm": {"upper_arm": 3}}, "arm.upper_arm must be a table, got 3"),
    ({"arm": {"upper_arm": {"pos": [1, 2]}}}, r"arm.upper_arm.pos must be 3 numbers, got \[1, 2\]"),
    ({"arm": {"upper_arm": {"along": "up"}}}, "arm.upper_arm.along must be one of"),
    ({"arm": {"upper_arm": {"parent": "wing"}}}, "arm.upper_arm.parent is 'wing', but no such body"),
    (
        {"arm": {"lower_arm": {"joints": {"elbow": {"range": [5, 5]}}}}},
        "elbow.range must be two numbers, the smaller",
    ),
    ({"arm": {"lower_arm": {"joints": {"elbow": {"axis": [0, 0, 0]}}}}}, "elbow.axis must point somewhere"),
    ({"arm": {"lower_arm": {"joints": {"elbow": {"rang": [0, 1]}}}}}, "joints.elbow.rang is not known there"),
    ({"arm": {"lower_arm": {"geoms": {"flesh": {"mass": 0}}}}}, "flesh.mass must be above 0, got 0"),
    ({"arm": {"lower_arm": {"geoms": {"flesh": {"radius": -1}}}}}, "flesh leaves a capsule of half sizes"),
    ({"arm": {"lower_arm": {"geoms": {"flesh": {"condim": 2}}}}}, "flesh.condim must be 1, 3, 4 or 6, got 2"),
    ({"arm": {"lower_arm": {"geoms": {"flesh": {"look": "gold"}}}}}, "look like 'gold'; looks are skin"),
    (
        {"arm": {"motors": {"elbow": {"torque": -1}}}},
        "arm.motors.elbow.torque must be a number of at least 0",
    ),
    (
        {"arm": {"motors": {"elbw": {"torque": 1, "muscle": [1, 2, 3]}}}},
        "elbw.joint names 'robot:right_elbw'",
    ),
    ({"head": {"head": {"left": {"pos": [0, 0, 0]}}}}, "head.head has no sides"),
    ({"trunk": {"torques": ["chest"]}}, "trunk.torques must list the torque sensors"),
    ({"wing": {"tip": {"parent": "hip"}}}, "wing is no region that order.motors names"),
    ({"settings": {"chest": 1}}, "settings.chest must be true or false, got 1"),
    ({"settings": {"timestep": 0}}, "settings.timestep must be above 0"),
    ({"contacts": {"exclude": [["head", "tail"]]}}, "contacts.exclude must be pairs of known names"),
]


@pytest.mark.parametrize(("edits", "sentence"), BAD, ids=[sentence[:40] for _, sentence in BAD])
def test_bad_figures_give_one_sentence_with_source_and_key(edits, sentence):
    with pytest.raises(FiguresError, match=f"the edits: .*{sentence}") as error:
        load("mitten", edits=edits)
    assert "\n" not in str(error.value)


def test_sentence_names_the_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[arm.upper_arm]\nlenght = 0.2\n")
    with pytest.raises(FiguresError, match=r"mine\.toml: arm\.upper_arm\.lenght is not known"):
        load_file(path)
    path.write_text("[arm")
    with pytest.raises(FiguresError, match=r"mine\.toml is no TOML"):
        load_file(path)
    path.write_text('hands = "paws"')
    with pytest.raises(
        FiguresError, match=r"mine\.toml: hands must be one of mitten, five_finger, got 'paws'"
    ):
        load_file(path)
    with pytest.raises(FiguresError, match=r"none\.toml cannot be read: No such file"):
        load_file(tmp_path / "none.toml")


def test_unknown_hands_give_one_sentence():
    with pytest.raises(FiguresError, match="hands must be one of mitten, five_finger, got 'paws'"):
        load("paws")
