"""MIMo's body against the published models: the same figures, and the same motion under the same commands."""

import mujoco
import numpy as np
import pytest

from babble.worlds.mimo.body import ROOT, add_infant, infant
from babble.worlds.mimo.figures import HANDS, Figures, load
from babble.worlds.mimo.scenes import add_floor, hold_head
from tests.golden.mimo import make

BODIES: dict[str, Figures] = {
    "mitten": load("mitten"),
    "five_finger": load("five_finger"),
    "mitten without chest": load("mitten", chest=False),
}
needs_reference = pytest.mark.skipif(not make.REFERENCE.exists(), reason="../shared is not here")


def scene(body: str) -> mujoco.MjModel:
    """Our body in the surroundings of the published one."""
    spec = mujoco.MjSpec()
    add_floor(spec)
    benchmark = body != "mitten"
    if benchmark:
        add_benchmark_objects(spec)
    add_infant(spec, BODIES[body], dense=True)
    if benchmark:
        spec.body(ROOT).pos = (0, 0, 0.4)
    else:
        hold_head(spec)
    return spec.compile()


def add_benchmark_objects(spec: mujoco.MjSpec) -> None:
    """The stiff floor, the box and the bouncing ball of MIMo's benchmark scene."""
    stiff = {"solimp": (0.95, 0.99, 0.001, 0.5, 1), "solref": (0.005, 1)}
    floor = spec.geom("floor")
    floor.solimp, floor.solref = stiff["solimp"], stiff["solref"]
    box = spec.worldbody.add_body(name="test_object1", pos=(1, 0.3, 0.7))
    box.add_freejoint()
    box.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=(0.1, 0.1, 0.1), condim=6, **stiff)
    ball = spec.worldbody.add_body(name="test_object2", pos=(1, -0.3, 0.7))
    ball.add_freejoint()
    ball.add_geom(
        type=mujoco.mjtGeom.mjGEOM_SPHERE,
        size=(0.1, 0, 0),
        condim=6,
        solimp=(0.99, 0.995, 0.001, 0.5, 2),
        solref=(-20000, -20),
    )


def assert_same_figures(model: mujoco.MjModel, expected: make.Arrays) -> None:
    for name, value in make.figures(model).items():
        if name.startswith("names"):
            assert str(value).split("\n") == str(expected[name]).split("\n"), name
        else:
            np.testing.assert_allclose(value, expected[name], rtol=1e-12, atol=1e-15, err_msg=name)


@pytest.mark.parametrize("body", make.GOLDEN)
def test_has_the_golden_figures(body):
    assert_same_figures(scene(body), make.load(body))


@pytest.mark.parametrize("body", make.GOLDEN)
def test_moves_as_the_golden_trajectory(body):
    golden, model = make.load(body), scene(body)
    for window in range(make.STEPS // make.WINDOW):
        data = make.resume(model, golden, window)
        np.testing.assert_allclose(data.qpos, golden["run qpos"][window + 1], rtol=0, atol=1e-9)
        np.testing.assert_allclose(
            data.sensordata, golden["run sensordata"][window + 1], rtol=1e-9, atol=1e-9
        )


@needs_reference
@pytest.mark.parametrize("body", make.SCENES)
def test_is_and_moves_as_the_published_model(body):
    theirs, ours = make.published(body), scene(body)
    assert_same_figures(ours, make.figures(theirs))
    expected, actual = make.start(theirs), make.start(ours)
    for command in make.commands(theirs.nu):
        expected.ctrl, actual.ctrl = command, command
        mujoco.mj_step(theirs, expected)
        mujoco.mj_step(ours, actual)
        np.testing.assert_allclose(actual.qpos, expected.qpos, rtol=0, atol=1e-9)
        np.testing.assert_allclose(actual.sensordata, expected.sensordata, rtol=0, atol=1e-9)


def test_mitten_body_has_46_motors_and_44_without_the_chest():
    with_chest, without = infant(load("mitten")).compile(), infant(load("mitten", chest=False)).compile()
    assert (with_chest.nu, without.nu) == (46, 44)
    assert (with_chest.njnt - 1, without.njnt - 1) == (49, 47)
    assert without.body_mass.sum() == pytest.approx(with_chest.body_mass.sum(), abs=1e-12)


def test_five_fingers_can_have_a_chest():
    model = infant(load("five_finger", chest=True)).compile()
    assert (model.nu, model.njnt - 1) == (90, 93)


@pytest.mark.parametrize("hands", HANDS)
def test_sparse_and_dense_jacobians_give_the_same_motion(hands):
    def fall(dense: bool) -> mujoco.MjData:
        spec = mujoco.MjSpec()
        add_floor(spec)
        add_infant(spec, load(hands), dense=dense)
        model = spec.compile()
        assert model.opt.jacobian == (
            mujoco.mjtJacobian.mjJAC_DENSE if dense else mujoco.mjtJacobian.mjJAC_SPARSE
        )
        data = mujoco.MjData(model)
        data.qpos[2] = 0.331  # soles just above the floor
        for command in make.commands(model.nu)[:20]:
            data.ctrl = command
            mujoco.mj_step(model, data)
        assert data.ncon > 0
        return data

    np.testing.assert_allclose(fall(dense=False).qpos, fall(dense=True).qpos, rtol=0, atol=1e-12)


def test_held_body_has_no_free_joint():
    model = infant(load("mitten"), free=False).compile()
    assert model.njnt == 49
    assert model.nq == 49
