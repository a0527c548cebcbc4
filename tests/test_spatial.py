"""Bodies in space, their joints, springs and drives, against rotations by SciPy, Euler's equations, and the plane."""

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from scenes import evaluate, readings, started
from scipy.spatial.transform import Rotation

import alfmu
from alfmu.model import spatial

INERTIA = (0.03, 0.05, 0.07)
MASS = 1.3
G = 9.81


def quaternion(turn: Rotation) -> list[float]:
    """Euler parameters, the scalar first."""
    *e, e0 = turn.as_quat()
    return [e0, *e]


def rates_of(e: list[float], w: np.ndarray) -> list[float]:
    """Rates of Euler parameters for an angular velocity in ground axes, by the product of quaternions."""
    e0, v = e[0], np.array(e[1:])
    return [-w @ v / 2, *((e0 * w + np.cross(w, v)) / 2)]


def moving(place: np.ndarray, turn: Rotation, speed: np.ndarray, w: np.ndarray) -> tuple[list, list]:
    """Coordinates and velocities of one body."""
    e = quaternion(turn)
    return [*place, *e], [*speed, *rates_of(e, w)]


# The parts ------------------------------------------------------------------------------------------------------------


def test_euler_parameters_are_those_of_quaternions():
    """Rotation matrix, product, turn about an axis and angular velocity, against SciPy and differences."""
    random = np.random.default_rng(0)
    for _ in range(5):
        one, two = Rotation.from_quat(random.normal(size=4)), Rotation.from_quat(random.normal(size=4))
        e, f = ca.SX(quaternion(one)), ca.SX(quaternion(two))
        assert np.array(ca.DM(spatial.rotation(e))) == pytest.approx(one.as_matrix(), abs=1e-15)
        assert np.array(ca.DM(spatial.rotation(spatial.product(e, f)))) == pytest.approx(
            (one * two).as_matrix(), abs=1e-15
        )
        axis = random.normal(size=3)
        axis /= np.linalg.norm(axis)
        turned = np.array(ca.DM(spatial.rotation(spatial.about(tuple(axis), 0.7))))
        assert turned == pytest.approx(Rotation.from_rotvec(0.7 * axis).as_matrix(), abs=1e-15)
        w = random.normal(size=3)
        rate = ca.SX(rates_of(quaternion(one), w))
        assert np.array(ca.DM(spatial.angular_velocity(e, rate))).ravel() == pytest.approx(w, abs=1e-15)


def test_the_triad_of_an_axis_is_right_handed_and_of_unit_length():
    random = np.random.default_rng(1)
    for axis in [(1, 0, 0), (0, -2, 0), (0, 0, 1), *random.normal(size=(5, 3))]:
        triad = np.array(spatial.right_handed(tuple(map(float, axis))))
        assert triad @ triad.T == pytest.approx(np.eye(3), abs=1e-15)
        assert np.linalg.det(triad) == pytest.approx(1.0)
        assert triad[2] * np.linalg.norm(axis) == pytest.approx(np.array(axis), abs=1e-15)


# A body alone ---------------------------------------------------------------------------------------------------------


def thrown() -> alfmu.Mechanism:
    m = alfmu.Mechanism("thrown")
    m.spatial_body("stone", mass=MASS, inertia=INERTIA)
    m.gravity(0.0, 0.0, -G)
    return m


def test_a_thrown_body_turns_by_eulers_equations():
    """1 s of torque-free motion about no principal axis: w in body axes by DOP853, attitude by its quaternion."""
    w = np.array([2.0, 5.0, 1.0])
    J = np.array(INERTIA)

    def right_side(t, y):
        e, w = y[:4], y[4:]
        return [-w @ e[1:] / 2, *((e[0] * w + np.cross(e[1:], w)) / 2), *(np.cross(J * w, w) / J)]

    exact = ode.solved(right_side, (1.0, 0.0, 0.0, 0.0, *w), np.array([0.0, 1.0]))[-1]
    m, errors = thrown(), []
    e = alfmu.derive(m)
    steps = (0.02, 0.01, 0.005)
    for h in steps:
        i = started(e, {"solver.method": "rk4", "solver.step_size": h})
        i.v[:] = [0.3, 0.0, 2.0, *rates_of([1.0, 0.0, 0.0, 0.0], w)]
        i.step(1.0)
        r = readings(i)
        got = [r[f"stone.e{k}"] for k in range(4)]
        errors.append(np.abs(np.array(got) - exact[:4]).max())
        turn = Rotation.from_quat([*exact[1:4], exact[0]])
        spin = [r[f"stone.angular_velocity.{k}"] for k in "xyz"]
        assert spin == pytest.approx(turn.apply(exact[4:]), abs=30 * errors[-1])
        assert [r["stone.x"], r["stone.y"], r["stone.z"]] == pytest.approx([0.3, 0.0, 2.0 - G / 2], abs=1e-13)
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.3)
    assert errors[-1] < 1e-6


# In the plane ---------------------------------------------------------------------------------------------------------


def double_pendulum(space: bool) -> alfmu.Mechanism:
    """Two bars on hinges about z, a torsional spring-damper in the second one, in absolute coordinates."""
    m = alfmu.Mechanism("double_pendulum")
    bodies = []
    for name in ("one", "two"):
        if space:
            body = m.spatial_body(name, mass=MASS, inertia=(0.01, 0.1, 0.1), center=(0.5, 0, 0))
        else:
            pose = tuple(m.coordinate(f"{name}_{k}", u) for k, u in (("x", "m"), ("y", "m"), ("a", "rad")))
            body = m.body(name, mass=MASS, inertia=0.1, center=(0.5, 0.0), pose=pose)
        bodies.append(body)
    one, two = bodies
    ends = ((m.spatial_ground if space else m.ground).at(0.1, 0.2), one.at()), (one.at(1.0, 0.1), two.at())
    hinge = (lambda name, *on: m.spatial_revolute(name, *on, axis=(0, 0, 1))) if space else m.revolute
    m.drive(hinge("A", *ends[0]), m.input("A.torque", "N.m"))
    m.spring_damper(hinge("B", *ends[1]), stiffness=7.0, damping=0.5, rest=0.3)
    m.gravity(0.0, -G)
    return m


def test_a_mechanism_in_a_plane_of_space_is_the_planar_one():
    """Accelerations, joint forces and energies of a double pendulum declared in the plane and in space."""
    a, b, wa, wb = 0.4, 1.3, 2.0, -1.0

    def along(angle, w, x, y):
        c, s = np.cos(angle), np.sin(angle)
        place = np.array([c * x - s * y, s * x + c * y])
        return place, w * np.array([-place[1], place[0]])

    (r1, v1), (tip, tip_v), (half, half_v) = along(a, wa, 0.5, 0), along(a, wa, 1.0, 0.1), along(b, wb, 0.5, 0)
    foot = np.array([0.1, 0.2])
    places = [foot + r1, foot + tip + half]
    speeds = [v1, tip_v + half_v]
    flat = alfmu.derive(double_pendulum(False))
    deep = alfmu.derive(double_pendulum(True))
    q = [x for r, angle in zip(places, (a, b), strict=True) for x in (*r, angle)]
    v = [x for r, w in zip(speeds, (wa, wb), strict=True) for x in (*r, w)]
    want = evaluate(flat, q, v, [2.5])
    moved = [
        moving([*r, 0.0], Rotation.from_rotvec([0, 0, angle]), [*s, 0.0], np.array([0, 0, w]))
        for r, angle, s, w in zip(places, (a, b), speeds, (wa, wb), strict=True)
    ]
    q3, v3 = ([x for pair in moved for x in pair[k]] for k in (0, 1))
    got = evaluate(deep, q3, v3, [2.5])
    for body in ("one", "two"):
        assert got[f"{body}.angular_acceleration.z"] == pytest.approx(want[f"{body}.angular_acceleration"], rel=1e-12)
        assert got[f"{body}.ax"] == pytest.approx(want[f"{body}.ax"], rel=1e-12)
    for joint in "AB":
        for axis in "xy":
            assert got[f"{joint}.force.{axis}"] == pytest.approx(want[f"{joint}.force.{axis}"], rel=1e-12)
        assert got[f"{joint}.force.z"] == 0.0
    p = np.zeros(0)
    for quantity, flat_at, deep_at in (
        ("kinetic_energy", (q, v, p), (q3, v3, p)),
        ("potential_energy", (q, p), (q3, p)),
    ):
        energy = float(getattr(flat, quantity)(*flat_at))
        assert float(getattr(deep, quantity)(*deep_at)) == pytest.approx(energy, rel=1e-13)


# What is refused ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (
            "body(1.0, 1.0, m.parameter('k', 3.0))",
            r"odd: no body has the principal moments of inertia \[1.0, 1.0, 3.0\] that plate is given",
        ),
        ("body(1.0, 1.0)", "give three"),
        ("body(m.time, 1.0, 1.0)", "expression in parameters"),
        ("m.spherical('J', m.ground.at(), plate().at())", "J joins bodies in space"),
        ("m.spherical('J', plate().at(), ground)", "ends on the ground"),
        ("m.spherical('J', *[plate().at()] * 2)", "connects plate to itself"),
        ("m.spherical('J', plate(other).at(), plate().at())", "a body of another mechanism"),
        ("m.spatial_revolute('J', ground, plate().at(), axis=(0, 0, 0))", "no direction"),
        ("m.drive(m.spherical('J', ground, plate().at()), 1.0)", "J is a spherical"),
        ("m.spring_damper((m.ground.at(), plate().at()), stiffness=1.0)", "a point in the plane to one in space"),
        ("body([1, 0.1, 0], [0.2, 1, 0], [0, 0, 1])", r"not symmetric: 0.1 stands at \(1, 2\)"),
        ("plate(inertia=np.diag([1.0, 1.0, 2.5]))", r"moments of inertia \[1.0, 1.0, 2.5\] .* by its matrix"),
        ("body([1, 1.1, 0], [1.1, 1, 0], [0, 0, 1])", r"moments of inertia \[-0.1, 1.0, 2.1\]"),
        ("body([1, 0], [0, 1], [0, 0])", "a row of the inertia of plate is 2 numbers; give three"),
        ("plate(inertia=np.array(5.0))", "the inertia of plate is a ndarray; give three"),
        ("m.torque(plate(), 1.0)", "the torque on plate, a body in space, is 1.0; give three"),
        ("m.force(flat.at(), 0.0, 0.0, 1.0)", "flat, a body in the plane, has a part along z"),
        ("link().position", "nothing places link yet"),
        ("[plate(), link(), derive(m)]", r"nothing places link \(.*test_spatial.py, line \d+\)"),
        ("link(position=(1.0, 0, 0))", "link is relative and has a position"),
        (
            "m.spatial_prismatic('J', ground, plate().at(), axis=x, coordinate=0.0)",
            "plate has seven coordinates of its own; declare the body with relative=True",
        ),
        (
            "m.spatial_prismatic('J', link().at(), link('two').at(), axis=x, coordinate=0)",
            "J places two on link, which nothing places yet",
        ),
        ("m.clutch('c', m.spatial_ground, plate())", "clutch c couples bodies in the plane, and ground is"),
        (
            "[m.spatial_revolute(name, ground, one.at(), axis=x, coordinate=th) for one in [link()] for name in 'JK']",
            "joint K has a coordinate, but link has its place by J; leave",
        ),
        (
            "m.cylindrical('J', ground, link().at(), axis=x, coordinates=[0.0])",
            r"the coordinates of J, a cylindrical joint, are 1 numbers; give 2 \[rad, m\]",
        ),
        (
            "m.universal('J', ground, plate().at(), axis=x, second_axis=(1, 1, 0))",
            "make an angle of 45 degrees; those of a universal joint are perpendicular",
        ),
        (
            "m.spatial_screw('J', ground, plate().at(), axis=x, lead=0)",
            "the lead of J is zero; take spatial_revolute",
        ),
        (
            "m.lock(m.cylindrical('J', ground, plate().at(), axis=x))",
            r'J is a cylindrical joint, which has several free motions; take J.freedom\("angle"\) or J',
        ),
        (
            "m.universal('J', ground, plate().at(), axis=x, second_axis=(0, 1, 0)).freedom('angle')",
            "J, a universal joint, has no free motion 'angle'; it has angle1 or angle2",
        ),
    ],
)
def test_a_declaration_in_space_that_makes_no_sense_says_why(line, says):
    m, other = alfmu.Mechanism("odd"), alfmu.Mechanism("other")

    def plate(m=m, inertia=INERTIA):
        return m.spatial_body("plate", mass=1.0, inertia=inertia)

    def link(name="link", **more):
        return m.spatial_body(name, mass=1.0, inertia=INERTIA, relative=True, **more)

    names = {"m": m, "other": other, "plate": plate, "link": link, "body": lambda *rows: plate(inertia=rows)}
    names |= {"ground": m.spatial_ground.at(), "x": (1, 0, 0), "np": np, "derive": alfmu.derive}
    names |= {"flat": m.body("flat", mass=1.0), "th": m.coordinate("th", "rad")}
    with pytest.raises(alfmu.DeclarationError, match=says):
        eval(line, names)
