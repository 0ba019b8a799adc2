"""The regions of a table (trunk, arm, hand, ...) worked out into the figures of the whole body."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeVar

from babble.patterns import nearest
from babble.worlds.mimo.anatomy import BodyFigures, Figures, LookFigures, MotorFigures, TendonFigures
from babble.worlds.mimo.segments import ORIGIN, limb, plus, segment
from babble.worlds.mimo.tables import Table, Vector

ROOT = "mimo_location"
"""The body by which the whole infant is placed in the world."""

Listed = TypeVar("Listed", BodyFigures, MotorFigures)
Pairs = tuple[tuple[str, str], ...]
Place = tuple[str, str, bool]
"""A region, a side, and whether the region is written for the other side."""
SHARED = ("settings", "contacts", "locks", "looks", "order", "joint", "geom")
"""The tables that are no region."""


@dataclass(frozen=True)
class _Part:
    """What one region gives on one side."""

    bodies: tuple[BodyFigures, ...]
    motors: tuple[MotorFigures, ...]
    tendons: tuple[TendonFigures, ...]
    torques: Pairs
    locks: tuple[str, ...]


@dataclass
class _Reader:
    """Reads regions one after the other; knows what those before had."""

    joint: Table
    geom: Table
    looks: Mapping[str, LookFigures]
    ends: dict[str, Vector] = field(default_factory=lambda: {ROOT: ORIGIN})
    """far ends of bodies"""
    joints: set[str] = field(default_factory=set)

    def part(self, region: Table, side: str, mirrored: bool) -> _Part:
        region = region.on_side(side, mirrored)
        prefix = f"{side}_" if side else ""
        region.texts("sides", ())
        orders = {own: region.texts(f"order_{own}", ()) for own in ("left", "right")}
        sensors = region.texts("torques", ())
        motors, tendons = region.table("motors"), region.table("tendons")
        joint = region.table("joint").over(self.joint)
        geom = region.table("geom").over(self.geom)
        bodies = tuple(
            self._body(entry.on_side(side, mirrored), key, prefix, joint, geom)
            for key, entry in region.tables()
        )
        order = orders.get(side, ())
        return _Part(
            bodies=_reordered(bodies, prefix, order),
            motors=_reordered(
                tuple(self._motor(row.on_side(side, mirrored), key, prefix) for key, row in motors.tables()),
                f"act:{prefix}",
                order,
            ),
            tendons=tuple(self._tendon(row, key, prefix) for key, row in tendons.tables()),
            torques=_torques(bodies, [f"proprio:{prefix}{sensor}" for sensor in sensors], region),
            locks=tuple(joint.name for body in bodies for joint in body.joints if joint.lock),
        )

    def _body(self, entry: Table, key: str, prefix: str, joint: Table, geom: Table) -> BodyFigures:
        parent = entry.text("parent")
        names = [name for name in (f"{prefix}{parent}", parent) if name in self.ends]
        if not names:
            raise entry.error("parent", f"is {parent!r}, but no such body comes before it")
        body = segment(entry, f"{prefix}{key}", names[0], self.ends[names[0]], joint, geom, prefix)
        for flesh in body.geoms:
            if flesh.look not in self.looks:
                raise entry.error("geoms", f"look like {flesh.look!r}; looks are {', '.join(self.looks)}")
        entry.close()
        self.ends[body.name] = limb(entry).end
        self.joints.update(joint.name for joint in body.joints)
        return body

    def _motor(self, row: Table, key: str, prefix: str) -> MotorFigures:
        weak, strong = row.ordered("strength", (-1.0, 1.0))
        motor = MotorFigures(
            name=f"act:{prefix}{key}",
            joint=self._joint_named(f"robot:{prefix}{row.text('joint', key)}", row, "joint"),
            torque=row.number("torque", least=0),
            strength=(weak, strong),
            muscle=row.numbers("muscle", 3),
        )
        row.close()
        return motor

    def _tendon(self, row: Table, key: str, prefix: str) -> TendonFigures:
        joints = row.table("joints")
        weights = {
            self._joint_named(f"robot:{prefix}{joint}", row, "joints"): joints.number(joint)
            for joint in joints.keys
        }
        tendon = TendonFigures(f"{prefix}{key}", weights, row.ordered("range"))
        row.close()
        return tendon

    def _joint_named(self, name: str, row: Table, key: str) -> str:
        if name not in self.joints:
            known = nearest(sorted(self.joints), name, "joint")
            raise row.error(key, f"names {name!r}, which is no joint; {known}")
        return name


def resolve(table: Table) -> Figures:
    """The figures that the merged tables state. Raises `FiguresError`."""
    shared = {name: table.table(name) for name in SHARED}
    regions = {key: region for key, region in table.tables() if key not in SHARED}
    settings, contacts, order = shared["settings"], shared["contacts"], shared["order"]
    looks = {key: _look(row) for key, row in shared["looks"].tables()}
    reader = _Reader(shared["joint"], shared["geom"], looks)
    motors_order = _groups(order, "motors", regions)
    torques_order = _groups(order, "torques", regions)
    parts = {place: reader.part(regions[place[0]], *place[1:]) for place in _places(motors_order, regions)}
    chest = settings.flag("chest")
    if not chest:
        parts = _without_chest(parts)
    listed = list(parts.values())
    bodies = tuple(body for part in listed for body in part.bodies)
    figures = Figures(
        bodies=bodies,
        motors=tuple(motor for part in listed for motor in part.motors),
        tendons=tuple(tendon for part in listed for tendon in part.tendons),
        locks=tuple(lock for part in listed for lock in part.locks),
        torques=tuple(row for place in _places(torques_order, regions) for row in parts[place].torques),
        frictionless=_pairs(contacts, "frictionless", {g.name for body in bodies for g in body.geoms} - {""}),
        excludes=_pairs(contacts, "exclude", set(reader.ends), without="" if chest else "chest"),
        looks=looks,
        lock_softness=shared["locks"].numbers("softness", 5),
        timestep_secs=settings.positive("timestep"),
        iterations=int(settings.positive("iterations")),
        tolerance=settings.positive("tolerance"),
    )
    for entry in (settings, contacts, order, shared["locks"]):
        entry.close()
    return figures


def _places(groups: Sequence[Sequence[str]], regions: Mapping[str, Table]) -> Iterator[Place]:
    """The regions in the order of the lists: all of a group for its first side, then all for the other."""
    for group in groups:
        sides = regions[group[0]].texts("sides", ()) or ("",)
        for nth, side in enumerate(sides):
            for region in group:
                yield region, side, nth > 0


def _groups(order: Table, key: str, regions: Mapping[str, Table]) -> tuple[tuple[str, ...], ...]:
    groups = order.nested(key)
    named = [region for group in groups for region in group]
    for region, table in regions.items():
        if named.count(region) != 1:
            raise table.error("", f"is no region that order.{key} names once; it names {', '.join(named)}")
    if unknown := [region for region in named if region not in regions]:
        raise order.error(key, f"names {unknown[0]!r}, which is no region")
    for group in groups:
        sides = {regions[region].texts("sides", ()) for region in group}
        if len(sides) > 1 or not sides <= {(), ("left", "right"), ("right", "left")}:
            raise regions[group[0]].error(
                "sides", "must be left and right, the same in all regions of a group"
            )
    return groups


def _without_chest(parts: Mapping[Place, _Part]) -> dict[Place, _Part]:
    """Give the chest's flesh and what hangs on it to the body below, and drop its joints."""
    [chest] = parts["chest", "", False].bodies

    def fused(body: BodyFigures) -> BodyFigures:
        if body.name == chest.parent:
            moved = tuple(replace(geom, pos=plus(geom.pos, chest.pos)) for geom in chest.geoms)
            return replace(body, geoms=body.geoms + moved)
        if body.parent == chest.name:
            return replace(body, parent=chest.parent, pos=plus(body.pos, chest.pos))
        return body

    rest = {place: replace(part, bodies=tuple(map(fused, part.bodies))) for place, part in parts.items()}
    rest["chest", "", False] = _Part((), (), (), (), ())
    return rest


def _torques(bodies: Sequence[BodyFigures], order: Sequence[str], region: Table) -> Pairs:
    """(sensor, site) of the bodies, in the order given or that of the bodies."""
    sites = dict(body.torque for body in bodies if body.torque is not None)
    if order and sorted(order) != sorted(sites):
        raise region.error("torques", f"must list the torque sensors of the region: {', '.join(sites)}")
    return tuple((sensor, sites[sensor]) for sensor in order or sites)


def _reordered(rows: tuple[Listed, ...], prefix: str, order: Sequence[str]) -> tuple[Listed, ...]:
    """The rows with those named in `order` put in that order, in the places that they hold together."""
    named = {row.name: row for row in rows if row.name.removeprefix(prefix) in order}
    turn = iter([f"{prefix}{key}" for key in order if f"{prefix}{key}" in named])
    return tuple(named[next(turn)] if row.name in named else row for row in rows)


def _look(row: Table) -> LookFigures:
    look = LookFigures(row.numbers("rgba", 4), row.number("specular", 0.0), row.number("shininess", 0.0))
    row.close()
    return look


def _pairs(contacts: Table, key: str, known: set[str], *, without: str = "") -> Pairs:
    pairs = []
    for pair in contacts.nested(key):
        unknown = [name for name in pair if name not in known]
        if len(pair) != 2 or unknown:
            raise contacts.error(key, f"must be pairs of known names, got {list(pair)}")
        if without not in pair:
            pairs.append((pair[0], pair[1]))
    return tuple(pairs)
