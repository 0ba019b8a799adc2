"""One body of a table worked out for one side: where it hangs, and the places of its joints and flesh.

A segment runs from its own origin to its far end, `length` away `along` an axis; what is said relative to
the far end moves with it. Derived numbers are rounded to a nanometre, so that they equal the decimals of the
published model bit for bit.
"""

from dataclasses import dataclass

from babble.worlds.mimo.anatomy import BodyFigures, CameraFigures, GeomFigures, JointFigures
from babble.worlds.mimo.tables import Table, Vector

ORIGIN: Vector = (0.0, 0.0, 0.0)
LYING: dict[str, Vector] = {"x": (0.0, 90.0, 0.0), "y": (90.0, 0.0, 0.0), "z": ORIGIN}
"""The rotation that lays a capsule or cylinder, upright by itself, along an axis (degrees)."""


@dataclass(frozen=True)
class Limb:
    """How far a segment reaches and which way."""

    entry: Table
    length: float
    axis: int
    sign: float

    def at(self, distance: float) -> Vector:
        """The point that far from the origin along the limb."""
        point = [0.0, 0.0, 0.0]
        point[self.axis] = self.sign * distance
        return point[0], point[1], point[2]

    @property
    def end(self) -> Vector:
        """The far end."""
        return self.at(self.length)


def limb(entry: Table) -> Limb:
    """Reads `length` and `along` of a body."""
    along = entry.text("along", "+z", among=("+x", "-x", "+y", "-y", "+z", "-z"))
    axis = "xyz".index(along[1])
    sign = (1.0 if along[0] == "+" else -1.0) * (-1.0 if entry.mirrored and axis == 1 else 1.0)
    return Limb(entry, entry.number("length", 0.0, least=0.0), axis, sign)


def plus(a: Vector, b: Vector) -> Vector:
    """a + b, rounded to a nanometre."""
    return round(a[0] + b[0], 9), round(a[1] + b[1], 9), round(a[2] + b[2], 9)


def segment(
    entry: Table, name: str, parent: str, parent_end: Vector, joints: Table, geoms: Table, prefix: str
) -> BodyFigures:
    """The body `name`, hanging on `parent`, whose far end is given.

    joints, geoms: what its own joints and flesh take where they say nothing.
    """
    beyond = plus(parent_end, entry.place("beyond", ORIGIN))
    pos = entry.place("pos") if "pos" in entry else beyond
    own = limb(entry)
    side = (entry.side, entry.mirrored)
    joint_defaults, geom_defaults = entry.table("joint"), entry.table("geom")
    return BodyFigures(
        name=name,
        parent=parent,
        pos=pos,
        turn_deg=entry.turning("turn", ORIGIN),
        joints=tuple(
            _joint(row.on_side(*side).over(joints, joint_defaults), f"robot:{prefix}{key}")
            for key, row in entry.table("joints").tables()
        ),
        geoms=tuple(
            _geom(row.on_side(*side).over(geoms, geom_defaults), prefix, own)
            for _, row in entry.table("geoms").tables()
        ),
        sites=_sites(entry.table("sites")),
        torque=_torque(entry, prefix),
        camera=_camera(entry),
    )


def _joint(entry: Table, name: str) -> JointFigures:
    joint = JointFigures(
        name=name,
        axis=entry.turning("axis"),
        pos=entry.place("pos"),
        range_deg=entry.ordered("range"),
        springref_deg=entry.number("springref"),
        stiffness=entry.number("stiffness", least=0),
        damping=entry.number("damping", least=0),
        frictionloss=entry.number("friction", least=0),
        armature=entry.number("armature", least=0),
        limit_softness=entry.numbers("limit_softness", 5),
        lock=entry.flag("lock", True),
    )
    if joint.axis == ORIGIN:
        raise entry.error("axis", "must point somewhere, got [0, 0, 0]")
    entry.close()
    return joint


def _geom(entry: Table, prefix: str, own: Limb) -> GeomFigures:
    shape = entry.text("shape", among=("sphere", "capsule", "cylinder", "box"))
    name = entry.text("name", "")
    mask, others = (int(bits) for bits in entry.numbers("contacts", 2))
    geom = GeomFigures(
        name=f"{prefix}{name}" if name else "",
        shape=shape,
        size=_size(entry, shape, own),
        pos=_middle(entry, own),
        turn_deg=LYING[_lying(entry, shape, own)],
        mass=entry.positive("mass"),
        look=entry.text("look"),
        contacts=(mask, others),
        condim=int(entry.number("condim")),
        friction=entry.numbers("friction", 3),
        softness=entry.numbers("softness", 5),
        stiffness=entry.numbers("stiffness", 2),
    )
    sizes = geom.size[: {"sphere": 1, "box": 3}.get(shape, 2)]
    if min(sizes) <= 0:
        raise entry.error("", f"leaves a {shape} of half sizes {list(sizes)}, all of which must be above 0")
    if geom.condim not in (1, 3, 4, 6):
        raise entry.error("condim", f"must be 1, 3, 4 or 6, got {geom.condim}")
    entry.close()
    return geom


def _size(entry: Table, shape: str, own: Limb) -> Vector:
    """MuJoCo's size: half sizes of a box, radius and half length of a capsule."""
    if shape == "sphere":
        return entry.number("radius"), 0.0, 0.0
    if "span" not in entry:
        if shape == "box":
            x, y, z = entry.numbers("half", 3)
            return x, y, z
        return entry.number("radius"), entry.number("half"), 0.0
    past, short = entry.numbers("span", 2)
    half = round((own.length - past - short) / 2, 9)
    if half <= 0:
        raise own.entry.error(
            "length", f"is {own.length:g}, too short for flesh that spans [{past:g}, {short:g}]"
        )
    if shape != "box":
        return entry.number("radius"), half, 0.0
    sizes = list(entry.numbers("half", 2))
    sizes.insert(own.axis, half)
    return sizes[0], sizes[1], sizes[2]


def _middle(entry: Table, own: Limb) -> Vector:
    if "span" in entry:
        past, short = entry.numbers("span", 2)
        return plus(own.at((past + own.length - short) / 2), entry.place("offset", ORIGIN))
    if "end" in entry:
        return plus(own.end, entry.place("end"))
    return entry.place("pos")


def _lying(entry: Table, shape: str, own: Limb) -> str:
    if shape in ("sphere", "box"):
        return "z"
    return "xyz"[own.axis] if "span" in entry else entry.text("lie", "z", among=("x", "y", "z"))


def _torque(entry: Table, prefix: str) -> tuple[str, str] | None:
    if "torque" not in entry:
        return None
    sensor = entry.text("torque")
    return f"proprio:{prefix}{sensor}", f"torque_{prefix}{entry.text('torque_site', sensor)}"


def _sites(entry: Table) -> dict[str, Vector]:
    return {key: entry.place(key) for key in entry.keys}


def _camera(entry: Table) -> CameraFigures | None:
    present, entry = "camera" in entry, entry.table("camera")
    if not present:
        return None
    camera = CameraFigures(
        name=entry.text("name").replace("{side}", entry.side),
        pos=entry.place("pos"),
        turn_deg=entry.numbers("turn", 3),  # type: ignore[arg-type]
        fovy_deg=entry.positive("fovy"),
    )
    entry.close()
    return camera
