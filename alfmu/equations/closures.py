"""Constraint rows: the directions of joints that they close, their order, and the rows that can be switched."""

import casadi as ca

from ..model.errors import DeclarationError
from ..model.kinematics import Closing, Kinematics, same
from ..model.mechanism import Mechanism
from ..model.parts import Body, Constraint, Friction, Joint, Lock, Motion, key_of, stack
from ..model.relations import Relation
from ..model.spatial import SpatialJoint
from .types import Row, Switch, Variable


def held_by(m: Mechanism, kinematics: Kinematics) -> dict[Joint, tuple[str, ...]]:
    """Return, by joint, the directions that the choice of coordinates closes, so that they need no constraint.

    Their residual is identically zero, as for two natural bars that share a point, or a slider without an angle.
    """
    coordinates = {key_of(c.q) for c in m.coordinates}
    held: dict[Joint, tuple[str, ...]] = {}
    for closure in m.closures:
        if isinstance(closure, Relation):
            slips = [closure.slip(kinematics, direction) for direction in closure.directions]
            rows = stack(
                [x for each in slips for _, x in each or ()]
                + [kinematics.residual(closure, k) for k in closure.directions]
            )
            if not any(key_of(symbol) in coordinates for symbol in ca.symvar(rows)):
                raise DeclarationError(
                    f"{m.name}: no coordinate moves the bodies of {closure.kind} {closure.name}"
                    f"{m.declared_at(closure.name)}; give their hinges coordinates"
                )
        if not isinstance(closure, Joint):
            continue
        zero = []
        for direction in closure.directions:
            residual = kinematics.residual(closure, direction)
            if residual.is_zero():
                zero.append(direction)
            elif not any(key_of(symbol) in coordinates for symbol in ca.symvar(residual)):
                raise DeclarationError(
                    f"{m.name}: joint {closure.name} leaves a gap of {residual} along {direction} that no coordinate "
                    f"can close; check its markers, offset and angle{m.declared_at(closure.name)}"
                )
        if zero:
            held[closure] = tuple(zero)
    _check_held(m, held)
    return held


def _check_held(m: Mechanism, held: dict[Joint, tuple[str, ...]]) -> None:
    """Check that joints closed by the coordinates of one body do not disturb each other in virtual displacements."""
    eps = {j: {k: ca.SX.sym(f"{j.name}.{k}") for k in directions} for j, directions in held.items()}
    by_body: dict[Body, list[Joint]] = {}
    for joint in held:
        by_body.setdefault(joint.second.body, []).append(joint)
    for body, joints in by_body.items():
        if body.between is not None:
            for joint in joints:
                ends = (body.start, body.end)
                if not any(same(joint.second.x, e.x) and same(joint.second.y, e.y) for e in ends):
                    raise DeclarationError(
                        f"{m.name}: joint {joint.name} is closed by the points of {body.name} but is not at one of its "
                        "ends; place the body between other points"
                    )
            continue
        for joint in joints:
            moved = Kinematics(m, {joint: held[joint]}, {joint: eps[joint]})
            for other in joints:
                if other is joint:
                    continue
                symbols = stack(list(eps[joint].values()))
                for direction in held[other]:
                    if ca.depends_on(moved.residual(other, direction), symbols):
                        slope = ca.jacobian(moved.residual(other, direction), symbols)
                        if not ca.substitute(slope, symbols, ca.SX.zeros(symbols.shape)).is_zero():
                            raise DeclarationError(
                                f"{m.name}: the coordinates of {body.name} close both {joint.name} and {other.name}; "
                                "their reactions cannot be told apart; put both at one point of the body, or give "
                                "the body an angle coordinate"
                            )


def closures_of(m: Mechanism, held: dict[Joint, tuple[str, ...]]) -> tuple[list[Row], list[Closing], ca.SX]:
    """Return constraint rows in the order of declaration, the closing of each, and the sign of its residual.

    A row is the second body's point minus the first's, reversed if only the first body is cut free (has absolute
    coordinates): this is the sign of the paper's five-bar.
    """
    rows: list[Row] = []
    closures: list[Closing] = []
    signs: list[float] = []
    for closure in m.closures:
        sign = 1.0
        directions: tuple[str, ...] = ("length",)
        if isinstance(closure, Constraint):
            directions = ("",)
        elif isinstance(closure, Lock | Motion):
            directions = (closure.direction,)
        elif isinstance(closure, SpatialJoint | Relation):
            directions = closure.directions
        elif isinstance(closure, Joint):
            directions = tuple(k for k in closure.directions if k not in held.get(closure, ()))
            first, second = closure.first.body, closure.second.body
            if first.pose is not None and second.pose is None and first is not m.ground:
                sign = -1.0
        for direction in directions:
            turning = direction.startswith("rotation")
            unit = "rad" if turning else "m"
            if isinstance(closure, Constraint | Lock | Motion | Relation):
                unit = closure.unit
            # The axes of bodies have any direction, so the coefficients would not show the unit.
            rows.append(Row(closure.name, direction, unit, float(isinstance(closure, SpatialJoint))))
            closures.append((closure, direction))
            signs.append(sign)
    return rows, closures, stack(signs)


def slips_of(kinematics: Kinematics, closures: list[Closing], q: ca.SX, v: ca.SX, own: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return velocities that nonholonomic rows keep at zero (zero in other rows), and their rows of C by the rates
    `own`."""
    rows = []
    for closure, direction in closures:
        slip = closure.slip(kinematics, direction) if isinstance(closure, Relation) else None
        rows.append(sum((ca.jtimes(x, q, v) * n for n, x in slip or ()), ca.SX(0)))
    slips = stack(rows)
    return slips, ca.jacobian(slips, own)


def slid(closing: Closing, plain: Kinematics, moved: Kinematics) -> ca.SX:
    """Return the virtual displacement of a row of velocities, up to a constant."""
    closure, direction = closing
    if not isinstance(closure, Relation) or (at_rest := closure.slip(plain, direction)) is None:
        return ca.SX(0)
    displaced = [x for _, x in closure.slip(moved, direction) or ()]
    return sum((n * x for (n, _), x in zip(at_rest, displaced, strict=True)), ca.SX(0))


def relations_of(m: Mechanism, closures: list[Closing], lam: ca.SX) -> list[tuple[Relation, dict[str, ca.SX]]]:
    """Return each relation with its multipliers by direction."""
    return [
        (each, {direction: lam[i] for i, (closure, direction) in enumerate(closures) if closure is each})
        for each in m.relations()
    ]


def compliances_of(rows: list[Row]) -> list[Variable]:
    units = {"m": "m/N", "rad": "rad/(N.m)"}
    return [
        Variable(
            f"{row.name}.compliance.{row.direction}".removesuffix("."),
            units.get(row.unit, "1"),
            minimum=0.0,
            description=f"compliance of {row.text}" + ", for shares of redundant constraints",
        )
        for row in rows
    ]


def switches_of(m: Mechanism, locks: list[Lock | Motion], closures: list[Closing]) -> list[Switch]:
    """Return Boolean inputs, locks first, each kind in the order of declaration."""
    switches = []
    for i, lock in enumerate(locks):
        if isinstance(lock, Friction):
            continue
        moving = isinstance(lock, Motion)
        name, text = ("driven", "switch on {}: the motion") if moving else ("locked", "stop the motion")
        row = closures.index((lock, lock.direction))
        text = f"{text.format('the law')} of {lock.name}"
        switches.append(Switch(f"{lock.name}.{name}", [row], True, i, description=text))
    for closure in m.releases:
        rows = [i for i, (each, _) in enumerate(closures) if each is closure]
        if not rows:
            raise DeclarationError(
                f"{m.name}: {closure.name} holds by the choice of coordinates, so it cannot be released; use "
                "coordinates in which constraints close it"
            )
        switches.append(Switch(f"{closure.name}.released", rows, False, description=f"switch {closure.name} off"))
    return switches
