"""Dry friction that follows from the load: closed forms, a reference from event to event, jams, shares, FMUs."""

import math
import re

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from oracles.rubbing import Crank
from scenes import initialized, sliding
from scipy.integrate import solve_ivp

import alfmu
from alfmu import Mechanism
from alfmu.cli import main
from alfmu.model.errors import AlfmuError, DeclarationError, InputError
from alfmu.runtime.pipeline import with_defaults

G = 9.81
METHODS = ("auto", "rk4", "stiff")


# A block on an incline ----------------------------------------------------------------------------------------------

TILT, COULOMB, STATIC = 0.35, 0.25, 0.4


def block() -> Mechanism:
    m = Mechanism("block", "A block on an incline")
    tilt = m.parameter("tilt", TILT, "rad")
    coulomb = m.parameter("coulomb", COULOMB, "1", minimum=0.0)
    place = m.start("place", 0.0, "m", rate=0.0, rate_name="speed")
    s = m.coordinate("s", "m", start=place)
    body = m.body("block", mass=2.0)
    guide = m.prismatic("guide", m.ground.at(0, 0), body.at(0, 0), coordinate=s, axis=tilt)
    m.drive(guide, m.input("push", "N"))
    m.friction(guide, coulomb=coulomb, static=STATIC)
    m.gravity(0, -G)
    return m


@pytest.fixture(scope="module")
def incline() -> alfmu.Equations:
    return alfmu.derive(block())


@pytest.mark.parametrize("order", [0, 1])
@pytest.mark.parametrize(("speed", "growth"), [(0.0, 20.0), (-0.5, 200.0)])
def test_a_block_feels_an_input_that_changes_within_a_step(incline, speed, growth, order):
    """A push that grows in proportion to time moves a block at rest, or turns one that slides against it: in one step,
    at the push of that time. A slope tells how it changes, or its past values."""
    rubs = COULOMB * 2.0 * G
    turn = max(np.roots([growth / 4, rubs / 2, speed])) if speed else STATIC * 2.0 * G / growth
    unit = initialized(alfmu.Instance(incline), {"tilt": 0.0, "start.speed": speed, "solver.input_order": order})
    if order:  # Two values are known where the long step begins.
        unit.step(1e-3)
        unit.set("push", growth * 1e-3)
    else:
        unit.slope("push", growth)
    unit.step(0.9 - unit.time)
    late = 0.9 - turn
    there = (speed + rubs * turn / 4) * turn + growth * turn**3 / 12 if speed else 0.0
    there += (growth * turn - rubs) * late**2 / 4 + growth * late**3 / 12
    assert unit.get("block.position") == pytest.approx(there, abs=1e-4 if order else 1e-9)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_slides_up_an_incline_and_down_again(incline, method):
    """Thrown upwards on an incline that is too steep to stick on: it turns round, and comes down more slowly."""
    tilt = 0.5
    run = alfmu.simulate(incline, 2.0, 0.03, parameters={"start.speed": 3.0, "tilt": tilt, "solver.method": method})
    up, down = (-G * (math.sin(tilt) + way * COULOMB * math.cos(tilt)) for way in (1, -1))
    turn = -3.0 / up
    late = np.maximum(run.time - turn, 0)
    exact = np.where(run.time < turn, 3.0 * run.time + up * run.time**2 / 2, -(3.0**2) / (2 * up) + down * late**2 / 2)
    np.testing.assert_allclose(run["block.position"], exact, atol=1e-12)
    assert set(run["guide.slip"]) == {1.0, -1.0}
    force = 2.0 * G * COULOMB * math.cos(tilt)
    np.testing.assert_allclose(run["guide.friction_force"], -force * run["guide.slip"], rtol=1e-13)
    lost = 2.0 * 3.0**2 / 2 + run["monitor.work"]  # all the work is that of friction
    np.testing.assert_allclose(lost, run["monitor.energy"], atol=1e-11)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_that_stops_sticks_without_creep(incline, method):
    run = alfmu.simulate(
        incline, 20.0, 0.5, parameters={"start.speed": -1.0, "coulomb": STATIC, "solver.method": method}
    )
    brake = G * (STATIC * math.cos(TILT) - math.sin(TILT))
    rest = run.time > 1.0 / brake
    assert rest.sum() > 20
    np.testing.assert_allclose(run["block.position"][rest], -1.0 / (2 * brake), rtol=1e-12)
    assert np.abs(run["block.velocity"][rest]).max() < 1e-15
    assert np.ptp(run["block.position"][rest]) < 1e-15
    assert set(run["guide.slip"][rest]) == {0.0}
    np.testing.assert_allclose(run["guide.friction_force"][rest], 2.0 * G * math.sin(TILT), rtol=1e-12)


def test_a_block_lets_go_when_the_push_exceeds_static_friction():
    """The push grows with time; from static to Coulomb friction the force falls at once."""
    m = block()
    m.drive(m.joints[0], 30.0 * m.time)
    load, weight = 2.0 * G * math.cos(TILT), 2.0 * G * math.sin(TILT)
    free = (weight + STATIC * load) / 30.0
    run = alfmu.simulate(m, 1.5, 0.01, parameters={"solver.method": "auto"})
    t = run.time - free
    exact = np.where(t < 0, 0.0, (STATIC - COULOMB) * load * t**2 / 4 + 30.0 * t**3 / 12)
    np.testing.assert_allclose(run["block.position"], exact, atol=2e-9)
    before = run.time <= free
    np.testing.assert_allclose(run["guide.friction_force"][before], (weight - 30.0 * run.time)[before], atol=1e-9)
    assert set(run["guide.slip"][~before]) == {1.0}


@pytest.mark.parametrize("method", METHODS)
def test_a_constant_load_takes_the_same_from_each_swing(method):
    """Each half swing of a mass on a spring is shorter by 2 F/k than the one before; the last ends closer than F/k."""
    m, _, guide, _ = sliding("seal", body="mass", mass=2.0, start=1.0, independent=True)
    m.spring_damper(guide, stiffness=50.0)
    m.friction(guide, coulomb=0.5, load=8.0)
    half = math.pi * math.sqrt(2.0 / 50.0)
    turns = [(-1) ** i * (1.0 - 2 * 4.0 / 50.0 * i) for i in range(7)]
    for tolerance, within in ((1e-6, 1e-9), (1e-7, 1e-10)):
        solver = {"solver.method": method, "solver.step_size": 2e-3, "solver.relative_tolerance": tolerance}
        run = alfmu.simulate(m, 9 * half, half, parameters=solver)
        np.testing.assert_allclose(run["mass.position"], [*turns, *turns[-1:] * 3], atol=within)
    np.testing.assert_allclose(run["guide.friction_force"][-1], 50.0 * turns[-1], rtol=1e-8)
    with pytest.raises(alfmu.DeclarationError, match="a constant load needs no radius"):
        m.friction(guide, coulomb=0.5, load=8.0, length=0.1)


@pytest.mark.parametrize("method", METHODS)
def test_a_block_on_a_belt_sticks_and_slips(method):
    """A spring pulls it at an even speed. In each stretch of sliding s = V t + D - D cos w t - V/w sin w t."""
    stiffness, speed, coulomb, static = 200.0, 0.1, 0.3, 0.6
    m, _, guide, s = sliding("belt", start=0.0)
    m.friction(guide, coulomb=coulomb, static=static)
    m.drive(guide, stiffness * (speed * m.time - s))
    m.gravity(0, -G)
    w, D = math.sqrt(stiffness), (static - coulomb) * G / stiffness

    def moved(t: float) -> float:
        return speed * t + D - D * math.cos(w * t) - speed / w * math.sin(w * t)

    stop = 2 * (math.pi - math.atan(D * w / speed)) / w  # where the rate V + D w sin - V cos vanishes again
    first, period = static * G / stiffness / speed, moved(stop) / speed
    parameters = {"solver.method": method, "solver.relative_tolerance": 1e-8, "solver.step_size": 0.004}
    run = alfmu.simulate(m, 6.0, 0.05, parameters=parameters)
    whole, rest = np.divmod(np.maximum(run.time - first, 0.0), period)
    assert whole[-1] == 9
    exact = whole * moved(stop) + [moved(min(t, stop)) for t in rest]
    np.testing.assert_allclose(run["block.position"], exact, atol=1e-7 if method == "rk4" else 5e-9)


def test_the_coefficient_falls_with_the_rate():
    m = block()
    body = m.body("other", mass=1.0)
    guide = m.prismatic("other_guide", m.ground.at(0, 0), body.at(0, 0), coordinate=m.coordinate("x", "m", start=0.0))
    m.drive(guide, 6.0)
    m.friction(guide, 0.5, coulomb=0.2, static=0.5, stribeck=0.3)
    run = alfmu.simulate(m, 2.0, 0.1)
    speed = run["other.velocity"]
    assert speed[-1] > 3.0
    law = -G * (0.2 + 0.3 * np.exp(-((speed / 0.3) ** 2)))
    np.testing.assert_allclose(run["other_guide.friction_force"], law, rtol=1e-12)
    np.testing.assert_allclose(run["other.acceleration"], 6.0 + law - 0.5 * speed, rtol=1e-10)


# A rotor in a journal -----------------------------------------------------------------------------------------------

RADIUS, MASS, INERTIA = 0.05, 2.0, 0.03


def rotor() -> Mechanism:
    m = Mechanism("rotor", "A rotor in a journal")
    g = m.parameter("g", G, "m/s2")
    mu = m.parameter("mu", 0.3, "1")
    aside = m.parameter("aside", 0.0, "m", description="centre of mass from the axis")
    angle = m.start("angle", 0.0, "rad", rate=20.0, rate_name="speed")
    disc = m.body("disc", mass=MASS, inertia=INERTIA, center=(aside, 0.0))
    journal = m.revolute("A", m.ground.at(0, 0), disc.at(0, 0), coordinate=m.coordinate("th", "rad", start=angle))
    m.friction(journal, coulomb=mu, radius=RADIUS)
    m.gravity(0, -g)
    return m


@pytest.fixture(scope="module")
def spinning() -> alfmu.Equations:
    return alfmu.derive(rotor())


@pytest.mark.parametrize("method", METHODS)
def test_a_journal_brings_a_balanced_rotor_to_rest(spinning, method):
    """Under its weight alone the torque is constant."""
    run = alfmu.simulate(spinning, 3.0, 0.05, parameters={"solver.method": method})
    slower = 0.3 * RADIUS * MASS * G / INERTIA
    np.testing.assert_allclose(run["disc.angular_velocity"], np.maximum(20.0 - slower * run.time, 0.0), atol=1e-11)
    rest = run.time > 20.0 / slower
    assert rest.sum() > 10
    assert np.abs(run["disc.angular_velocity"][rest]).max() < 1e-15
    assert set(run["A.slip"][rest]) == {0.0}


@pytest.mark.parametrize("mu", [0.3, 2.0, 4.0])
@pytest.mark.parametrize("method", ["auto", "explicit", "stiff"])
def test_a_journal_carries_what_its_own_friction_adds(spinning, method, mu):
    """Without weight the load is that of the eccentric mass, which friction slows down: m e sqrt(w^4 + w'^2).

    w' = -c w^2 with c^2 = k^2 (1 + c^2), k = mu r m e / I, so that w = w0 / (1 + c w0 t); friction computed from the
    load of a step before would be wrong by a factor of up to 1 / sqrt(1 - k^2).
    """
    aside = 0.1
    k = mu * RADIUS * MASS * aside / (INERTIA + MASS * aside**2)
    c = k / math.sqrt(1 - k**2)
    parameters = {"g": 0.0, "mu": mu, "aside": aside, "solver.method": method, "solver.relative_tolerance": 1e-9}
    run = alfmu.simulate(spinning, 2.0, 0.02, parameters=parameters)
    np.testing.assert_allclose(run["disc.angular_velocity"], 20.0 / (1 + c * 20.0 * run.time), rtol=1e-8)
    load = np.hypot(run["A.force.x"], run["A.force.y"])
    np.testing.assert_allclose(run["A.friction_torque"], -mu * RADIUS * load, rtol=1e-13)
    assert run["monitor.step_error"].max() < 1e-9


def test_a_bar_between_two_points_rubs_as_one_with_an_angle():
    """Its angle is known within a turn; it goes through pi, far from where it stuck last."""

    def pendulum(natural: bool) -> Mechanism:
        m = Mechanism("pendulum", "A bar in a journal")
        angle = m.start("angle", 0.3, "rad", rate=9.0)
        if natural:
            end = m.coordinate("x", "m", start=ca.cos(angle)), m.coordinate("y", "m", start=ca.sin(angle))
            bar = m.bar("bar", mass=1.0, length=1.0, between=(m.ground.at(0, 0), m.point(*end)))
        else:
            bar = m.bar("bar", mass=1.0, length=1.0)
        th = None if natural else m.coordinate("th", "rad", start=angle)
        journal = m.revolute("A", m.ground.at(0, 0), bar.start, coordinate=th)
        m.friction(journal, coulomb=0.6, radius=0.2)
        m.gravity(0, -G)
        return m

    parameters = {"solver.method": "rk4", "solver.step_size": 0.01}
    runs = [alfmu.simulate(pendulum(x), 3.0, 0.1, parameters=parameters) for x in (False, True)]
    assert np.ptp(runs[0]["bar.angle"]) > 4.0
    assert 0.0 in runs[0]["A.slip"]
    np.testing.assert_array_equal(runs[0]["A.slip"], runs[1]["A.slip"])
    for name in ("bar.angle", "A.friction_torque"):
        np.testing.assert_allclose(runs[1][name], runs[0][name], atol=1e-5)


def test_a_jam_is_reported(spinning):
    """With k above 1 no deceleration is as large as the load that it makes (Painleve): 5 < mu here."""
    jam = {"g": 0.0, "mu": 5.1, "aside": 0.1}
    with pytest.raises(AlfmuError, match=r"rotor, t = 0 s: joints jam: no sliding motion .* \(A\)"):
        alfmu.simulate(spinning, 1.0, 0.02, parameters=jam)
    assert alfmu.simulate(spinning, 1.0, 0.02, parameters=jam | {"mu": 4.9})["disc.angular_velocity"][-1] > 0


# A slider-crank -----------------------------------------------------------------------------------------------------

L1, L2, MASSES, MU, RADII, EDGES = 0.3, 0.8, (1.0, 1.5, 2.0), (0.4, 0.35, 0.3, 0.4), (0.1, 0.08, 0.1), 0.2


def crank(torque: float) -> Mechanism:
    m = Mechanism("rubbing_crank", "A slider-crank with friction in all joints")
    angle = m.start("angle", 0.7, "rad", rate=9.0, rate_name="speed")
    lean = ca.asin(-L1 / L2 * ca.sin(angle))
    reach = L1 * ca.cos(angle) + L2 * ca.cos(lean)
    pose = [reach - L2 / 2 * ca.cos(lean), L1 / 2 * ca.sin(angle), lean]
    th = m.coordinate("th", "rad", start=angle)
    pose = tuple(
        m.coordinate(*x, start=at) for x, at in zip((("x2", "m"), ("y2", "m"), ("th2", "rad")), pose, strict=True)
    )
    s = m.coordinate("s", "m", start=reach)
    first = m.bar("crank", mass=MASSES[0], length=L1)
    rod = m.bar("rod", mass=MASSES[1], length=L2, pose=pose)
    slider = m.body("slider", mass=MASSES[2])
    A = m.revolute("A", m.ground.at(0, 0), first.start, coordinate=th)
    B = m.revolute("B", first.end, rod.start)
    C = m.revolute("C", rod.end, slider.at(0, 0))
    guide = m.prismatic("guide", m.ground.at(0, 0), slider.at(0, 0), coordinate=s)
    for joint, mu, radius in zip((A, B, C), MU, RADII, strict=False):
        m.friction(joint, coulomb=mu, radius=radius)
    m.friction(guide, coulomb=MU[3], length=EDGES)
    m.drive(A, torque * ca.sin(4.0 * m.time))
    m.gravity(0, -G)
    return m


@pytest.fixture(scope="module")
def cranked() -> tuple[alfmu.Equations, np.ndarray, np.ndarray, list[str]]:
    torque, times = 6.5, np.arange(141) * 0.01
    exact = Crank(L1, L2, *MASSES, MU, RADII, EDGES, lambda t: torque * math.sin(4.0 * t))
    return alfmu.derive(crank(torque)), times, *exact.run(0.7, 9.0, times)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "tolerance", "bound"), [("auto", 1e-9, 1e-8), ("auto", 1e-6, 5e-5), ("rk4", 1e-6, 5e-5)]
)
def test_a_slider_crank_against_an_event_driven_reference(cranked, method, tolerance, bound):
    e, times, exact, events = cranked
    assert {"stopped", "freed", "guide"} <= set(events)
    chosen = {"solver.method": method, "solver.relative_tolerance": tolerance, "solver.step_size": 2e-3}
    run = alfmu.simulate(e, times[-1], 0.01, parameters=chosen)
    np.testing.assert_allclose(run["crank.angle"], exact[0], atol=bound)
    np.testing.assert_allclose(run["crank.angular_velocity"], exact[1], atol=30 * bound)
    stuck = exact[1] == 0
    assert stuck.sum() > 2
    assert np.abs(run["crank.angular_velocity"][stuck]).max() < 1e-15
    assert (np.column_stack([run[f"{joint}.slip"] for joint in ("A", "B", "C", "guide")])[stuck] == 0).any(axis=1).all()
    for joint, mu, radius in zip("ABC", MU, RADII, strict=False):
        limit = mu * radius * np.hypot(run[f"{joint}.force.x"], run[f"{joint}.force.y"])
        torque, slides = run[f"{joint}.friction_torque"], run[f"{joint}.slip"] != 0
        np.testing.assert_allclose(np.abs(torque[slides]), limit[slides], rtol=1e-9)
        assert (np.abs(torque) <= limit * (1 + 1e-9)).all()
    edges = np.maximum(np.abs(run["guide.force"]), 2 / EDGES * np.abs(run["guide.moment"]))
    assert (np.abs(run["guide.friction_force"]) <= MU[3] * edges * (1 + 1e-9)).all()


# A wedge ------------------------------------------------------------------------------------------------------------

WEDGE, LOAD = 1.0, 5.0
"""Masses [kg]."""


def test_joints_that_turn_and_slide_reverse_together():
    """A slider-crank swings with constant friction in the crank's hinge and in the guide, which reverse at once: the
    equation of one freedom, integrated from one reversal to the next."""
    k, rest, arm, hinge, guide = 300.0, 0.25, (0.2, 0.3), 0.08, 0.5
    m = Mechanism("swing")
    size = m.parameter("size", 1.0, "m")
    crank, rod = m.bar("crank", mass=1.0, length=arm[0] * size), m.bar("rod", mass=0.5, length=arm[1] * size)
    slide = m.body("slide", mass=1.0)
    th, bend = m.coordinate("th", "rad", start=0.9, independent=True), m.coordinate("bend", "rad", start=-1.4)
    A = m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=th)
    m.revolute("B", crank.end, rod.start, coordinate=bend)
    way = m.coordinate("way", "m", start=0.38 * size)
    G = m.prismatic("G", m.ground.at(0, 0), slide.at(0, 0), coordinate=way)
    m.revolute("C", rod.end, slide.at(0, 0))
    m.spring_damper(G, stiffness=k, rest=rest * size)
    m.friction(A, coulomb=1.0, load=hinge * size**2)
    m.friction(G, coulomb=1.0, load=guide * size)
    m.gravity(0, 0)
    q, w = ca.SX.sym("q"), ca.SX.sym("w")
    y, x = arm[0] * ca.sin(q), arm[0] * ca.cos(q) + ca.sqrt(arm[1] ** 2 - (arm[0] * ca.sin(q)) ** 2)

    def square(e: ca.SX) -> ca.SX:
        return (ca.jacobian(e, q) * w) ** 2

    middle = square((arm[0] * ca.cos(q) + x) / 2) + square(y / 2)
    turn = square(ca.asin(-y / arm[1]))
    T = arm[0] ** 2 / 6 * w**2 + square(x) / 2 + middle / 4 + arm[1] ** 2 / 48 * turn
    J, dx = ca.hessian(T, w)[0], ca.jacobian(x, q)
    terms = ca.Function("terms", [q, w], [J, ca.jacobian(J, q) * w**2 / 2, k * (x - rest) * dx, ca.fabs(dx)])
    times, found, t, state = np.arange(81) * 0.02, [], 0.0, np.array([0.9, 0.0])
    while t < times[-1]:
        _, _, load, slope = map(float, terms(*state))
        assert abs(load) > hinge + guide * slope  # it does not stick
        sign = -math.copysign(1, load)

        def rate(_t: float, z: np.ndarray, sign: float = sign) -> list[float]:
            j, d, f, s = map(float, terms(*z))
            return [z[1], (-f - d - sign * (hinge + guide * s)) / j]

        def stop(_t: float, z: np.ndarray) -> float:
            return z[1]

        stop.terminal, stop.direction = True, -sign
        part = solve_ivp(
            rate, (t, times[-1]), state, "DOP853", rtol=1e-12, atol=1e-13, events=stop, dense_output=True, max_step=0.01
        )
        found += [part.sol(at) for at in times[len(found) :] if at <= part.t[-1]]
        t, state = part.t[-1], np.array([part.y[0, -1], 0.0])
    for length in (1.0, 0.02):
        run = alfmu.simulate(m, 1.6, 0.02, parameters={"size": length, "solver.relative_tolerance": 1e-9})
        assert run["crank.angle"] == pytest.approx(np.array(found)[:, 0], abs=1e-9), length
        assert run["crank.angular_velocity"] == pytest.approx(np.array(found)[:, 1], abs=1e-8), length


def wedge() -> Mechanism:
    """A wedge that is pushed under a load; y = x tan(slope)."""
    m = Mechanism("wedge", "A wedge under a load")
    slope, mu = m.parameter("slope", 0.15, "rad"), m.parameter("mu", 0.2, "1")
    growth = m.parameter("growth", 0.0, "W")
    x, y = m.coordinate("x", "m", start=0.0), m.coordinate("y", "m", start=0.0)
    body, load = m.body("wedge", mass=WEDGE), m.body("load", mass=LOAD)
    floor = m.prismatic("floor", m.ground.at(0, 0), body.at(0, 0), coordinate=x)
    guide = m.prismatic("guide", m.ground.at(0, 0), load.at(0, 0), coordinate=y, axis=math.pi / 2)
    face = m.prismatic("face", body.at(0, 0), load.at(0, 0), axis=math.pi - slope)
    for joint in (floor, guide, face):
        m.friction(joint, coulomb=mu)
    m.drive(floor, growth * m.time)
    m.gravity(0, -G)
    return m


def pushed(slope: float, mu: float, way: float, a: float = 0.0) -> float:
    """The push that lifts (way 1) or lowers (-1) the load with an acceleration of the wedge: forces of both bodies."""
    across = math.sin(slope) + way * mu * math.cos(slope)
    upwards = math.cos(slope) - way * mu * math.sin(slope)
    normal = LOAD * (G + a * math.tan(slope)) / (upwards - way * mu * abs(across))
    return WEDGE * a + normal * across + way * mu * (WEDGE * G + normal * upwards)


@pytest.fixture(scope="module")
def wedged() -> alfmu.Equations:
    return alfmu.derive(wedge())


def test_a_wedge_locks_itself(wedged):
    assert pushed(0.15, 0.2, -1.0) < 0  # it takes a pull to lower the load
    run = alfmu.simulate(wedged, 2.0, 0.1)
    assert np.abs(run["wedge.velocity"]).max() < 1e-15
    assert np.abs(run["load.y"]).max() < 1e-15


def test_a_steep_wedge_is_driven_out(wedged):
    slope, mu = 0.6, 0.1
    free = pushed(slope, mu, -1.0)
    a = -free / (pushed(slope, mu, -1.0, 1.0) - free)  # the push is linear in it
    run = alfmu.simulate(wedged, 0.5, 0.05, parameters={"slope": slope, "mu": mu})
    assert a < -1.0
    np.testing.assert_allclose(run["wedge.position"], a * run.time**2 / 2, atol=1e-12)
    assert set(run["face.slip"]) == {-1.0}


@pytest.mark.parametrize("method", ["auto", "rk4"])
def test_a_push_sets_a_wedge_free(wedged, method):
    slope, mu, growth = 0.15, 0.2, 50.0
    least = pushed(slope, mu, 1.0)
    mass = pushed(slope, mu, 1.0, 1.0) - least
    run = alfmu.simulate(wedged, 1.5, 0.01, parameters={"growth": growth, "solver.method": method})
    late = np.maximum(run.time - least / growth, 0.0)
    assert late[-1] > 0.3
    np.testing.assert_allclose(run["wedge.position"], growth * late**3 / 6 / mass, atol=1e-9)
    assert np.abs(run["wedge.velocity"][late == 0]).max() < 1e-15


def test_a_wedge_that_no_push_can_move_stays(wedged):
    """Beyond this slope the guide holds the load with more friction than any push lifts."""
    slope, mu = 1.3, 0.3
    assert pushed(slope, mu, 1.0) < 0
    run = alfmu.simulate(wedged, 20.0, 0.1, parameters={"slope": slope, "mu": mu, "growth": 50.0})
    late = run.time > 2.0
    assert np.abs(run["wedge.velocity"][late]).max() < 1e-15
    assert np.ptp(run["wedge.position"][late]) < 1e-14
    for joint in ("floor", "guide", "face"):
        assert (np.abs(run[f"{joint}.friction_force"]) <= mu * np.abs(run[f"{joint}.force"]) * (1 + 1e-8)).all()
    assert np.abs(run["guide.force"][-1]) > 900.0


# A four-bar ---------------------------------------------------------------------------------------------------------

BARS, BASE, BAR_MASSES, BEGIN = (0.25, 0.7, 0.5), 0.6, (1.0, 2.0, 1.5), 1.5
JOURNALS = {"A": (0.5, 0.12), "B": (0.45, 0.1), "C": (0.5, 0.1), "D": (0.5, 0.12)}
"""Coefficients and radii [m]."""


def closed(th: float) -> np.ndarray:
    """Angles of crank, coupler and rocker."""
    pin = BARS[0] * np.exp(1j * th)
    way = BASE - pin
    inner = np.arccos((BARS[1] ** 2 + abs(way) ** 2 - BARS[2] ** 2) / (2 * BARS[1] * abs(way)))
    coupler = np.angle(way) + inner
    return np.array([th, coupler, np.angle(pin + BARS[1] * np.exp(1j * coupler) - BASE)])


def freeing(th: float, way: float) -> float:
    """The torque on the crank that is about to turn it this way, by statics of each bar (9 equations)."""
    angles = closed(th)
    e = np.column_stack([np.cos(angles), np.sin(angles)]) * np.array(BARS)[:, None]
    n = np.column_stack([-e[:, 1], e[:, 0]])
    rates = np.array([1.0, *np.linalg.solve(np.column_stack([n[1], -n[2]]), -n[0])])
    turning = way * np.sign([rates[0], rates[1] - rates[0], rates[2] - rates[1], rates[2]])  # A, B, C; D on the rocker
    K, right = np.zeros((9, 9)), np.zeros(9)
    ends = ((0, 1), (1, 2), (3, 2))  # the joint at the begin and at the end of each bar; A, D from the ground
    signs = ((1, -1), (1, -1), (1, 1))
    for bar in range(3):
        for which in range(2):
            joint, sign = ends[bar][which], signs[bar][which]
            arm = (which - 0.5) * e[bar]
            columns = slice(2 * joint, 2 * joint + 2)
            K[3 * bar : 3 * bar + 2, columns] = sign * np.eye(2)
            K[3 * bar + 2, columns] = sign * np.array([-arm[1], arm[0]])
        right[3 * bar + 1] = BAR_MASSES[bar] * G
    K[2, 8] = 1.0
    friction = np.zeros(4)
    for _ in range(300):
        b = right.copy()
        b[2] -= friction[0] - friction[1]
        b[5] -= friction[1] - friction[2]
        b[8] -= friction[2] + friction[3]
        y = np.linalg.solve(K, b)
        sizes = np.hypot(y[0:8:2], y[1:8:2])
        friction = -turning * [mu * radius * size for (mu, radius), size in zip(JOURNALS.values(), sizes, strict=True)]
    return y[8]


def four_bar() -> Mechanism:
    m = Mechanism("stuck_four_bar", "A four-bar with friction in all joints")
    growth = m.parameter("growth", 0.0, "W")
    start = m.start("angle", BEGIN, "rad", rate=0.0, rate_name="speed")
    th = m.coordinate("th", "rad", start=start)
    guess = closed(BEGIN)
    pin = BARS[0] * np.exp(1j * BEGIN) + BARS[1] / 2 * np.exp(1j * guess[1])
    pose = (m.coordinate("x2", "m", start=pin.real), m.coordinate("y2", "m", start=pin.imag))
    pose = (*pose, m.coordinate("th2", "rad", start=guess[1]))
    rocker_angle = m.coordinate("th3", "rad", start=guess[2])
    crank_ = m.bar("crank", mass=BAR_MASSES[0], length=BARS[0])
    coupler = m.bar("coupler", mass=BAR_MASSES[1], length=BARS[1], pose=pose)
    rocker = m.bar("rocker", mass=BAR_MASSES[2], length=BARS[2])
    joints = {
        "A": m.revolute("A", m.ground.at(0, 0), crank_.start, coordinate=th),
        "D": m.revolute("D", m.ground.at(BASE, 0), rocker.start, coordinate=rocker_angle),
        "B": m.revolute("B", crank_.end, coupler.start),
        "C": m.revolute("C", coupler.end, rocker.end),
    }
    for name, joint in joints.items():
        m.friction(joint, coulomb=JOURNALS[name][0], radius=JOURNALS[name][1])
    m.drive(joints["A"], growth * m.time)
    m.gravity(0, -G)
    return m


@pytest.fixture(scope="module")
def four() -> alfmu.Equations:
    return alfmu.derive(four_bar())


@pytest.mark.slow
def test_a_four_bar_is_stuck_until_it_is_freed(four):
    torque, growth = freeing(BEGIN, 1.0), 20.0
    assert freeing(BEGIN, -1.0) < 0 < torque
    run = alfmu.simulate(four, 1.3 * torque / growth, 0.002, parameters={"growth": growth})
    stuck = run.time < torque / growth
    assert np.abs(run["crank.angular_velocity"][stuck]).max() < 1e-15
    moves = np.flatnonzero(run["crank.angular_velocity"] > 1e-9)
    assert run.time[moves[0]] == run.time[~stuck][0]
    # It begins with a'' growing evenly from zero, so that the rate is that of a parabola from the time itself.
    late = run.time[moves[:12]] - torque / growth
    ratio = run["crank.angular_velocity"][moves[:12]] / late**2
    assert np.ptp(ratio[2:]) < 0.02 * ratio.mean()
    assert run["monitor.step_error"].max() < 1e-6


def test_a_four_bar_that_is_thrown_sticks_where_it_stops(four):
    run = alfmu.simulate(four, 2.0, 0.02, parameters={"start.speed": 5.0})
    rest = run["crank.angular_velocity"] == run["crank.angular_velocity"][-1]
    assert 10 < rest.sum() < 95
    assert np.abs(run["crank.angular_velocity"][-10:]).max() < 1e-15
    assert np.ptp(run["coupler.angle"][-10:]) < 1e-14
    assert abs(run["coupler.angle"][-1] - run["coupler.angle"][0]) > 0.05


def pentagon() -> Mechanism:
    """A five-bar of two degrees of freedom, with friction in five joints."""
    m = Mechanism("pentagon", "A five-bar of two degrees of freedom")
    pins = np.array([0.4 * np.exp(2.0j), 0.5 + 0.4 * np.exp(1.1j)])
    way = pins[1] - pins[0]
    top = pins.mean() + 1j * way / abs(way) * math.sqrt(0.25 - abs(way) ** 2 / 4)
    cranks = [m.bar(name, mass=1.0, length=0.4) for name in ("left", "right")]
    starts = m.start("left", 2.0, "rad", rate=1.0), m.start("right", 1.1, "rad", rate=-3.0)
    rods, joints = [], []
    for k, name in enumerate(("left", "right")):
        middle, lean = (pins[k] + top) / 2, float(np.angle(top - pins[k]))
        pose = (("x", "m", middle.real), ("y", "m", middle.imag), ("angle", "rad", lean))
        pose = tuple(m.coordinate(f"{name}_{letter}", unit, start=at) for letter, unit, at in pose)
        rods.append(m.bar(f"{name}_rod", mass=0.6, length=0.5, pose=pose))
        turn = m.coordinate(f"{name}_turn", "rad", start=starts[k])
        joints.append(m.revolute(f"{name}_axle", m.ground.at(0.5 * k, 0), cranks[k].start, coordinate=turn))
        m.drive(joints[-1], (2 * ca.sin(5 * m.time), 6 * ca.cos(3 * m.time))[k])
        joints.append(m.revolute(f"{name}_pin", cranks[k].end, rods[k].start))
    joints.append(m.revolute("top", rods[0].end, rods[1].end))
    for joint in joints:
        m.friction(joint, coulomb=0.5, static=0.6, radius=0.1)
    m.gravity(0, -G)
    return m


@pytest.mark.slow
def test_joints_of_two_freedoms_stick_and_slide_in_turn():
    m = pentagon()
    e = alfmu.derive(m)
    names = ["left.angle", "right.angle", "left_rod.angle"]
    run = alfmu.simulate(e, 4.0, 0.01, parameters={"solver.relative_tolerance": 1e-7})
    steps = {"solver.method": "rk4", "solver.step_size": 1e-3}
    fixed = alfmu.simulate(e, 4.0, 0.01, parameters=steps, outputs=names)
    for name in names:
        np.testing.assert_allclose(run[name], fixed[name], atol=5e-5)
    together = np.column_stack([run[f"{joint.name}.slip"] != 0 for joint in m.joints]).sum(axis=1)
    assert {0, 5} < set(together)  # all at rest, all sliding, and some of them
    for joint in m.joints:
        load = 0.1 * np.hypot(run[f"{joint.name}.force.x"], run[f"{joint.name}.force.y"])
        torque, slip = run[f"{joint.name}.friction_torque"], run[f"{joint.name}.slip"]
        assert (np.abs(torque) <= 0.6 * load * (1 + 1e-8)).all()
        np.testing.assert_allclose(torque[slip != 0], (-0.5 * slip * load)[slip != 0], rtol=1e-9)
    assert run["monitor.step_error"].max() < 1e-7


# Loads that are shared ----------------------------------------------------------------------------------------------


def sledge() -> Mechanism:
    """A body on two guides, one of which rubs: redundant constraints share its weight."""
    m = Mechanism("sledge", "A body on two guides")
    place = m.start("place", 0.0, "m", rate=2.0, rate_name="speed")
    pose = m.coordinate("x", "m", start=place), m.coordinate("y", "m", start=0), m.coordinate("th", "rad", start=0)
    body = m.body("sledge", mass=3.0, pose=pose)
    guides = [m.prismatic(name, m.ground.at(0, 0), body.at(0, 0)) for name in ("smooth", "rough")]
    m.friction(guides[1], coulomb=0.3)
    m.gravity(0, -G)
    m.compliances()
    return m


def test_friction_of_a_shared_load_is_settled_by_compliances(caplog):
    e = alfmu.derive(sledge())
    run = alfmu.simulate(e, 0.5, 0.05)
    np.testing.assert_allclose(
        run["sledge.vx"], 2.0 - 0.3 * G / 2 * run.time, rtol=1e-10
    )  # of least norm: half the weight
    said = [record.message for record in caplog.records]
    assert (
        sum("share the load of rough, so that its friction and the motion are not unique" in text for text in said) == 1
    )
    caplog.clear()
    stiffer = {p.name: 3e-6 if p.name.startswith("rough") else 1e-6 for p in e.compliances}
    run = alfmu.simulate(e, 0.5, 0.05, parameters=stiffer)
    np.testing.assert_allclose(run["rough.force"], 3.0 * G / 4, rtol=1e-10)
    np.testing.assert_allclose(run["sledge.vx"], 2.0 - 0.3 * G / 4 * run.time, rtol=1e-10)
    assert not caplog.records


def test_info_names_joints_whose_friction_is_not_unique(tmp_path, monkeypatch, capsys):
    path = tmp_path / "gliding.py"
    path.write_text("import test_friction\n\n\ndef gliding():\n    return test_friction.sledge()\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    assert main(["info", str(path), "--set", "solver.method=rk4"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "friction is not unique, nor is the motion, unless compliances settle it: rough" in lines


def test_what_is_switched_on_may_share_the_load_of_friction(caplog):
    """Only one guide of the sledge is closed at first: its friction is unique until the other one is closed, too."""
    m = sledge()
    m.release("smooth")
    i = initialized(alfmu.Instance(with_defaults(alfmu.derive(m), {"solver.method": "rk4"})), {"smooth.released": True})
    i.step(0.1)
    assert i.get("rough.friction_force") == pytest.approx(-0.3 * 3.0 * G, rel=1e-12)
    assert not caplog.records
    i.set("smooth.released", False)
    i.step(0.1)
    assert i.get("rough.friction_force") == pytest.approx(-0.3 * 3.0 * G / 2, rel=1e-12)
    assert "share the load of rough, so that its friction and the motion are not unique" in caplog.text


# FMUs ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["python", "native"])
def test_a_block_sticks_and_slides_in_an_fmu(tmp_path, kind, incline):
    path = alfmu.export(block(), tmp_path / "block.fmu", kind=kind)
    assert validate_fmu(str(path)) == []
    push = np.array([(0.0, 0.0), (0.5, 0.0), (0.5, 15.0), (2.0, 15.0)], [("time", "f8"), ("push", "f8")])
    names = ["block.position", "guide.friction_force", "guide.slip"]
    found = fmpy.simulate_fmu(str(path), stop_time=1.0, output_interval=0.05, input=push, output=names)
    library = alfmu.simulate(incline, 1.0, 0.05, inputs={"push": lambda t: 15.0 * (t > 0.475)}, held_rows=True)
    load = 2.0 * G * math.cos(TILT)
    a = (15.0 - 2.0 * G * math.sin(TILT) - COULOMB * load) / 2.0
    assert 2.0 * G * math.sin(TILT) + STATIC * load < 15.0
    late = np.maximum(found["time"] - 0.5, 0.0)
    np.testing.assert_allclose(found["block.position"], a * late**2 / 2, atol=1e-12)
    assert {0.0, 1.0} == set(found["guide.slip"])
    np.testing.assert_allclose(found["guide.friction_force"][-1], -COULOMB * load, rtol=1e-12)
    np.testing.assert_allclose(library["block.position"], found["block.position"], atol=1e-12)


def test_what_is_left_out_and_frozen_changes_no_number(incline):
    whole = alfmu.simulate(incline, 0.4, 0.05, parameters={"start.speed": 2.0})
    part = alfmu.simulate(
        incline, 0.4, 0.05, parameters={"start.speed": 2.0}, outputs=["block.position"], freeze=["all"]
    )
    assert part.names[0] == "block.position"
    np.testing.assert_allclose(part["block.position"], whole["block.position"], rtol=1e-13)


def test_directional_derivatives_feel_friction(tmp_path):
    """A force on a rotor changes the load of its journal, and with it the friction."""
    m = rotor()
    side = m.input("side", "N", start=30.0)
    m.force(m.bodies[0].at(0, 0), side, 0.0)
    path = alfmu.export(m, tmp_path / "rotor.fmu", kind="native", outputs=["disc.angular_acceleration"])
    description = fmpy.read_model_description(str(path))
    reference = {v.name: v.valueReference for v in description.modelVariables}
    fmu = fmpy.instantiate_fmu(fmpy.extract(str(path)), description, "CoSimulation")
    fmu.setupExperiment(startTime=0.0)
    fmu.enterInitializationMode()
    fmu.exitInitializationMode()
    found = fmu.getDirectionalDerivative([reference["disc.angular_acceleration"]], [reference["side"]], [1.0])
    fmu.terminate()
    fmu.freeInstance()
    assert found[0] == pytest.approx(-0.3 * RADIUS / INERTIA * 30.0 / math.hypot(30.0, MASS * G), rel=1e-7)


def test_a_state_is_kept_while_a_joint_sticks(incline):
    i = initialized(alfmu.Instance(incline), {"start.speed": -0.2, "coulomb": STATIC})
    i.step(0.1)
    moving = i.save()
    i.step(1.0)
    assert i.get("guide.slip") == 0.0
    rests, place = i.save(), i.get("block.position")
    i.restore(moving)
    assert i.get("guide.slip") == -1.0
    i.step(1.0)
    assert i.get("block.position") == place
    i.restore(rests)
    i.set("push", 60.0)
    i.step(0.1)
    assert i.get("guide.slip") == 1.0


def test_a_lock_lets_friction_hold_after_it(incline):
    """A joint that is locked while it slides sticks where the lock lets it go."""
    m = block()
    m.lock("guide")
    i = initialized(alfmu.Instance(m), {"start.speed": 1.0})
    i.step(0.05)
    i.set("guide.locked", True)
    i.step(0.05)
    place = i.get("block.position")
    i.set("guide.locked", False)
    i.step(0.5)
    assert i.get("guide.slip") == 0.0
    assert i.get("block.position") == pytest.approx(place, abs=1e-15)


def test_dry_friction_is_told_as_such_beside_a_lock_of_the_same_joint(capsys, tmp_path, monkeypatch):
    m = block()
    m.lock("guide")
    m.compliances()
    e = alfmu.derive(m)
    assert [row.text for row in e.rows] == ["guide dry friction", "guide locked"]
    assert {"guide.compliance.friction", "guide.compliance.locked"} == {x.name for x in e.compliances}
    assert {v.name: v.description for v in e.outputs}["multiplier[1]"] == "multiplier of guide, dry friction"
    monkeypatch.chdir(tmp_path)
    swing = (
        "m = alfmu.Mechanism('rub')\n    A = m.revolute('A', m.ground.at(), m.bar('rod', mass=1.0, length=1.0).start,"
    )
    swing += " coordinate=m.coordinate('th'))\n    m.friction(A, coulomb=0.2, radius=0.02)\n    return m\n"
    (tmp_path / "rub.py").write_text(f"import alfmu\n\n\ndef rub() -> alfmu.Mechanism:\n    {swing}")
    assert main(["info", "rub.py"]) == 0
    assert "constraints (1): A dry friction\n" in capsys.readouterr().out


def test_an_impact_says_that_dry_friction_takes_no_part_in_it(caplog):
    """A lock stops a bar on a block that slides on a guide that rubs."""
    m = block()
    th = m.coordinate("th", "rad", start=-1.0, rate=3.0, independent=True)
    bar = m.bar("bar", mass=1.0, length=0.7)
    m.lock(m.revolute("knee", m.bodies[0].at(), bar.start, coordinate=th))
    i = initialized(alfmu.Instance(m), {"start.speed": 1.0})
    i.step(0.05)
    assert not caplog.records
    i.set("knee.locked", True)
    i.step(0.01)
    assert i.get("monitor.energy_lost") > 0.1
    (record,) = caplog.records
    said = rf"an impact took {i.get('monitor.energy_lost'):.3g} J without a share of dry friction: .* such as guide"
    assert re.search(said, record.getMessage())


def test_a_lock_of_a_block_that_sticks_is_no_impact(caplog):
    m = block()
    m.lock("guide")
    i = initialized(alfmu.Instance(m), {"start.speed": 0.3})
    i.step(0.5)
    assert i.get("guide.slip") == 0.0
    i.set("guide.locked", True)
    i.step(0.01)
    assert i.get("monitor.energy_lost") <= 1e-30
    assert not caplog.records


# What is refused ----------------------------------------------------------------------------------------------------


def _declared(line: str) -> None:
    m = Mechanism("rubbing")
    a = m.coordinate("a", "rad", start=0.0)
    s = m.coordinate("s", "m", start=0.0)
    bar, block_ = m.bar("bar", mass=1.0, length=1.0), m.body("block", mass=1.0)
    hinge = m.revolute("hinge", m.ground.at(0, 0), bar.start, coordinate=a)
    guide = m.prismatic("guide", m.ground.at(0, 0), block_.at(0, 0), coordinate=s)
    eval(line, {"m": m, "hinge": hinge, "guide": guide})


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("m.friction(hinge, coulomb=0.2)", "a revolute joint is a journal; give its radius"),
        ("m.friction(hinge, coulomb=0.2, radius=0.1, length=0.1)", "give its radius .* and no length"),
        ("m.friction(guide, coulomb=0.2, radius=0.1)", "a prismatic joint has no radius"),
        ("m.friction(guide, radius=0.1)", "no coefficient; give coulomb"),
        ("m.friction(guide, coulomb=-0.1)", "coulomb of friction of guide is -0.1; it must not be negative"),
        ("m.friction(guide, coulomb='rough')", "coulomb of friction of guide is 'rough'; give a number"),
        ("m.friction(guide, coulomb=m.parameter('mu', 0.1) - 0.3)", "is -0.2; it must not be negative"),
        ("m.friction(guide, -2.0)", "the viscous coefficient of friction of guide is -2 N.s/m; it must not be"),
        ("m.friction(guide, coulomb=0.1, static=-0.2)", "static of friction of guide is -0.2; it must not be"),
        ("m.friction(guide, coulomb=0.3, static=0.2)", "static = 0.2 below coulomb = 0.3"),
        ("m.friction(guide, coulomb=0.3, stribeck=0.2)", "give static"),
        ("m.friction(guide, coulomb=0.3, static=0.4, stribeck=0.0)", "is 0 m/s; it must be above zero"),
        ("m.friction(hinge, coulomb=0.3, radius=-0.1)", "is -0.1 m; it must be above zero"),
        ("[m.friction(guide, coulomb=0.3), m.friction(guide, coulomb=0.3)]", "guide has dry friction already"),
    ],
)
def test_a_declaration_that_makes_no_sense_is_refused(line, said):
    with pytest.raises(DeclarationError, match=said):
        _declared(line)


def test_a_coefficient_that_is_a_parameter_is_not_negative_later_either():
    m, _, guide, *_ = sliding("m", place="x", independent=True)
    m.friction(guide, coulomb=m.parameter("mu", 0.3))
    m.gravity(0, -9.81)
    with pytest.raises(InputError, match=r"m: mu = -0.1 1 is outside"):
        alfmu.simulate(m, 0.1, 0.1, parameters={"mu": -0.1})


@pytest.mark.parametrize("kind", ["coulomb", "viscous"])
def test_a_coefficient_that_an_input_makes_negative_counts_as_none(kind):
    """On an incline of 0.3 rad a block slides as if there were no friction, and gains no energy by it."""
    m, _, guide, *_ = sliding("m", place="x", independent=True)
    m.friction(guide, **{kind: m.input("mu", {"coulomb": "1", "viscous": "N.s/m"}[kind], start=-0.2)})
    m.gravity(9.81 * np.sin(0.3), -9.81 * np.cos(0.3))
    run = alfmu.simulate(m, 1.0, 0.1)
    assert run["block.position"][-1] == pytest.approx(9.81 * np.sin(0.3) / 2, rel=1e-9)


def test_methods_without_dry_friction_are_refused_by_name(incline):
    with pytest.raises(
        InputError, match=r"trapezoidal does not support dry friction, which guide has; use rk4, order8"
    ):
        alfmu.simulate(incline, 0.1, 0.01, parameters={"solver.method": "trapezoidal"})
    with pytest.raises(InputError, match="the oracle has no dry friction, as guide has"):
        alfmu.simulate(incline, 0.1, 0.01, kernel="oracle")
    with pytest.raises(AlfmuError, match=r"dry friction needs the multiplier iteration of solver\.formulation"):
        alfmu.simulate(incline, 0.1, 0.01, parameters={"solver.method": "rk4", "solver.formulation": "penalty"})


def test_the_first_of_two_hinges_about_one_axis_slides_at_its_limit():
    """A growing torque on the second body; the first has a hundredth of its inertia. (I1 + I2) w' = r t - 0.1."""
    m, inertias, rate = Mechanism("coaxial"), (0.001, 0.1), 0.3
    first, second = (m.body(name, mass=1.0, inertia=x) for name, x in zip("ab", inertias, strict=True))
    for name, before, body, limit in (("A", m.ground, first, 0.1), ("B", first, second, 0.2)):
        angle = m.coordinate(f"q{name}", "rad", independent=True)
        m.friction(m.revolute(name, before.at(), body.at(), coordinate=angle), coulomb=limit, load=1.0)
    m.torque(second, rate * m.time)
    m.gravity(0.0, 0.0)
    run = alfmu.simulate(m, 0.6, 0.01, parameters={"solver.relative_tolerance": 1e-10})
    exact = rate * np.maximum(run.time - 0.1 / rate, 0.0) ** 3 / 6 / sum(inertias)
    for name in "ab":
        np.testing.assert_allclose(run[f"{name}.angle"], exact, atol=1e-9)


@pytest.mark.parametrize(("count", "told"), [(3, False), (12, True)])
def test_shares_of_joints_at_rest_that_do_not_settle_are_told(count, told, caplog):
    """Each of these hinges about one axis holds 0.3 N.m alone; 200 rounds are too few for shares of twelve."""
    m, before = Mechanism("coaxial"), None
    for k in range(count):
        body = m.body(f"b{k}", mass=1.0, inertia=0.1)
        angle = m.coordinate(f"q{k}", "rad", independent=True)
        hinge = m.revolute(f"J{k}", (before or m.ground).at(), body.at(), coordinate=angle)
        m.friction(hinge, coulomb=1.0 + 0.1 * k, load=1.0)
        before = body
    m.torque(before, 0.3)
    m.gravity(0.0, 0.0)
    assert np.abs(alfmu.simulate(m, 0.1, 0.05, outputs=["b0.angle"])["b0.angle"]).max() < 1e-12
    assert ("shares of friction at rest change by" in caplog.text) == told


def test_a_coaxial_chain_that_sticks_is_in_no_singular_position(caplog):
    """Uneven inertias: the last disc slides under T - c = 0.1 N.m, 1 rad/s2, and the others stay."""
    m = Mechanism("coaxial")
    before = m.ground
    for k, (inertia, coulomb) in enumerate(((1e-7, 1.0), (1e-4, 1.1), (0.1, 0.2))):
        disc = m.body(f"b{k}", mass=1.0, inertia=inertia)
        angle = m.coordinate(f"q{k}", "rad", independent=True)
        m.friction(m.revolute(f"J{k}", before.at(), disc.at(), coordinate=angle), coulomb=coulomb, load=1.0)
        before = disc
    m.torque(before, 0.3)
    m.gravity(0.0, 0.0)
    found = alfmu.simulate(m, 0.1, 0.05)
    assert found["b2.angle"] == pytest.approx(np.array(found["time"]) ** 2 / 2, abs=1e-9)
    assert abs(np.array(found["b1.angle"])).max() <= 1e-12
    assert not caplog.messages
