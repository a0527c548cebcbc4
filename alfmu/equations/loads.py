"""Inertia, potential and efforts of parts declared in the plane."""

import casadi as ca

from ..model.kinematics import Kinematics
from ..model.mechanism import Mechanism
from ..model.parts import AnyJoint, AnyMarker, Body, Scalar, stack, symbolic
from ..model.stops import EndStop


def inertia_of(m: Mechanism, kinematics: Kinematics, pivoted: bool = False) -> tuple[ca.SX, ca.SX]:
    """Return displacements X and their weights W: positions of centres of mass, and angles.

    Natural coordinates and bodies in space have directions instead of angles. With `pivoted`, a body that a hinge on
    the ground places has only its angle, with the inertia about the hinge.
    """
    X: list[Scalar] = []
    w: list[Scalar] = []
    moves = ca.vertcat(*(c.q for c in m.coordinates), m.time)
    for body in m.bodies:
        frame = kinematics.frame(body)
        hinge = body.placed_by if pivoted else None
        if (
            hinge is not None
            and (hinge.kind == "revolute" and hinge.first.body is m.ground)
            and not ca.depends_on(ca.vertcat(*kinematics.place(hinge.first)), moves)
        ):
            arm = (body.center[0] - hinge.second.x) ** 2 + (body.center[1] - hinge.second.y) ** 2
            X.append(frame.angle)
            w.append(body.inertia + body.mass * arm)
            continue
        if not symbolic(body.mass).is_zero():
            X += kinematics.center(body)
            w += [body.mass, body.mass]
        if not symbolic(body.inertia).is_zero():
            # (ex, ey) is linear in natural coordinates, so that the mass matrix is constant.
            X += [frame.ex, frame.ey] if frame.wrapped else [frame.angle]
            w += [body.inertia, body.inertia] if frame.wrapped else [body.inertia]
    blocks = [ca.diag(stack(w))]
    for each in (body for body in m.spatial_bodies if body.own is not None):
        displacements, weights = each.displacements()
        X += ca.vertsplit(displacements)
        blocks.append(weights)
    return stack(X), ca.diagcat(*blocks)


def is_guided(m: Mechanism, body: Body) -> bool:
    """Return whether a joint with the ground prevents rotation of a body."""
    joints = (j for j in m.joints if j.kind in ("prismatic", "weld"))
    return any({j.first.body, j.second.body} == {m.ground, body} for j in joints)


def potential_of(m: Mechanism, kinematics: Kinematics) -> ca.SX:
    """Return potential energy of gravity, springs and the user's terms, without gravity of bodies placed by spatial
    joints."""
    gx, gy, _ = m.gravity_vector
    centers = [kinematics.center(body) for body in m.bodies]
    x, y = (stack([center[k] for center in centers]) for k in (0, 1))
    V = sum(m.potential, ca.SX(0))
    for stop in m.end_stops:
        V += stop.energy(limited_by(kinematics, stop))
    V -= ca.dot(stack([body.mass for body in m.bodies]), gx * x + gy * y)
    for body in (body for body in m.spatial_bodies if body.own is not None):
        V -= body.mass * ca.dot(stack(m.gravity_vector), body.position)
    for spring in m.springs:
        V += spring.stiffness * (elongation_of(kinematics, spring.between) - spring.rest) ** 2 / 2
    return V


def elongation_of(kinematics: Kinematics, between: AnyJoint | tuple[AnyMarker, AnyMarker]) -> ca.SX:
    return kinematics.counted(between) if isinstance(between, AnyJoint) else kinematics.distance(between)


def limited_by(kinematics: Kinematics, stop: EndStop) -> ca.SX:
    """Return the displacement that a stop limits."""
    return stop.of if isinstance(stop.of, ca.SX) else elongation_of(kinematics, stop.of)


def paths_of(m: Mechanism, kinematics: Kinematics) -> list[Scalar]:
    """Return displacements along which the efforts of drives, loads and dampers act, in that order."""
    paths: list[Scalar] = [kinematics.free(drive.joint) for drive in m.drives]
    for load in m.loads:
        paths += [*kinematics.place(load.at), kinematics.frame(load.at.body).angle]
    dampers = (s.between for s in m.springs if not symbolic(s.damping).is_zero())
    paths += [kinematics.free(x) if isinstance(x, AnyJoint) else kinematics.distance(x) for x in dampers]
    return paths + [limited_by(kinematics, stop) for stop in m.end_stops]


def efforts_of(m: Mechanism, kinematics: Kinematics, q: ca.SX, v: ca.SX) -> tuple[ca.SX, ca.SX]:
    """Return the paths of the efforts and the efforts themselves."""
    paths = stack(paths_of(m, kinematics))
    efforts: list[Scalar] = [drive.effort for drive in m.drives]
    for load in m.loads:
        efforts += [*load.force, load.torque]
    rates = ca.jtimes(paths, q, v) if paths.numel() else paths
    dampers = [s for s in m.springs if not symbolic(s.damping).is_zero()]
    efforts += [-s.damping * rates[len(efforts) + i] for i, s in enumerate(dampers)]
    stops = range(len(efforts), len(efforts) + len(m.end_stops))
    efforts += [stop.losses(paths[i], rates[i]) for i, stop in zip(stops, m.end_stops, strict=True)]
    return paths, stack(efforts)
