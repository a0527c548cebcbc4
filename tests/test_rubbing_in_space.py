"""Dry friction in space: a mechanism of the plane in space, closed forms of a hinge, a guide and a screw."""

import math
from functools import cache

import casadi as ca
import fmpy
import numpy as np
import pytest
from fmpy.validation import validate_fmu
from scipy.integrate import solve_ivp

import alfmu
from alfmu import Mechanism
from alfmu.model.errors import DeclarationError

G = 9.81
RK4 = {"solver.method": "rk4"}

# A mechanism of the plane --------------------------------------------------------------------------------------------


def crank(space: bool) -> Mechanism:
    """A crank, a massless rod and a slider, in the plane or in space."""
    l1, l2, offset = 0.3, 0.7, 0.1
    m = Mechanism("crank", "A slider-crank whose rod has no mass")
    begin = m.start("angle", 0.7, "rad", rate=9.0, rate_name="speed")
    reach = l1 * ca.cos(begin) + ca.sqrt(l2**2 - (l1 * ca.sin(begin)) ** 2)
    th, s = m.coordinate("th", "rad", start=begin), m.coordinate("s", "m", start=reach)
    if space:
        first = m.spatial_body("crank", mass=1.0, inertia=(0.01, 0.1, 0.1), center=(l1 / 2, 0, 0), relative=True)
        slider = m.spatial_body("slider", mass=2.0, inertia=(0.02, 0.03, 0.04), center=(0, offset, 0), relative=True)
        ground = m.spatial_ground.at()
        A = m.spatial_revolute("A", ground, first.at(), axis=(0, 0, 1), coordinate=th)
        guide = m.spatial_prismatic("guide", ground, slider.at(), axis=(1, 0, 0), coordinate=s)
        m.gravity(0, -G, 0)
    else:
        first = m.body("crank", mass=1.0, inertia=0.1, center=(l1 / 2, 0))
        slider = m.body("slider", mass=2.0, inertia=0.04, center=(0, offset))
        A = m.revolute("A", m.ground.at(0, 0), first.at(0, 0), coordinate=th)
        guide = m.prismatic("guide", m.ground.at(0, 0), slider.at(0, 0), coordinate=s)
        m.gravity(0, -G)
    m.distance("rod", first.at(l1, 0), slider.at(0, 0), length=l2)
    m.friction(A, coulomb=0.8, static=1.0, radius=0.1)
    m.friction(guide, 0.5, coulomb=0.25, length=0.2)
    m.drive(A, 3.0 * ca.sin(4.0 * m.time))
    return m


@pytest.mark.slow
def test_a_mechanism_of_the_plane_rubs_in_space_as_in_the_plane():
    plane, space = (alfmu.simulate(crank(x), 2.6, 0.05, parameters=RK4) for x in (False, True))
    assert {0.0, 1.0, -1.0} <= set(plane["A.slip"]) | set(plane["guide.slip"])
    for name in ("A.friction_torque", "guide.friction_force", "slider.velocity", "A.force.x"):
        np.testing.assert_allclose(space[name], plane[name], atol=1e-8, err_msg=name)
    for joint in ("A", "guide"):
        np.testing.assert_array_equal(space[f"{joint}.slip"], plane[f"{joint}.slip"])


# A hinge on a leaning axis -------------------------------------------------------------------------------------------

LEAN, MASS, ARM, ALONG, BEARINGS, COLLAR, RADIUS = 0.6, 3.0, 0.4, 0.15, 0.25, 0.06, 0.04
INERTIA = (0.05, 0.08, 0.11)
"""Of the arm, about its centre of mass: along it, across it, along the axis."""


def gate(relative: bool) -> Mechanism:
    """An arm on a hinge that leans; its centre of mass is `ARM` from the axis and `ALONG` beside the hinge."""
    m = Mechanism("gate", "An arm on a leaning hinge that rubs")
    mu = m.parameter("mu", 0.55, "1", minimum=0.0)
    begin = m.start("angle", 1.9, "rad")
    own = {"relative": True}
    if not relative:
        place = ARM * ca.cos(begin), ARM * ca.sin(begin), ALONG
        own = {"position": place, "attitude": (ca.cos(begin / 2), 0.0, 0.0, ca.sin(begin / 2))}
    arm = m.spatial_body("arm", mass=MASS, inertia=INERTIA, center=(ARM, 0.0, ALONG), **own)
    th = m.coordinate("th", "rad", start=begin) if relative else None
    hinge = m.spatial_revolute("hinge", m.spatial_ground.at(), arm.at(), axis=(0, 0, 1), coordinate=th)
    m.friction(hinge, coulomb=mu, radius=RADIUS, length=BEARINGS, collar=COLLAR)
    m.gravity(G * math.sin(LEAN), 0.0, -G * math.cos(LEAN))
    return m


def friction_of_gate(mu: float, th: float, rate: float, a: float) -> tuple[float, float]:
    """The size of its friction [N.m], and the torque without friction that the motion lacks, by Newton and Euler."""
    weight = MASS * G * np.array([math.sin(LEAN) * math.cos(th), -math.sin(LEAN) * math.sin(th), -math.cos(LEAN)])
    force = MASS * np.array([-ARM * rate**2, ARM * a, 0.0]) - weight
    moment = np.cross((ARM, 0.0, ALONG), force) + np.array([0.0, 0.0, INERTIA[2] * a])
    across = np.array([-moment[1], moment[0]]) / BEARINGS
    load = RADIUS * sum(np.hypot(*(force[:2] / 2 + way * across)) for way in (1, -1)) + COLLAR * abs(force[2])
    return mu * load, moment[2]


def swung(mu: float, times: np.ndarray) -> np.ndarray:
    """Angles (k,) of the arm from rest at 1.9 rad on until it sticks, by its one equation of motion."""
    found, t, th, way = np.full(len(times), np.nan), 0.0, 1.9, -1.0
    inertia, exactly = INERTIA[2] + MASS * ARM**2, {"rtol": 1e-11, "atol": 1e-12, "max_step": 0.05}
    while True:

        def motion(_: float, y: np.ndarray, way: float = way) -> list[float]:
            a = 0.0
            for _ in range(100):
                size, lacking = friction_of_gate(mu, y[0], y[1], a)
                before, a = a, a - (lacking + way * size) / inertia
                if abs(a - before) < 1e-13:
                    break
            return [y[1], a]

        def stops(_: float, y: np.ndarray, way: float = way) -> float:
            return y[1] * way

        stops.terminal, stops.direction = True, -1
        run = solve_ivp(motion, (t, times[-1]), (th, 1e-12 * way), "DOP853", events=stops, dense_output=True, **exactly)
        here = (times >= t) & (times <= run.t[-1])
        found[here] = run.sol(times[here])[0]
        if run.status == 0:
            return found
        t, th = run.t[-1], run.y[0, -1]
        size, lacking = friction_of_gate(mu, th, 0.0, 0.0)
        if abs(lacking) <= size:
            found[times >= t] = th
            return found
        way = -np.sign(lacking)


@pytest.mark.slow
@pytest.mark.parametrize("relative", [True, False])
def test_a_heavy_arm_on_a_leaning_hinge_swings_until_it_sticks(relative):
    run = alfmu.simulate(gate(relative), 3.0, 0.1, parameters=RK4 | {"solver.step_size": 0.01})
    exact = swung(0.55, run.time)
    np.testing.assert_allclose(run["hinge.angle"], exact, atol=2e-7)
    rest = run["hinge.slip"] == 0
    assert rest[1:].sum() > 5
    assert {1.0, -1.0} < set(run["hinge.slip"])
    assert np.abs(run["hinge.angular_velocity"][rest]).max() < 1e-13
    assert abs(run["hinge.angle"][-1]) > 0.01
    assert run["monitor.step_error"].max() < 1e-5


# A guide with a key --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(("axis", "relative"), [((1.0, 0.0, 0.0), False), ((0.6, 0.0, -0.8), True)])
def test_a_guide_carries_moments_by_edges_and_a_key(axis, relative):
    """A block whose centre of mass is beside its guide is thrown along it; what its friction does is constant."""
    mass, center, length, key, mu = 2.0, np.array([0.05, 0.1, -0.2]), 0.3, 0.02, 0.15
    m = Mechanism("block", "A block on a guide with a key")
    place = m.start("place", 0.0, "m", rate=3.0)
    own = (
        {"relative": True}
        if relative
        else {"position": tuple(c + x * place for c, x in zip(center, axis, strict=True))}
    )
    block = m.spatial_body("block", mass=mass, inertia=(0.1, 0.2, 0.25), center=tuple(center), **own)
    s = m.coordinate("s", "m", start=place) if relative else None
    guide = m.spatial_prismatic("guide", m.spatial_ground.at(), block.at(), axis=axis, coordinate=s)
    m.friction(guide, coulomb=mu, length=length, radius=key)
    m.gravity(0, 0, -G)
    run = alfmu.simulate(m, 0.3, 0.05, parameters=RK4)
    along = np.array(axis)
    # Edges and key carry the weight and what slows the block down, which is affine in the friction R: R = mu L(R).
    R = 0.0
    for _ in range(200):
        a = G * -along[2] - R / mass
        needed = mass * (a * along + (0, 0, G))  # all on the block but its weight, friction included
        moment = np.cross(center, needed)
        across = needed - along * (along @ needed)
        couple = np.cross(along, moment) / length
        load = sum(np.linalg.norm(across / 2 + way * couple) for way in (1, -1)) + abs(along @ moment) / key
        R = mu * load
    np.testing.assert_allclose(run["guide.friction_force"], -R, rtol=1e-11)
    np.testing.assert_allclose(run["block.velocity"], 3.0 + a * run.time, rtol=1e-11)


# A screw -------------------------------------------------------------------------------------------------------------


@cache
def loaded_screw() -> Mechanism:
    m = Mechanism("jack", "A load on a screw")
    mu, torque = m.parameter("mu", 0.15, "1"), m.parameter("torque", 0.0, "N.m")
    lead = 2 * math.pi * PITCH
    nut = m.spatial_body("nut", mass=NUT[0], inertia=(0.1, 0.1, NUT[1]), relative=True)
    th = m.coordinate("th", "rad", start=0.0)
    screw = m.spatial_screw("screw", m.spatial_ground.at(), nut.at(), axis=(0, 0, 1), lead=lead, coordinate=th)
    m.friction(screw, coulomb=mu, radius=THREAD)
    m.drive(screw, torque)
    m.gravity(0, 0, -G)
    return m


@pytest.fixture(scope="module")
def jack() -> alfmu.Equations:
    return alfmu.derive(loaded_screw())


NUT, PITCH, THREAD = (500.0, 0.15), 2e-3, 0.02
"""Mass [kg] and inertia [kg.m2] of the nut; way in a radian and radius of the thread [m]."""


@pytest.mark.parametrize(("mu", "way"), [(0.15, 1.0), (0.15, -1.0), (0.08, -1.0)])
def test_a_screw_takes_the_torque_of_its_angle_of_friction(jack, mu, way):
    """W r tan(rise + way phi) moves the load W; below it, or with a rise below phi and no torque, the screw holds."""
    rise, phi = math.atan(PITCH / THREAD), math.atan(mu)
    weight = NUT[0] * G
    least = weight * THREAD * math.tan(rise + way * phi)
    assert (least < 0) == (way < 0 and mu > PITCH / THREAD)
    held, moved = (least + x for x in (-way * 1e-3, way * 1.0))
    run = alfmu.simulate(jack, 0.5, 0.1, parameters=RK4 | {"mu": mu, "torque": held})
    assert np.abs(run["screw.angular_velocity"]).max() < 1e-15
    run = alfmu.simulate(jack, 0.5, 0.1, parameters=RK4 | {"mu": mu, "torque": moved})
    # The load is that of the weight and of its own acceleration: J a = torque - (m g + m p a) r tan(rise + way phi).
    arm = THREAD * math.tan(rise + way * phi)
    a = (moved - weight * arm) / (NUT[1] + NUT[0] * PITCH * arm)
    np.testing.assert_allclose(run["screw.angle"], a * run.time**2 / 2, rtol=1e-9)
    assert set(run["screw.slip"]) == {way}


def test_a_screw_that_locks_itself_holds_its_load(jack):
    run = alfmu.simulate(jack, 1.0, 0.1, parameters=RK4)
    assert set(run["screw.slip"]) == {0.0}
    assert np.abs(run["screw.angular_velocity"]).max() < 1e-15
    np.testing.assert_allclose(run["screw.friction_torque"], NUT[0] * G * PITCH, rtol=1e-12)


@pytest.mark.parametrize("kind", ["python", "native"])
def test_a_screw_rubs_in_an_fmu(tmp_path, jack, kind):
    path = alfmu.export(loaded_screw(), tmp_path / "jack.fmu", kind=kind, parameters=RK4)
    assert validate_fmu(str(path)) == []
    torque = NUT[0] * G * THREAD * math.tan(math.atan(PITCH / THREAD) + math.atan(0.15)) + 1.0
    names = ["screw.angle", "screw.slip", "screw.force.z"]
    given = {"torque": torque}
    found = fmpy.simulate_fmu(str(path), stop_time=0.5, output_interval=0.1, start_values=given, output=names)
    library = alfmu.simulate(jack, 0.5, 0.1, parameters=RK4 | given)
    for name in names:
        np.testing.assert_allclose(found[name], library[name], rtol=1e-14)
    assert set(found["screw.slip"]) == {1.0}


# Loads that are shared -----------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def door() -> alfmu.Equations:
    """A door on two hinges with collars, which share its weight."""
    m = Mechanism("door", "A door on two hinges")
    ground, z = m.spatial_ground, (0, 0, 1)
    place = {"position": (0.4, 0.0, 0.0)}
    body = m.spatial_body("door", mass=20.0, inertia=(3.0, 4.0, 1.2), center=(0.4, 0, 0), **place)
    for name, height in (("low", -0.9), ("top", 0.8)):
        hinge = m.spatial_revolute(name, ground.at(0, 0, height), body.at(0, 0, height), axis=z)
        m.friction(hinge, coulomb=0.2, radius=0.01, collar=0.02)
    m.torque(body, (0.0, 0.0, 4.0))
    m.gravity(0, 0, -G)
    m.compliances()
    return alfmu.derive(m)


@pytest.mark.slow
def test_friction_of_two_hinges_of_a_door_is_not_unique(door, caplog):
    run = alfmu.simulate(door, 0.2, 0.1, parameters=RK4)
    assert "share the load of low, top, so that its friction and the motion are not unique" in caplog.text
    softer = {c.name: 2e-6 if c.name.startswith("low") else 1e-6 for c in door.compliances}
    caplog.clear()
    settled = alfmu.simulate(door, 0.2, 0.1, parameters=RK4 | softer)
    assert not caplog.records
    for each in (run, settled):
        for joint in ("low", "top"):
            across = np.hypot(each[f"{joint}.force.x"], each[f"{joint}.force.y"])
            load = 0.01 * across + 0.02 * np.abs(each[f"{joint}.force.z"])
            np.testing.assert_allclose(each[f"{joint}.friction_torque"], -0.2 * load, rtol=1e-9)
        np.testing.assert_allclose(each["low.force.z"] + each["top.force.z"], 20.0 * G, rtol=1e-12)
    # Of two hinges beside each other the stiffer one takes more of the weight.
    np.testing.assert_allclose(settled["top.force.z"], 20.0 * G * 2 / 3, rtol=1e-9)


# What is refused -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("m.friction(hinge, coulomb=0.2)", "hinge: a revolute joint is a journal; give its radius"),
        ("m.friction(slide, coulomb=0.2, collar=0.1)", "slide: a prismatic joint has no collar"),
        ("m.friction(screw, coulomb=0.2)", "screw: a screw takes the radius"),
        (
            "m.friction(sleeve.freedom('angle'), coulomb=0.2, radius=0.1)",
            "sleeve: a cylindrical joint can slide in several directions .angle and position., .* one free motion each",
        ),
        ("m.friction(sleeve, coulomb=0.2, radius=0.1)", "sleeve: a cylindrical joint can slide in several directions"),
        ("m.friction(ball, coulomb=0.2, radius=0.1)", "ball: a spherical joint can slide in several directions"),
    ],
)
def test_friction_that_a_joint_in_space_cannot_have_is_refused(line, said):
    m = Mechanism("space")
    on = [m.spatial_body(f"b{i}", mass=1.0, inertia=(1.0,) * 3).at() for i in range(4)]
    ground, axis = m.spatial_ground.at(), (0, 0, 1)
    hinge = m.spatial_revolute("hinge", ground, on[0], axis=axis)
    slide = m.spatial_prismatic("slide", ground, on[1], axis=axis)
    screw = m.spatial_screw("screw", ground, on[2], axis=axis, lead=0.01)
    sleeve = m.cylindrical("sleeve", ground, on[3], axis=axis)
    ball = m.spherical("ball", on[0], on[1])
    with pytest.raises(DeclarationError, match=said):
        eval(line, {"m": m, "hinge": hinge, "slide": slide, "screw": screw, "sleeve": sleeve, "ball": ball})
