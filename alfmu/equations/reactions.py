"""Reactions of joints, efforts of locks and motions, and loads that redundant constraints share."""

from collections.abc import Sequence

import casadi as ca
import numpy as np

from ..model.kinematics import FREE, Closing, Kinematics
from ..model.mechanism import Mechanism
from ..model.parts import AnyJoint, AnyMarker, Constraint, Joint, Lock, Motion, Scalar, stack, symbolic
from ..model.relations import Relation
from ..model.spatial import SpatialFreedom, SpatialJoint, SpatialMarker
from .closures import closures_of, slid
from .loads import elongation_of, inertia_of, limited_by, paths_of, potential_of
from .space import Effort
from .sums import FAR
from .types import Row, Variable

_REACTIONS = {
    "x": ("force.x", "N", "force along x on {second} from {first}"),
    "y": ("force.y", "N", "force along y on {second} from {first}"),
    "rotation": ("moment", "N.m", "moment on {second} from {first}, about the joint's point on {second}"),
    "normal": ("force", "N", "force on {second} from {first}, along the left normal of the guide"),
    "length": ("force", "N", "force on {second} from {first}, positive when the joint pushes"),
    f"{FREE} revolute": ("torque", "N.m", "torque that the motion takes, on {second} from {first}"),
    f"{FREE} prismatic": ("driving_force", "N", "force that the motion takes, on {second} from {first}"),
}


def reactions_of(
    m: Mechanism,
    plain: Kinematics,
    held: dict[Joint, tuple[str, ...]],
    q: ca.SX,
    v: ca.SX,
    a: ca.SX,
    efforts: ca.SX,
    lam: ca.SX,
    relations: list[tuple[Relation, dict[str, ca.SX]]],
) -> tuple[list[ca.SX], list[Variable]]:
    """Return the reaction of every joint along every direction it suppresses, on the second body from the first."""
    if not m.joints:
        return [], []
    eps = {j: {k: ca.SX.sym(f"{j.name}.{k}") for k in _suppressed(m, j)} for j in m.joints}
    # A direction closed by a constraint is displaced in the constraint, any other one in the kinematics.
    in_frames = {
        j: {k: e for k, e in eps[j].items() if j.coordinate is not None or k in held.get(j, ())} for j in m.joints
    }
    moved = Kinematics(m, held, in_frames) if any(in_frames.values()) else plain
    Xe, _ = inertia_of(m, moved)
    _, closures, signs = closures_of(m, held)
    displaced = stack([eps[c].get(k, 0.0) if isinstance(c, Joint) and c in eps else 0.0 for c, k in closures])
    Phie = signs * (stack([moved.residual(*c) for c in closures]) - displaced)
    # A row of velocities is displaced along the motion it prevents.
    Phie += signs * stack([slid(each, plain, moved) for each in closures])
    X, W = inertia_of(m, plain)
    aX = ca.jtimes(X, q, a) + ca.jtimes(ca.jtimes(X, q, v), q, v)
    work = (
        ca.dot(Xe, W @ aX)
        + potential_of(m, moved)
        - ca.dot(stack(paths_of(m, moved)), efforts)
        + (ca.dot(Phie, lam) if lam.numel() else 0)
    )
    symbols = stack([e for j in m.joints for e in eps[j].values()])
    r = ca.substitute(ca.gradient(work, symbols), symbols, ca.SX.zeros(symbols.shape))
    which = {each: i for i, each in enumerate((j, direction) for j in m.joints for direction in j.directions)}
    for relation, own in relations:
        for joint, direction, value in relation.idle(plain, own):
            r[which[joint, direction]] += value
    outputs = []
    for joint in m.joints:
        for direction in eps[joint]:
            suffix, unit, text = _REACTIONS[f"{FREE} {joint.kind}" if direction == FREE else direction]
            text = text.format(first=joint.first.body.name, second=joint.second.body.name)
            outputs.append(Variable(f"{joint.name}.{suffix}", unit, description=text))
    return ca.vertsplit(r), outputs


def _suppressed(m: Mechanism, joint: Joint) -> tuple[str, ...]:
    """Return the directions of a joint that have a reaction, including one in which a law replaces a coordinate."""
    law = joint.coordinate if joint.kind in ("revolute", "prismatic") else None
    if (
        isinstance(law, ca.SX)
        and ca.depends_on(law, m.time)
        and not ca.depends_on(law, stack([c.q for c in m.coordinates]))
    ):
        return (*joint.directions, FREE)
    return joint.directions


def lengths_of(m: Mechanism, rows: list[Row]) -> list[int]:
    """Return constraints that keep Euler parameters at unit length."""
    names = {*(body.unit_length for body in m.spatial_bodies), *(joint.unit_length for joint in m.spatial_joints)}
    return [i for i, row in enumerate(rows) if row.name in names]


def carried_by(
    m: Mechanism,
    reactions: Sequence[tuple[ca.SX, Variable]],
    closures: list[Closing],
    lam: ca.SX,
    lengths: Sequence[int],
) -> tuple[ca.SX, ca.SX]:
    """Return forces [N] and moments [N.m] of joints and motions with multipliers of other constraints, and weights of
    their squares.

    The sum is independent of axes and of which joints coordinates close. Forces that separate teeth depend on the
    magnitude of a multiplier and are left out, so all terms are linear.
    """
    found = [(x, o.unit == "N.m") for x, o in reactions if o.unit in ("N", "N.m")]
    for i, (closure, _) in enumerate(closures):
        if isinstance(closure, Constraint | Lock | Motion | Relation) and i not in lengths:
            found.append((lam[i], getattr(closure, "unit", "m") == "rad"))
    carried, turns = stack([x for x, _ in found]), any(turns for _, turns in found)
    of_moments = 1 / square_of_size(m) if turns else ca.SX(1)
    weights = stack([of_moments if turns else 1.0 for _, turns in found])
    if lam.numel() and not ca.is_linear(carried, lam):
        slope, here = (ca.substitute(x, lam, 0 * lam) for x in (ca.jacobian(carried, lam), carried))
        carried = here + slope @ lam
    return carried, weights


_SMALLEST = 1e-30
"""Square of a length [m2] below that of any mechanism."""

_PROBES = 2
"""Number of random parameter values used to find lengths that are always equal."""


def square_of_size(m: Mechanism) -> ca.SX:
    """Return the square [m2] of the longest arm from a centre of mass to a joint, half bar or rod; 1 if there is none.

    It is independent of axes, coordinates and position: bodies are rigid.
    """
    ground = m.ground, m.spatial_ground
    arms = [[body.length / 2] for body in m.bodies if body.length is not None]
    joints: list[Joint | SpatialJoint] = [*m.joints, *m.spatial_joints]
    for joint in joints:
        arms.append([joint.length])
        at_both = (at for at in (joint.first, joint.second) if at.body not in ground)
        arms += [[x - c for x, c in zip(_place(at), at.body.center, strict=True)] for at in at_both]
    squares = [symbolic(sum(symbolic(x) ** 2 for x in arm)) for arm in arms]
    p = stack([x.symbol for x in m.parameters])
    own = {str(x) for x in ca.symvar(p)}
    squares = [x for x in squares if {str(each) for each in ca.symvar(x)} <= own]
    random = np.random.default_rng(0)
    values = ca.Function("squares", [p], [stack(squares)])
    found = np.hstack([values(random.uniform(0.5, 2.0, p.numel())).full() for _ in range(_PROBES)])
    _, first = np.unique(np.round(found / found.max(initial=_SMALLEST), 9), axis=0, return_index=True)
    largest = ca.mmax(stack([squares[i] for i in first])) if squares else ca.SX(0)
    return ca.if_else(largest > 0, largest, 1)


def reach_of(m: Mechanism) -> float:
    """Return the largest coordinate [m] of a point of a joint on the ground, by default parameters."""
    ground = m.ground, m.spatial_ground
    joints: list[Joint | SpatialJoint] = [*m.joints, *m.spatial_joints]
    points = [at for joint in joints for at in (joint.first, joint.second) if at.body in ground]
    places = stack([x for at in points for x in _place(at)])
    p = stack([x.symbol for x in m.parameters])
    own = [x for x in ca.vertsplit(places) if not ca.depends_on(x, m.time)] if places.numel() else []
    value = ca.Function("reach", [p], [ca.norm_inf(stack(own))])
    return float(value([x.default for x in m.parameters]))


def far_of(m: Mechanism, guess: ca.Function) -> float:
    """Return the length [m] from which constants are far from the origin, 0 if no place of the mechanism is.

    `guess` returns the guesses of its coordinates.
    """
    p = [x.default for x in m.parameters]
    size = ca.Function("size", [stack([x.symbol for x in m.parameters])], [ca.sqrt(square_of_size(m))])
    far = FAR * float(size(p))
    begun = guess([*p, *[0.0] * (guess.numel_in(0) - len(p))], [x.value for x in m.starts])
    lengths = [
        abs(x) for x, c in zip(ca.DM(begun).nz[:].full()[:, 0].tolist(), m.coordinates, strict=False) if c.unit == "m"
    ]
    return far if max([reach_of(m), *lengths]) >= far else 0.0


def _place(at: AnyMarker) -> tuple[Scalar, ...]:
    """Return the coordinates of a point in its body's frame."""
    return at.point if isinstance(at, SpatialMarker) else (at.x, at.y)


def spatial_efforts(m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX) -> list[Effort]:
    """Return efforts of drives, springs and stops along joints in space, and between two points there, second from
    first."""
    found: list[Effort] = [
        (drive.joint, symbolic(drive.effort)) for drive in m.drives if not isinstance(drive.joint, Joint)
    ]
    for spring in m.springs:
        if (between := _in_space(spring.between)) is not None:
            path = elongation_of(kinematics, between)
            effort = -spring.stiffness * (path - spring.rest) - spring.damping * ca.jtimes(path, q, v)
            found.append((between, effort))
    for stop in m.end_stops:
        if (of := _in_space(stop.of)) is not None:
            path = limited_by(kinematics, stop)
            found.append((of, stop.effort(path, ca.jtimes(path, q, v))))
    return found


def _in_space(
    of: AnyJoint | tuple[AnyMarker, AnyMarker] | ca.SX,
) -> SpatialJoint | SpatialFreedom | tuple[SpatialMarker, SpatialMarker] | None:
    """Return a joint or two points in space, None for others."""
    if isinstance(of, tuple):
        first, second = of
        return (first, second) if isinstance(first, SpatialMarker) and isinstance(second, SpatialMarker) else None
    return of if isinstance(of, SpatialJoint | SpatialFreedom) else None


def locking(locks: list[Lock | Motion], closures: list[Closing], lam: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Return the effort of each lock, in the direction in which its displacement grows."""
    values, outputs = [], []
    for lock in locks:
        if isinstance(lock, Lock):
            values.append(-lam[closures.index((lock, lock.direction))])
            what, unit = _effort(lock)
            text = f"{what} of the lock of {lock.name}"
            outputs.append(Variable(f"{lock.name}.locking_{what}", unit, description=text))
    return values, outputs


def driving(closures: list[Closing], lam: ca.SX) -> tuple[list[ca.SX], list[Variable]]:
    """Return the effort of each motion, in the direction in which its displacement grows."""
    values, outputs = [], []
    for i, (motion, _) in enumerate(closures):
        if isinstance(motion, Motion):
            values.append(-lam[i])
            what, unit = _effort(motion)
            name = "driving_force" if getattr(motion.of, "kind", "") == "prismatic" else what
            text = f"{what} that the motion of {motion.name} takes"
            outputs.append(Variable(f"{motion.name}.{name}", unit, description=text))
    return values, outputs


def _effort(kept: Lock | Motion) -> tuple[str, str]:
    return ("torque", "N.m") if kept.unit == "rad" else ("force", "N")
