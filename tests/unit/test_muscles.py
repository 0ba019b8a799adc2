"""MIMo's muscle model: antagonists that pull, build up, tire at speed and resist when stretched."""

import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose

from babble.worlds.physics.muscles import (
    MuscleError,
    Muscles,
    force_length,
    force_velocity,
    hand_over,
    passive_force,
)
from tests.unit.small_body import ARM, arm

BOTH = np.arange(2)
REST, FULL = -1.0, 1.0


def stepped(action: list[float], steps: int, gravity: bool = False) -> mujoco.MjData:
    """The arm after so many physics steps under [closing both, opening both] excitations."""
    model = arm()
    hand_over(model, BOTH, BOTH)
    model.opt.gravity[:] = [0, 0, -9.81 if gravity else 0]
    muscles = Muscles(model, BOTH, model.jnt_range.copy(), 1)
    data = mujoco.MjData(model)
    data.qpos[:] = np.radians([-15, -60])
    muscles.begin(np.array([True]))
    muscles.advance([data], np.array([action]), steps)
    return data


def test_the_first_muscles_turn_backwards_and_their_antagonists_forwards() -> None:
    start = np.radians([-15, -60])
    assert (stepped([FULL, FULL, REST, REST], 40).qpos < start).all()
    assert (stepped([REST, REST, FULL, FULL], 40).qpos > start).all()
    assert_allclose(stepped([REST, REST, REST, REST], 40).qpos, start, atol=0.02)


def test_activity_builds_up_with_its_time_constant() -> None:
    model = arm()
    hand_over(model, BOTH, BOTH)
    muscles = Muscles(model, BOTH, model.jnt_range.copy(), 2)
    copies = [mujoco.MjData(model) for _ in range(2)]
    muscles.begin(np.array([True, True]))
    muscles.advance(copies, np.array([[FULL] * 4, [REST] * 4]), 3)
    activity = muscles.efforts()[:, :4]
    assert_allclose(activity, [[1 - 0.5**3] * 4, [0] * 4])
    muscles.begin(np.array([True, False]))
    assert_allclose(muscles.efforts()[0], 0)


def test_a_stronger_direction_pulls_harder() -> None:
    both = stepped([FULL, REST, FULL, REST], 5)
    assert both.ctrl[0] > 0, "FMAX+ is twice FMAX-, so the joint is turned forwards"


def test_the_curves_have_the_published_corners() -> None:
    length = np.array([0.4, 0.5, 1.0, 1.6, 2.0])
    assert_allclose(force_length(length), [0, 0, 1, 0, 0], atol=1e-12)
    speed = np.array([-2, -1, -0.5, 0, 0.2, 3])
    assert_allclose(force_velocity(speed), [0, 0, 0.25, 1, 1.2, 1.2], atol=1e-12)
    assert_allclose(passive_force(np.array([0.8, 1.0, 1.3])), [0, 0, 0.325], atol=1e-12)


@pytest.mark.parametrize(
    ("curve", "places"),
    [
        (force_length, (0.725, 0.75, 0.8375, 0.95, 1.3)),
        (force_velocity, (-1, 0, 0.2)),
        (passive_force, (1, 1.3)),
    ],
)
def test_the_curves_have_no_jumps(curve, places) -> None:  # type: ignore[no-untyped-def]
    for place in places:
        low, high = curve(np.array([place - 1e-9, place + 1e-9]))
        assert low == pytest.approx(high, abs=1e-6)


def test_a_model_without_the_muscles_figures_is_refused() -> None:
    model = mujoco.MjModel.from_xml_string(ARM.replace('user="1.5 4 8"', ""))
    with pytest.raises(MuscleError, match="muscles need VMAX, FMAX- and FMAX\\+ of each motor"):
        hand_over(model, BOTH, BOTH)


def test_an_actuator_that_is_no_motor_of_a_limited_hinge_is_refused() -> None:
    for wrong in (
        ('<motor name="lift"', '<position name="lift"'),
        ('limited="true" damping', 'limited="false" damping'),
    ):
        model = mujoco.MjModel.from_xml_string(ARM.replace(*wrong))
        with pytest.raises(
            MuscleError, match="muscles need motors of hinges with limits, and 'lift' drives none"
        ):
            hand_over(model, BOTH, BOTH)


def test_joints_that_are_not_the_bodys_keep_their_dampers() -> None:
    model = arm()
    hand_over(model, BOTH, BOTH[:1])
    assert_allclose(model.dof_damping, [0.2 / 20, 0.1])
