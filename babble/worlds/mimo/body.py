"""MIMo's body as a `mujoco.MjSpec`, made from figures.

Children, geoms, motors and sensors come in the order of the published model, so that both compile to the
same numbers. Angles in the spec are degrees until it is compiled, MuJoCo's default.
"""

import mujoco
import numpy as np

from babble.worlds.mimo.anatomy import BodyFigures, Figures, GeomFigures, JointFigures, MotorFigures
from babble.worlds.mimo.regions import ROOT
from babble.worlds.mimo.tables import Vector

__all__ = ["ROOT", "add_infant", "infant", "turn"]

SHAPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
SENSOR_SITES = 4
"""The geom group of sites that carry sensors; viewers hide it."""


def infant(figures: Figures, *, free: bool = True, dense: bool = False) -> mujoco.MjSpec:
    """The body alone in an empty world, its root `mimo_location` at the origin.

    free: whether the root moves freely (a free joint of the root's name) or is held.
    dense: MuJoCo's dense Jacobian, for parity with the published model; the sparse one gives the same
        physics in about half the time.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "MIMo"
    add_infant(spec, figures, free=free, dense=dense)
    return spec


def add_infant(spec: mujoco.MjSpec, figures: Figures, *, free: bool = True, dense: bool = False) -> None:
    """As `infant`, behind what `spec` already holds; sets the solver's options too."""
    _set_options(spec, figures, dense)
    for name, look in figures.looks.items():
        spec.add_material(name=name, rgba=look.rgba, specular=look.specular, shininess=look.shininess)
    root = spec.worldbody.add_body(name=ROOT)
    if free:
        root.add_freejoint(name=ROOT)
    hung: dict[str, list[BodyFigures]] = {}
    for figure in figures.bodies:
        hung.setdefault(figure.parent, []).append(figure)
    _hang(root, ROOT, hung)
    _add_contacts(spec, figures)
    _add_tendons(spec, figures)
    _add_sensors(spec, figures)
    for motor in figures.motors:
        _add_motor(spec, motor)
    for joint in figures.locks:
        _add_lock(spec, joint, figures)


def turn(body: mujoco.MjsBody, turn_deg: Vector, *, pos: Vector = (0.0, 0.0, 0.0)) -> None:
    """Put a body at `pos`, rotated by degrees about its own x, then y, then z."""
    quat = np.zeros(4)
    mujoco.mju_euler2Quat(quat, np.radians(turn_deg), "xyz")
    body.pos, body.quat = pos, quat


def _set_options(spec: mujoco.MjSpec, figures: Figures, dense: bool) -> None:
    option = spec.option
    option.timestep = figures.timestep_secs
    option.iterations = figures.iterations
    option.tolerance = figures.tolerance
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_DENSE if dense else mujoco.mjtJacobian.mjJAC_SPARSE
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE
    spec.nuser_actuator = 3
    spec.visual.map.znear, spec.visual.map.zfar = 0.005, 30
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960


def _hang(parent: mujoco.MjsBody, name: str, hung: dict[str, list[BodyFigures]]) -> None:
    for figure in hung.get(name, []):
        body = parent.add_body(name=figure.name, pos=figure.pos, euler=figure.turn_deg)
        for joint in figure.joints:
            _add_joint(body, joint)
        for geom in figure.geoms:
            _add_geom(body, geom)
        sites = dict(figure.sites)
        if figure.torque is not None:
            sites[figure.torque[1]] = (0.0, 0.0, 0.0)
        for site, pos in sites.items():
            body.add_site(name=site, pos=pos, size=[0.01, 0.01, 0.01], group=SENSOR_SITES)
        if (eye := figure.camera) is not None:
            body.add_camera(name=eye.name, pos=eye.pos, euler=eye.turn_deg, fovy=eye.fovy_deg)
        _hang(body, figure.name, hung)


def _add_joint(body: mujoco.MjsBody, figure: JointFigures) -> None:
    joint = body.add_joint(
        name=figure.name,
        type=mujoco.mjtJoint.mjJNT_HINGE,
        pos=figure.pos,
        axis=figure.axis,
        limited=True,
        range=figure.range_deg,
        springref=figure.springref_deg,
        armature=figure.armature,
        frictionloss=figure.frictionloss,
        solimp_limit=figure.limit_softness,
    )
    # Arrays since MuJoCo 4: the first element is the linear part.
    joint.stiffness[0] = figure.stiffness
    joint.damping[0] = figure.damping


def _add_geom(body: mujoco.MjsBody, figure: GeomFigures) -> None:
    body.add_geom(
        name=figure.name,
        type=SHAPES[figure.shape],
        size=figure.size,
        pos=figure.pos,
        euler=figure.turn_deg,
        mass=figure.mass,
        material=figure.look,
        contype=figure.contacts[0],
        conaffinity=figure.contacts[1],
        condim=figure.condim,
        friction=figure.friction,
        solimp=figure.softness,
        solref=figure.stiffness,
    )


def _add_motor(spec: mujoco.MjSpec, figure: MotorFigures) -> None:
    motor = spec.add_actuator(
        name=figure.name,
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        target=figure.joint,
        ctrllimited=True,
        ctrlrange=(-1.0, 1.0),
        forcelimited=True,
        forcerange=figure.strength,
        userdata=figure.muscle,
    )
    motor.gear[0] = figure.torque
    motor.set_to_motor()


def _add_lock(spec: mujoco.MjSpec, joint: str, figures: Figures) -> None:
    """An equality that says 'this angle is what it is': once active, data[0] is the angle to hold."""
    lock = spec.add_equality(
        name=joint,
        type=mujoco.mjtEq.mjEQ_JOINT,
        name1=joint,
        active=False,
        solimp=figures.lock_softness,
    )
    lock.data[:5] = (0, 1, 0, 0, 0)


def _add_contacts(spec: mujoco.MjSpec, figures: Figures) -> None:
    for one, other in figures.frictionless:
        spec.add_pair(geomname1=one, geomname2=other, condim=1)
    for one, other in figures.excludes:
        spec.add_exclude(bodyname1=one, bodyname2=other)


def _add_tendons(spec: mujoco.MjSpec, figures: Figures) -> None:
    for figure in figures.tendons:
        tendon = spec.add_tendon(name=figure.name, limited=True, range=figure.range)
        for joint, weight in figure.weights.items():
            tendon.wrap_joint(joint, weight)


def _add_sensors(spec: mujoco.MjSpec, figures: Figures) -> None:
    site = mujoco.mjtObj.mjOBJ_SITE
    if any("vestibular" in body.sites for body in figures.bodies):
        for name, kind in (
            ("vestibular_acc", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
            ("vestibular_gyro", mujoco.mjtSensor.mjSENS_GYRO),
        ):
            spec.add_sensor(name=name, type=kind, objtype=site, objname="vestibular")
    for sensor, felt_at in figures.torques:
        spec.add_sensor(name=sensor, type=mujoco.mjtSensor.mjSENS_TORQUE, objtype=site, objname=felt_at)
