"""Linkages in relative coordinates, each against a method of another kind: closed loops in space and a gyroscope."""

from functools import cache
from itertools import pairwise

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from oracles.free_body import SpatialBalance
from scenes import derived, evaluate
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

import alfmu
from alfmu.fmi.checks.validation import validate
from alfmu.fmi.drive import Fmu
from alfmu.runtime.probe import Probe
from alfmu.simulation import run

G = 9.81
RK4 = {"solver.method": "rk4", "solver.step_size": 0.005}


def rotated(axis: ca.SX, angle: ca.SX, x: ca.SX) -> ca.SX:
    """A vector turned about an axis of unit length (Rodrigues)."""
    return x * ca.cos(angle) + ca.cross(axis, x) * ca.sin(angle) + axis * ca.dot(axis, x) * (1 - ca.cos(angle))


def rods(points: list[ca.SX], x: ca.SX, w: ca.SX, mass: float) -> ca.SX:
    """Kinetic energy of thin uniform rods, by the velocities of their ends alone."""
    speeds = [ca.jtimes(point, x, w) for point in points]
    return sum(mass / 6 * (ca.sumsqr(a) + ca.dot(a, b) + ca.sumsqr(b)) for a, b in pairwise(speeds))


def one_freedom(kinetic: ca.SX, potential: ca.SX, x: ca.SX, w: ca.SX, effort: float = 0.0) -> ca.Function:
    """Acceleration of the one equation that Lagrange gives."""
    inertia = ca.hessian(kinetic, w)[0]
    force = effort - ca.gradient(potential, x) - ca.gradient(inertia, x) * w**2 / 2
    return ca.Function("acceleration", [x, w], [force / inertia])


def motion(acceleration: ca.Function, x: float, w: float, times: np.ndarray) -> np.ndarray:
    return ode.motion(lambda t, x, v: float(acceleration(x, v)), x, w, times)[:, 0]


# Bricard's linkage ----------------------------------------------------------------------------------------------------

EDGES = np.array([(1, 0, 0), (0, 1, 0), (0, 0, 1), (-1, 0, 0), (0, -1, 0)], float)
"""Five rods along edges of a cube, the sixth edge being the ground."""

HINGES = [(0, 1, 0), (0, 0, 1), (1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 0, 0)]
"""Axes of the hinges at their ends where the rods stand along the edges."""


def bricard() -> alfmu.Mechanism:
    """Six hinges in a loop, each square to the next, five rods of 1 m and 1 kg."""
    m = alfmu.Mechanism("bricard", experiment=alfmu.Experiment(1.0, 0.005))
    m.gravity(0, 0, -G)
    before = m.spatial_ground.at()
    for i, (edge, axis) in enumerate(zip(EDGES, HINGES, strict=False), 1):
        th = m.coordinate(f"th{i}", "rad", independent=i == 1, rate=1.0 if i == 1 else 0.0)
        inertia = tuple((1 - np.abs(edge)) / 12)
        rod = m.spatial_body(f"rod{i}", mass=1.0, inertia=inertia, center=tuple(edge / 2), relative=True)
        m.spatial_revolute(f"H{i}", before, rod.at(), axis=axis, coordinate=th)
        before = rod.at(*edge)
    m.spatial_revolute("H6", m.spatial_ground.at(0, 0, 1), before, axis=HINGES[5])
    return m


@cache
def of_bricard() -> tuple[ca.Function, ca.Function]:
    """The acceleration of hinge 1, and the ends of the rods, by its closed form: hinges of one parity turn alike."""
    x, w = ca.SX.sym("x"), ca.SX.sym("w")
    other = ca.asin(ca.sin(x) / (1 + ca.sin(x)))  # cos a + cos b + cos a cos b = 0 with angles from the cube
    points, axes, edges = [ca.SX.zeros(3)], [ca.SX(list(h)) for h in HINGES], [ca.SX(list(e)) for e in EDGES]
    for i in range(5):
        angle = (x, other, -x, -other, -x)[i]
        edges = edges[:i] + [rotated(axes[i], angle, e) for e in edges[i:]]
        axes = axes[: i + 1] + [rotated(axes[i], angle, h) for h in axes[i + 1 :]]
        points.append(points[-1] + edges[i])
    height = sum((points[i][2] + points[i + 1][2]) / 2 for i in range(5))
    place = ca.Function("place", [x], [ca.horzcat(*points)])
    return one_freedom(rods(points, x, w, 1.0), G * height, x, w), place


@cache
def bricards() -> alfmu.Equations:
    return alfmu.derive(bricard())


@pytest.mark.slow
def test_bricards_linkage_moves_as_its_closed_form():
    """Six equations for five angles, one redundant: fourth order, and the loop stays closed."""
    acceleration, place = of_bricard()
    for x in (0.4, -0.3):
        assert np.abs(np.array(place(x))[:, -1] - [0, 0, 1]).max() < 1e-14
    times = np.arange(0.0, 1.05, 0.1)
    exact, errors = motion(acceleration, 0.0, 1.0, times), []
    for h in (0.02, 0.01, 0.005):
        r = alfmu.simulate(bricards(), 1.0, 0.1, parameters=RK4 | {"solver.step_size": h})
        errors.append(np.abs(r["H1.angle"] - exact).max())
        assert r.counters.position_error < 1e-12
    assert np.ptp(exact) > 0.5
    assert np.polyfit(np.log([4, 2, 1]), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.4)
    assert errors[-1] < 1e-8
    assert r["H3.angle"] == pytest.approx(-r["H1.angle"], abs=1e-12)
    here = Probe.of(bricards()).mobility()
    assert (here.freedom, here.redundant) == (1, 1)


# Bennett's linkage ----------------------------------------------------------------------------------------------------


def bennett() -> alfmu.Mechanism:
    """The registered mechanism, by bodies and hinges: three rods in relative coordinates and a hinge that closes."""
    a, alpha, beta, x = 0.3, 0.7, 1.2, 1.0
    b = a * np.sin(beta) / np.sin(alpha)
    other = 2 * np.arctan2(np.sin((beta + alpha) / 2) / np.sin((beta - alpha) / 2) * np.cos(x / 2), np.sin(x / 2))
    m = alfmu.Mechanism("bennett_of_bodies")
    m.gravity(0, -G, 0)
    before, along = m.spatial_ground.at(), (0.0, 0.0, 1.0)
    for i, (length, twist, start) in enumerate([(a, alpha, x), (b, beta, other), (a, alpha, -x)], 1):
        th = m.coordinate(f"th{i}", "rad", start=start, independent=i == 1, rate=3.0 if i == 1 else 0.0)
        inertia = (0.0, length**2 / 12, length**2 / 12)
        rod = m.spatial_body(f"link{i}", mass=1.0, inertia=inertia, center=(length / 2, 0, 0), relative=True)
        # The first normal of an axis that leans more than 45 degrees to -y is square to x, where th counts from.
        angle = th - (np.pi / 2 if abs(along[1]) > along[2] else 0.0)
        m.spatial_revolute(f"hinge{i}", before, rod.at(), axis=along, second_axis=(0, 0, 1), coordinate=angle)
        before, along = rod.at(length, 0, 0), (0.0, -np.sin(twist), np.cos(twist))
    on_ground = (0.0, np.sin(beta), np.cos(beta))
    m.spatial_revolute("hinge4", m.spatial_ground.at(-b, 0, 0), before, axis=on_ground, second_axis=along)
    return m


@pytest.mark.slow
def test_bennetts_linkage_of_bodies_is_the_registered_one():
    """Three redundant constraints of five; the registered one is declared by energies and six equations of its loop."""
    e = alfmu.derive(bennett())
    got, want = (alfmu.simulate(x, 0.6, 0.05, parameters=RK4) for x in (e, derived("bennett")))
    assert np.ptp(want["hinge1.angle"]) > 1.0
    assert got["hinge1.angle"] == pytest.approx(want["hinge1.angle"], abs=2e-8)
    for axis in "xyz":
        assert got[f"link2.{axis}"] == pytest.approx(want[f"link2.{axis}"], abs=2e-8)
    assert got["monitor.energy"] == pytest.approx(want["monitor.energy"], abs=1e-7)
    here = Probe.of(e).mobility()
    assert (here.freedom, here.redundant) == (1, 3)


# A slider-crank in space ----------------------------------------------------------------------------------------------

RADIUS, LENGTH, HEIGHT = 0.08, 0.3, 0.12


@cache
def slider_crank() -> alfmu.Mechanism:
    """A crank about x, a slider along x; the rod between them on a universal joint and a ball."""
    m = alfmu.Mechanism("spatial_slider_crank")
    m.gravity(0, 0, -G)
    ground = m.spatial_ground
    crank = m.spatial_body("crank", mass=0.4, inertia=(2e-3, 1e-3, 1e-3), relative=True)
    th = m.coordinate("th", "rad", start=0.3, rate=6.0, independent=True)
    motor = m.spatial_revolute("motor", ground.at(0, 0, HEIGHT), crank.at(), axis=(1, 0, 0), coordinate=th)
    m.drive(motor, m.input("motor.torque", "N.m", start=0.5))
    slider = m.spatial_body("slider", mass=0.6, inertia=(1e-3, 1e-3, 1e-3), relative=True)
    s = m.coordinate("s", "m", start=0.25)
    m.spatial_prismatic("guide", ground.at(), slider.at(), axis=(1, 0, 0), coordinate=s)
    moments = (0.0, 0.5 * LENGTH**2 / 12, 0.5 * LENGTH**2 / 12)
    rod = m.spatial_body("rod", mass=0.5, inertia=moments, center=(-LENGTH / 2, 0, 0), relative=True)
    swing = [m.coordinate(f"swing{i}", "rad", start=x) for i, x in ((1, 0.5), (2, -0.2))]
    m.universal("pin", slider.at(), rod.at(), axis=(0, 1, 0), second_axis=(0, 0, 1), coordinates=swing)
    m.spherical("ball", crank.at(0, RADIUS, 0), rod.at(-LENGTH, 0, 0))
    m.friction(motor, 0.01)
    return m


@pytest.mark.slow
@pytest.mark.usefixtures("quickly_compiled")
def test_a_slider_crank_in_space_moves_as_its_one_equation(tmp_path):
    """Against Lagrange's equation in the crank's angle; through FMUs of both kinds the same to the last bit."""
    x, w = ca.SX.sym("x"), ca.SX.sym("w")
    pin = ca.vertcat(0, RADIUS * ca.cos(x), HEIGHT + RADIUS * ca.sin(x))
    along = ca.sqrt(LENGTH**2 - ca.sumsqr(pin))
    kinetic = 1e-3 * w**2 + 0.3 * ca.jtimes(along, x, w) ** 2 + rods([ca.vertcat(along, 0, 0), pin], x, w, 0.5)
    inertia = ca.hessian(kinetic, w)[0]
    force = 0.5 - 0.01 * w - ca.gradient(0.5 * G * pin[2] / 2, x) - ca.gradient(inertia, x) * w**2 / 2
    acceleration, place = ca.Function("acceleration", [x, w], [force / inertia]), ca.Function("place", [x], [along])
    times = np.arange(0.0, 0.55, 0.05)
    exact = motion(acceleration, 0.3, 6.0, times)
    r = alfmu.simulate(slider_crank(), 0.5, 0.05, parameters=RK4 | {"solver.step_size": 0.0025})
    assert np.ptp(exact) > 2 * np.pi
    assert r["motor.angle"] == pytest.approx(exact, abs=1e-6)
    assert r["slider.position"] == pytest.approx([float(place(x)) for x in exact], abs=1e-7)
    assert r["monitor.position_error"].max() < 1e-13
    last = {name: r[name][-1] for name in r.names}
    moments = (0.0, 0.5 * LENGTH**2 / 12, 0.5 * LENGTH**2 / 12)
    bodies = {"crank": (0.4, (2e-3, 1e-3, 1e-3), (0, 0, 0)), "slider": (0.6, (1e-3,) * 3, (0, 0, 0))}
    b = SpatialBalance(last, bodies | {"rod": (0.5, moments, (-LENGTH / 2, 0, 0))}, (0, 0, -G))
    b.joint("motor", "ground", "crank", (0, 0, 0), turn=(0.5 - 0.01 * last["motor.angular_velocity"], 0, 0))
    b.joint("guide", "ground", "slider", (0, 0, 0))
    b.joint("pin", "slider", "rod", (0, 0, 0))
    b.joint("ball", "crank", "rod", (-LENGTH, 0, 0))
    assert b.lack() <= 1e-9
    for kind in ("python", "native"):
        path = alfmu.export(slider_crank(), tmp_path / f"{kind}.fmu", kind=kind)
        assert validate(path) == []
        with Fmu(path) as fmu:
            result = run(fmu, 0.1, 0.05)
        assert np.array_equal(result.values, alfmu.simulate(slider_crank(), 0.1, 0.05).values)


# Stewart platform -----------------------------------------------------------------------------------------------------

FEET = [np.array([2 * np.cos(a), 2 * np.sin(a), 0.0]) for a in np.radians([-10, 10, 110, 130, 230, 250])]
HEADS = [np.array([1.2 * np.cos(a), 1.2 * np.sin(a), 0.0]) for a in np.radians([-50, 50, 70, 170, 190, 290])]
TON = (1000.0, np.array([[360.0, 20.0, -30.0], [20.0, 380.0, 10.0], [-30.0, 10.0, 700.0]]))


def stewart(lengths: list[float]) -> alfmu.Mechanism:
    """Six massless legs, each a cylinder on a universal joint and a rod that slides in it, under a platform of 1 t."""
    m = alfmu.Mechanism("stewart")
    m.gravity(0, 0, -G)
    top = m.spatial_body("top", mass=TON[0], inertia=TON[1], position=(0, 0, 1.8))
    for i, (foot, head, length) in enumerate(zip(FEET, HEADS, lengths, strict=True), 1):
        x, y, z = head - foot + [0, 0, 1.8]
        angles = np.arctan2(-y, z), np.arctan2(x, np.hypot(y, z))  # about x, then about y, of the leg
        swing = [m.coordinate(f"leg{i}_{k}", "rad", start=angle) for k, angle in zip("ab", angles, strict=True)]
        s = m.coordinate(f"s{i}", "m", start=length, independent=True)
        cylinder, rod = (m.spatial_body(f"{n}{i}", mass=0.0, inertia=(0.0,) * 3, relative=True) for n in ("cyl", "rod"))
        foot = m.spatial_ground.at(*foot)
        m.universal(f"U{i}", foot, cylinder.at(), axis=(1, 0, 0), second_axis=(0, 1, 0), coordinates=swing)
        leg = m.spatial_prismatic(f"leg{i}", cylinder.at(), rod.at(), axis=(0, 0, 1), coordinate=s)
        m.drive(leg, m.input(f"leg{i}.force", "N"))
        m.spherical(f"S{i}", rod.at(), top.at(*head))
    return m


def test_a_stewart_platform_is_held_and_moved_by_its_legs():
    """Forward: the pose of given lengths, the acceleration of given forces; inverse: forces that hold a ton at rest."""
    place, turn = np.array([0.1, -0.05, 1.9]), Rotation.from_rotvec([0.15, -0.1, 0.2])

    def legs(x: np.ndarray) -> np.ndarray:
        heads = x[:3] + Rotation.from_rotvec(x[3:]).apply(HEADS)
        return np.linalg.norm(heads - FEET, axis=1)

    lengths = legs(np.array([*place, *turn.as_rotvec()]))
    pose = fsolve(lambda x: legs(x) - lengths, [0, 0, 1.8, 0, 0, 0], xtol=1e-14)
    assert pose == pytest.approx([*place, *turn.as_rotvec()], abs=1e-9)  # as meant; a platform has others
    e = alfmu.derive(stewart(list(lengths)))
    start = Probe.of(e)
    q, v = start.numbers["q"], start.numbers["v"]
    assert start.mobility().freedom == 6
    r = evaluate(e, q, v, np.zeros(6))
    got = [r[f"top.{k}"] for k in "xyz"]
    attitude = Rotation.from_quat([r[f"top.e{k}"] for k in (1, 2, 3, 0)])
    assert got == pytest.approx(place, abs=1e-12)
    assert (attitude * turn.inv()).magnitude() < 1e-12
    # Forces of legs on the platform, and their moments about its centre of mass.
    arms = turn.apply(HEADS)
    along = (place + arms - FEET) / lengths[:, None]
    wrenches = np.vstack([along.T, np.cross(arms, along).T])
    weight = np.array([0, 0, TON[0] * G, 0, 0, 0])
    holding = np.linalg.solve(wrenches, weight)
    for forces in (holding, holding + np.arange(6) * 100.0):
        left = wrenches @ forces - weight
        r = evaluate(e, q, v, forces)
        J = turn.as_matrix() @ TON[1] @ turn.as_matrix().T
        expected = [*(left[:3] / TON[0]), *np.linalg.solve(J, left[3:])]
        read = [r[f"top.{k}"] for k in ("ax", "ay", "az", *(f"angular_acceleration.{x}" for x in "xyz"))]
        assert read == pytest.approx(expected, abs=1e-9)
        pushes = [[r[f"S{k}.force.{x}"] for x in "xyz"] for k in range(1, 7)]
        assert np.array(pushes) == pytest.approx(forces[:, None] * along, abs=1e-6)


# A gyroscope in gimbals -----------------------------------------------------------------------------------------------

OUTER, INNER, ROTOR = (0.02, 0.03, 0.04), (0.02, 0.01, 0.03), (0.03, 0.03, 0.05)


def gyroscope() -> alfmu.Mechanism:
    """A rotor in two gimbals: it spins about z of the inner one, at 0.1 m from their centre, under gravity."""
    m = alfmu.Mechanism("gyroscope")
    m.gravity(0, 0, -G)
    outer, inner, rotor = (
        m.spatial_body(name, mass=mass, inertia=inertia, center=(0, 0, height), relative=True)
        for name, mass, inertia, height in (
            ("outer", 0.5, OUTER, 0.0),
            ("inner", 0.3, INNER, 0.0),
            ("rotor", 1.0, ROTOR, 0.1),
        )
    )
    turn = m.coordinate("turn", "rad", independent=True, rate=0.5)
    tilt = m.coordinate("tilt", "rad", start=0.6, independent=True)
    spin = m.coordinate("spin", "rad", independent=True, rate=60.0)
    m.spatial_revolute("turning", m.spatial_ground.at(), outer.at(), axis=(0, 0, 1), coordinate=turn)
    m.spatial_revolute("tilting", outer.at(), inner.at(), axis=(1, 0, 0), coordinate=tilt)
    m.spatial_revolute("spinning", inner.at(), rotor.at(), axis=(0, 0, 1), coordinate=spin)
    return m


def test_a_gyroscope_nutates_as_its_integrals_say():
    """Against the one equation of the tilt: the momenta along the outer gimbal's axis and of the spin are constant."""
    C, m, h = ROTOR[2], 1.0, 0.1
    x, w = ca.SX.sym("x"), ca.SX.sym("w")
    swing = INNER[0] + ROTOR[0] + m * h**2
    yaw = OUTER[2] + (INNER[1] + ROTOR[1] + m * h**2) * ca.sin(x) ** 2 + INNER[2] * ca.cos(x) ** 2
    spin = C * (60.0 + 0.5 * np.cos(0.6))
    total = float(ca.Function("total", [x], [yaw * 0.5])(0.6)) + spin * np.cos(0.6)
    rate = (total - spin * ca.cos(x)) / yaw
    effective = yaw * rate**2 / 2 + m * G * h * ca.cos(x)  # of Routh: what is left of kinetic energy, and the weight
    acceleration = ca.Function("acceleration", [x, w], [-ca.gradient(effective, x) / swing])
    turning = ca.Function("rate", [x], [rate])
    times = np.linspace(0.0, 0.5, 11)
    exact = motion(acceleration, 0.6, 0.0, times)
    r = alfmu.simulate(gyroscope(), 0.5, 0.05, parameters=RK4 | {"solver.step_size": 0.001})
    assert np.ptp(exact) > 0.01  # it nutates
    assert r["tilting.angle"] == pytest.approx(exact, abs=1e-9)
    assert r["turning.angular_velocity"] == pytest.approx([float(turning(x)) for x in exact], abs=1e-7)
    last = {name: r[name][-1] for name in r.names}
    b = SpatialBalance(last, {"rotor": (m, ROTOR, (0, 0, h))}, (0, 0, -G))
    b.joint("spinning", "ground", "rotor", (0, 0, 0))
    assert b.lack() <= 1e-12
