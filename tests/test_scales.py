"""Mechanisms of any size, mass and place; constraints that hardly agree; runs that come to lie on singular positions.

Right values are those of one equation of motion by DOP853, or in closed form.
"""

import re
from copy import deepcopy
from functools import cache

import casadi as ca
import numpy as np
import pytest
import turned
from numpy.typing import NDArray
from oracles import ode
from pairs import ALL
from scenes import initialized
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import alfmu
from alfmu import Mechanism
from alfmu.equations.sums import rearranged
from alfmu.kernel.complete import complete
from alfmu.runtime.pipeline import ready
from alfmu.runtime.probe import Probe
from alfmu.simulation import Result

STEPS = 30
TIGHT = {"solver.relative_tolerance": 1e-9}
SIZES = ((1.0, 1.0), (1e-2, 1e6), (1e-4, 1e-9), (4e-6, 1.0), (1e4, 1e6))
"""Lengths [m] and masses [kg]."""


def unit(mechanism: Mechanism, outputs: list[str] | None = None) -> alfmu.Instance:
    """One instance for many runs."""
    scene, _ = ready(alfmu.derive(mechanism), {}, outputs, None, "vm")
    return alfmu.Instance(scene)


def angles(i: alfmu.Instance, times: NDArray, values: dict[str, float], torque: float = 0.0, of: str = "crank.angle"):
    """The angle at all times, of a run begun anew."""
    i._unit.reset()
    for name, value in values.items():
        i.set(name, value)
    inputs = ["A.torque"] * bool(torque)
    found, error = i.run(times, inputs, np.full((len(times), len(inputs)), torque), [of])
    if error:
        raise error
    return found[:, 0]


def crank(l1: float, gravity: float, torque: float, start: tuple[float, float], times: NDArray) -> NDArray:
    """Angle of a slider-crank of masses of 1 kg, a rod of 1 m and a crank of l1; mirrored where both are alike."""

    def rate(t: float, y: NDArray) -> list[float]:
        s, c = np.sin(y[0]), np.cos(y[0])
        sp = -l1 * s
        cp = c if l1 == 1.0 else np.sqrt(1 - sp**2)
        p1 = -1.0 if l1 == 1.0 else -l1 * c / cp
        bend = 0.0 if l1 == 1.0 else (l1 * s + sp * p1**2) / cp
        x = -l1 * s - sp * p1 / 2, -l1 * c - (cp * p1**2 + sp * bend) / 2
        y2 = l1 * c / 2, -l1 * s / 2
        x3 = -l1 * s - sp * p1, -l1 * c - (cp * p1**2 + sp * bend)
        inertia = l1**2 / 3 + x[0] ** 2 + y2[0] ** 2 + p1**2 / 12 + x3[0] ** 2
        slope = x[0] * x[1] + y2[0] * y2[1] + p1 * bend / 12 + x3[0] * x3[1]
        return [y[1], (torque - gravity * l1 * c - slope * y[1] ** 2) / inertia]

    return solve_ivp(rate, (0, times[-1]), start, "DOP853", times, rtol=1e-13, atol=1e-13).y[0]


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["absolute", "joint", "mixed", "natural"])
def test_a_slider_crank_of_any_size_and_mass_moves_alike(coordinates):
    i = unit(alfmu.load("slider_crank", coordinates=coordinates))
    times = np.arange(STEPS + 1) / 10
    right = crank(0.5, 9.81, 0.0, (0.8, 4.0), times)
    for length, mass in SIZES:
        second = length**0.5
        values = {"l1": length / 2, "l2": length, "m1": mass, "m2": mass, "m3": mass, "start.angle": 0.8}
        values |= {"start.angular_velocity": 4 / second, "solver.relative_tolerance": 1e-9}
        assert np.abs(angles(i, second * times, values) - right).max() <= 3e-9, (length, mass)


def test_a_pendulum_on_a_trolley_of_any_size_and_mass_moves_alike():
    """An open chain, whose small bodies have masses all the same."""
    m = Mechanism("trolley")
    length, mass = m.parameter("length", 1.0, "m"), m.parameter("mass", 1.0, "kg")
    x, th = m.coordinate("x", "m", independent=True), m.coordinate("th", start=0.3, independent=True)
    trolley, bar = m.body("trolley", mass=mass), m.bar("bar", mass=mass, length=length)
    m.prismatic("guide", m.ground.at(0, 0), trolley.at(0, 0), coordinate=x)
    m.revolute("hinge", trolley.at(0, 0), bar.start, coordinate=th)
    m.gravity(0, -9.81)

    def rate(t: float, y: NDArray) -> NDArray:
        s, c = np.sin(y[1]), np.cos(y[1])
        forces = [c * y[3] ** 2 / 2, -9.81 * c / 2]
        return np.array([y[2], y[3], *np.linalg.solve([[2.0, -s / 2], [-s / 2, 1 / 3]], forces)])

    i, times = unit(m), np.arange(STEPS + 1) / 10
    right = solve_ivp(rate, (0, times[-1]), [0, 0.3, 0, 0], "DOP853", times, rtol=1e-13, atol=1e-13).y[1]
    for size, heavy in SIZES:
        values = {"length": size, "mass": heavy, "solver.relative_tolerance": 1e-9}
        assert np.abs(angles(i, size**0.5 * times, values, of="bar.angle") - right).max() <= 1e-7, (size, heavy)


@pytest.mark.slow
def test_a_linkage_in_space_of_any_size_moves_alike():
    i, times, found = unit(alfmu.load("bennett")), np.arange(21) / 10, []
    for size in (1.0, 1e-5, 1e3):
        second = size**0.5
        values = {"a": 0.3 * size, "start.angular_velocity": 3.0 / second, "solver.relative_tolerance": 1e-9}
        found.append(angles(i, second * times, values, of="hinge1.angle"))
    assert max(np.abs(each - found[0]).max() for each in found) <= 1e-9


@cache
def four_bar(bodies: bool) -> Mechanism:
    """Four-bar of torn-off bodies or of points, whose base begins at (o, o); its bars are as long as L has it."""
    m = Mechanism("somewhere")
    L, o = m.parameter("L", 1.0, "m"), m.parameter("o", 0.0, "m")
    th = m.start("angle", 0.8, "rad", rate=4.0)
    A, D = m.ground.at(o, o), m.ground.at(o + 1.2 * L, o)
    bx, by = o + L / 2 * ca.cos(th), o + L / 2 * ca.sin(th)

    def at(name: str, x: ca.SX, y: ca.SX) -> tuple[ca.SX, ca.SX]:
        return m.coordinate(f"{name}x", "m", start=x), m.coordinate(f"{name}y", "m", start=y)

    if bodies:
        a, b, c = (
            m.bar(name, mass=1.0, length=length, pose=(*at(name, x, y), m.coordinate(f"{name}t", "rad", start=angle)))
            for name, length, x, y, angle in (
                ("crank", L / 2, (o + bx) / 2, (o + by) / 2, th),
                ("b", 0.9 * L, o + 0.65 * L, o + 0.6 * L, 0.6),
                ("c", L, o + 1.1 * L, o + 0.45 * L, 1.8),
            )
        )
        for name, one, other in (("A", A, a.start), ("B", a.end, b.start), ("C", b.end, c.end), ("D", D, c.start)):
            m.revolute(name, one, other)
    else:
        B, C = m.point(*at("B", bx, by)), m.point(*at("C", o + L, o + 0.9 * L))
        m.tie(th, ca.atan2((B.y - o) / L, (B.x - o) / L))
        m.bar("crank", mass=1.0, length=L / 2, between=(A, B))
        m.bar("b", mass=1.0, length=0.9 * L, between=(B, C))
        m.bar("c", mass=1.0, length=L, between=(C, D))
    m.gravity(0.0, -9.81)
    return m


@pytest.mark.slow
@pytest.mark.parametrize("bodies", [True, False], ids=["bodies", "points"])
def test_a_place_far_from_the_origin_changes_no_motion(bodies):
    i = unit(four_bar(bodies))
    times = np.arange(STEPS + 1) / 10
    here, there = (angles(i, times, {"o": o, "solver.relative_tolerance": 1e-10}) for o in (0.0, 100.0))
    assert np.abs(there - here).max() <= 5e-9


def test_bodies_that_joints_carry_take_no_more_steps_far_from_the_origin():
    """A four-bar in joint coordinates: the loop is closed from pivot to pivot, and not from the origin."""

    def moved(at: float) -> Result:
        m = Mechanism("far")
        crank, rod, rocker = (m.bar(f"bar{k}", mass=1.0, length=length) for k, length in enumerate((0.5, 0.9, 1.0)))
        th = m.coordinate("th", "rad", start=0.8, rate=4.0, independent=True)
        m.revolute("A", m.ground.at(at, -at / 2), crank.start, coordinate=th)
        m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("bend", "rad", start=-0.2))
        side = m.coordinate("side", "rad", start=1.8)
        m.revolute("D", m.ground.at(at + 1.25, -at / 2), rocker.start, coordinate=side)
        m.revolute("C", rod.end, rocker.end)
        m.gravity(0.0, -9.81)
        return alfmu.simulate(m, 2.0, 0.02, parameters=TIGHT)

    here, there = moved(0.0), moved(4096.0)
    assert there["bar0.angle"] == pytest.approx(here["bar0.angle"], abs=1e-9)
    assert there.counters.evaluations <= 1.2 * here.counters.evaluations


@cache
def of_points(tilt: float) -> Result:
    """A run of the slider-crank of `crank` in natural coordinates, with a particle for its slider, on a tilted line."""
    m, along = Mechanism("points"), np.array([np.cos(tilt), np.sin(tilt)])
    th = m.start("angle", 0.8, "rad", rate=4.0)
    places = 0.3 * np.array([np.cos(0.8 + tilt), np.sin(0.8 + tilt)]), 1.19 * along
    B, C = (
        m.point(*(m.coordinate(f"{name}{axis}", "m", start=x) for axis, x in zip("xy", place, strict=True)))
        for name, place in zip("BC", places, strict=True)
    )
    m.tie(th, ca.atan2(B.y * along[0] - B.x * along[1], B.x * along[0] + B.y * along[1]))
    m.bar("crank", mass=1.0, length=0.3, between=(m.ground.at(0, 0), B))
    rod = m.bar("rod", mass=1.0, length=1.0, between=(B, C))
    m.kinetic_energy((m.rate(C.x) ** 2 + m.rate(C.y) ** 2) / 2)
    m.potential_energy(9.81 * (C.y * along[0] - C.x * along[1]))
    m.point_on_line("guide", m.ground.at(0, 0), rod.end, axis=tilt)
    m.gravity(9.81 * np.sin(tilt), -9.81 * np.cos(tilt))
    return alfmu.simulate(m, 2.0, 0.01, parameters=TIGHT)


@pytest.mark.parametrize("tilt", [1e-4, 0.005, 0.01, 0.02, 1.56])
def test_a_coordinate_held_by_a_small_coefficient_makes_no_position_singular(tilt):
    """The end of the rod hardly moves across the line: at dead centres, where the crank's does not move along it."""
    r, level = of_points(tilt), of_points(0.0)
    assert np.abs(r["crank.angle"] - tilt - crank(0.3, 9.81, 0.0, (0.8, 4.0), r.time)).max() <= 1e-8
    assert r["monitor.singular"].max() == 0.0
    assert r["guide.force"] == pytest.approx(level["guide.force"], abs=1e-6 * np.abs(level["guide.force"]).max())


@cache
def propped(posed: bool) -> Mechanism:
    """A heavy arm on the ground, propped by a rod on a light slide, all in proportion to L."""
    m = Mechanism("propped")
    L = m.parameter("L", 1.0, "m")
    pose = [m.coordinate(c, "m", start=x * L) for c, x in (("x", -0.5), ("y", -0.37))] if posed else []
    angle = m.coordinate("angle", "rad", start=1.614)
    slide = m.body("slide", mass=0.375, inertia=3.5e-3 * L**2)
    arm = m.body(
        "arm", mass=16.0, inertia=1.84 * L**2, center=(-0.03 * L, 0.14 * L), pose=(*pose, angle) if posed else None
    )
    guided = {"axis": 1.958, "offset": -0.078 * L, "angle": -2.2286}
    along = m.coordinate("along", "m", start=-0.126, independent=True)
    m.prismatic("guide", m.ground.at(-0.2 * L, -0.22 * L), slide.at(0.39 * L, 0.27 * L), coordinate=along, **guided)
    m.revolute("pivot", m.ground.at(0.02 * L, 0), arm.at(0.31 * L, -0.39 * L), coordinate=None if posed else angle)
    m.distance("rod", slide.at(0.42 * L, 0.22 * L), arm.at(0.26 * L, -0.48 * L), length=0.348 * L)
    m.gravity(0.0, -9.81 * L)
    return m


@pytest.mark.parametrize("L", [1.0, 0.1, 0.03, 0.001])
def test_a_heavy_arm_that_moves_a_light_slide_hardly_is_the_same_in_all_sizes(L):
    """The slide tells the motion hardly, so that the pivot of its mass is above that of a constraint."""
    exact, r = (
        alfmu.simulate(propped(posed), 1.0, 0.1, parameters={"L": l, "start.along": -0.126 * l, **TIGHT})
        for l, posed in ((1.0, False), (L, True))
    )
    assert r["arm.angle"] == pytest.approx(exact["arm.angle"], abs=1e-8)


@cache
def whipped(posed: bool) -> Mechanism:
    """An arm that a light rod turns round: it passes a singular position closely, and turns within 1 ms there."""
    m = Mechanism("whipped")
    L = m.parameter("L", 1.0, "m")
    turn, other = (
        m.coordinate("turn", "rad", start=-0.3755, independent=True),
        m.coordinate("other", "rad", start=-2.9314),
    )
    place = [m.coordinate(name, "m", start=x * L) for name, x in (("x", 0.266), ("y", 0.046))] if posed else []
    arm = m.body("arm", mass=0.4, inertia=0.084 * L**2, center=(0.16 * L, 0.027 * L))
    pose = (*place, other) if posed else None
    rod = m.body("rod", mass=3.4e-3, inertia=3.9e-4 * L**2, center=(0.2285 * L, 0.1312 * L), pose=pose)
    m.revolute("A", m.ground.at(0, 0), arm.at(-0.284 * L, -0.156 * L), coordinate=turn)
    pivot = m.ground.at(-0.821 * L, 0.0161 * L), rod.at(1.3018 * L, -0.0711 * L)
    m.revolute("B", *pivot, coordinate=None if posed else other)
    m.distance("link", arm.at(0.0762 * L, -0.0534 * L), rod.at(0.1004 * L, 0.2578 * L), length=0.053 * L)
    m.gravity(0.0, -9.81 * L)
    return m


@pytest.mark.parametrize("L", [0.3, 0.03])
def test_a_motion_that_passes_a_singular_position_closely_takes_no_limit_there(L):
    """Limits there are those of another motion, through the singular position."""
    exact, r = (
        alfmu.simulate(whipped(posed), 0.5, 0.01, parameters={"L": size}) for size, posed in ((1.0, False), (L, True))
    )
    assert r["arm.angle"] == pytest.approx(exact["arm.angle"], abs=1e-7)


@pytest.mark.parametrize("coordinates", ["absolute", "joint"])
def test_a_torque_turns_a_slider_crank_of_any_size_and_mass_in_proportion(coordinates):
    """By the reduced inertia; a torque of 1 N.m turns a crank of a nanogram with 1e17 rad/s2."""
    m = alfmu.load("slider_crank", coordinates=coordinates)
    far, high = 0.5 * np.sin(0.8), 0.5 * np.cos(0.8)
    turn = high / np.sqrt(1 - far**2)  # the rod turns back by so much of the crank's angle
    slid = far + far * turn
    inertia = 0.25 / 3 + (far + far * turn / 2) ** 2 + (high / 2) ** 2 + turn**2 / 12 + slid**2
    for length, mass in SIZES:
        values = {"l1": length / 2, "l2": length, "m1": mass, "m2": mass, "m3": mass, "start.angle": 0.8}
        found = alfmu.linearize(m, parameters={**values, "start.angular_velocity": 0.0}, outputs=["crank.angle"])
        assert found.B[1, 0] * mass * length**2 == pytest.approx(1 / inertia, rel=1e-9), (length, mass)


@pytest.mark.slow
@pytest.mark.parametrize("bodies", [True, False], ids=["bodies", "points"])
def test_a_place_far_from_the_origin_changes_no_position_of_rest(bodies):
    here, there = (
        alfmu.equilibrium(four_bar(bodies), parameters={"L": 1e-3, "o": o, "start.angle_rate": 0.0})
        for o in (0.0, 100.0)
    )
    assert len(here) > 1
    size = np.abs(here[0].eigenvalues).max()
    for one, other in zip(here, there, strict=True):
        assert one.stability == other.stability
        assert np.abs(one.eigenvalues - other.eigenvalues).max() <= 1e-6 * size


def crank_rocker() -> Mechanism:
    """Bars with coordinates of their own, in a field in proportion to the size: angles and times are those of 1 m."""
    m = Mechanism("crank_rocker")
    size = m.parameter("size", 1.0, "m")
    A, B, C = np.array([[0.06 * np.cos(2.0), 0.06 * np.sin(2.0)], [0.45, 0.1], [0.5, -0.3]])
    bars = []
    for name, start, end in (("crank", 0 * A, A), ("rod", A, B), ("rocker", C, B)):
        (x, y), (dx, dy) = (start + end) / 2, end - start
        place = [m.coordinate(f"{name}.{k}", "m", start=at * size) for k, at in (("X", x), ("Y", y))]
        free = {"rate": 12.0, "independent": True} if name == "crank" else {}
        turn = m.coordinate(f"{name}.turn", start=np.arctan2(dy, dx), **free)
        bars.append(m.bar(name, mass=1.0, length=size * np.hypot(dx, dy), pose=(*place, turn)))
    crank, rod, rocker = bars
    m.revolute("O", m.ground.at(0, 0), crank.start)
    m.revolute("A", crank.end, rod.start)
    m.revolute("B", rod.end, rocker.end)
    m.revolute("C", m.ground.at(C[0] * size, C[1] * size), rocker.start)
    m.gravity(0, -9.81 * size)
    return m


def in_all_sizes(m: Mechanism, angle: str, sizes: tuple[float, ...]) -> None:
    """Runs at these sizes are that of 1 m within 1e-6 rad, in as many evaluations to a tenth."""
    one, *others = (alfmu.simulate(m, 1.0, 0.02, parameters={"size": x}) for x in (1.0, *sizes))
    for run in others:
        assert np.abs(run[angle] - one[angle]).max() <= 1e-6
        assert run.counters.evaluations <= 1.1 * one.counters.evaluations


def test_a_motion_near_a_singular_position_takes_as_many_evaluations_in_all_sizes():
    in_all_sizes(crank_rocker(), "crank.angle", (0.1, 1e-3, 1e3))


def sprung_arms(far: float, tunable: bool = False) -> Mechanism:
    """Two arms on hinges, and a spring between their ends that the user writes by their places."""
    m, arms = Mechanism("sprung_arms"), []
    away = m.parameter("away", far, "m") if tunable else far
    for k in range(2):
        arms.append(m.bar(f"arm{k}", mass=0.05, length=0.05))
        free = {"start": 1.2 + 0.4 * k, "rate": 3.0 - 6 * k, "independent": True}
        m.revolute(
            f"A{k}", m.ground.at(away + 0.03 * k, -away), arms[k].start, coordinate=m.coordinate(f"a{k}", **free)
        )
    (x1, y1), (x2, y2) = (arm.end.position for arm in arms)
    length = ca.sqrt((x2 - x1) ** 2 + (y2 - y1) ** 2)
    force = 2e4 * (length - 0.03) / length
    m.force(arms[0].end, force * (x2 - x1), force * (y2 - y1))
    m.force(arms[1].end, force * (x1 - x2), force * (y1 - y2))
    return m


@pytest.mark.filterwarnings("ignore:sprung_arms.*if millimetres were meant")
@pytest.mark.parametrize("tunable", [False, True])
def test_places_that_a_user_subtracts_are_as_exact_far_from_the_origin(tunable):
    """A step of 1e-14 m, the last digit of places at 70 m, would be 2e-10 N of this spring."""
    there = alfmu.derive(sprung_arms(70.0, tunable))
    for angles in np.random.default_rng(0).uniform(-3, 3, (20, 2)):
        ends = 0.05 * np.array([np.cos(angles), np.sin(angles)])
        way = ends[:, 1] - ends[:, 0] + [0.03 if tunable else 70.03 - 70.0, 0.0]
        pull = 2e4 * (np.hypot(*way) - 0.03) * way / np.hypot(*way)
        torques = [sign * (e[0] * pull[1] - e[1] * pull[0]) for sign, e in zip((1, -1), ends.T, strict=True)]
        found = np.array(there.functions["f"](angles, np.zeros(2), [], [70.0] * tunable, 0.0)).ravel()
        assert np.abs(found - torques).max() <= 1e-13
    tight = {"solver.relative_tolerance": 1e-9}
    here, away = (alfmu.simulate(sprung_arms(x, tunable), 0.03, 0.005, parameters=tight) for x in (0.0, 70.0))
    assert away.counters.evaluations <= 1.1 * here.counters.evaluations
    assert np.abs(away["arm0.angle"] - here["arm0.angle"]).max() <= 1e-9


def test_sums_of_places_stay_as_short_as_they_are_given():
    """Each sum has as many places as the two before it, 196418 in all; 1e308 + 1e308 is infinite."""
    x, y = ca.SX.sym("x"), ca.SX.sym("y")
    one, other = x, x + y
    for _ in range(24):
        one, other = other, one + other
    given = ca.vertcat(other, (y + 1e308) + 1e308, (x + y) - (100 + x))
    f = ca.Function("f", [x, y], [rearranged([x, y], given, 16.0, {(0, 0), (1, 0)})])
    assert f.n_instructions() < 400
    assert f(1, 2).full().ravel().tolist() == [121393 + 2 * 75025, np.inf, -98.0]


def turned_rocker() -> Mechanism:
    """A crank-rocker in joint coordinates, turned."""
    m = Mechanism("turned_rocker")
    turn = m.parameter("turn", 0.0, "rad")
    crank, rod, rocker = (
        m.bar(name, mass=1.0, length=x) for name, x in (("crank", 0.06), ("rod", 0.5), ("rocker", 0.4))
    )
    hinge = m.ground.at(0.6 * ca.cos(turn), 0.6 * ca.sin(turn))
    m.revolute("O", m.ground.at(0, 0), crank.start, coordinate=m.coordinate("a", start=2.0, independent=True))
    m.revolute("A", crank.end, rod.start, coordinate=m.coordinate("b", start=-1.5))
    m.revolute("C", hinge, rocker.start, coordinate=m.coordinate("c", start=2.0 + turn))
    m.revolute("B", rod.end, rocker.end)
    return m


def test_whether_constraints_depend_on_each_other_is_judged_alike_in_all_directions():
    random = np.random.default_rng(0)
    places = random.uniform(0, 2 * np.pi, (300, 3))
    near = np.pi * random.integers(0, 2, (300, 2)) + 10 ** random.uniform(-3, 0, (300, 2))
    places[:, 1], places[:, 2] = near[:, 0], places[:, 0] + near[:, 0] + near[:, 1]  # bars almost in line

    i = unit(turned_rocker(), ["rod.angle"])
    irregular = complete(i.equations).functions["irregular"]

    def judged(turn: float) -> list[float]:
        i._unit.reset()
        initialized(i, {"turn": turn, "start.a": 2.0 + turn})
        return [float(irregular(q + turn * np.array([1, 0, 1]), [turn], i.memory["k"])) for q in places]

    here = judged(0.0)
    assert 0 < sum(here) < len(here)
    for turn in (0.4, 1.1, 2.0, -0.7):
        assert judged(turn) == here


def four_bar_in_the_plane(turn: float) -> Mechanism:
    """A four-bar in absolute coordinates, turned."""
    m, random = Mechanism("four_bar_in_the_plane"), np.random.default_rng(0)
    lengths, angles = random.uniform(0.05, 0.6, 3), random.uniform(-3, 3, 3) + turn
    ways = (lengths * [np.cos(angles), np.sin(angles)]).T
    begins = np.array([[0.0, 0.0], ways[0], ways[0] + ways[1] - ways[2]])
    bars = []
    for k, (way, begin) in enumerate(zip(ways, begins, strict=True)):
        units = zip("xya", ("m", "m", "rad"), (*(begin + way / 2), angles[k]), strict=True)
        pose = tuple(m.coordinate(f"{x}{k}", unit, start=float(start)) for x, unit, start in units)
        bars.append(m.bar(f"bar{k}", mass=float(10 ** random.uniform(-2, 1)), length=float(lengths[k]), pose=pose))
    m.revolute("O", m.ground.at(0, 0), bars[0].start)
    m.revolute("A", bars[0].end, bars[1].start)
    m.revolute("B", bars[1].end, bars[2].end)
    m.revolute("C", m.ground.at(*begins[2].tolist()), bars[2].start)
    m.gravity(9.81 * float(np.sin(turn)), -9.81 * float(np.cos(turn)))
    return m


def test_the_start_needs_as_many_iterations_in_all_directions():
    """One change of the last digits of H hides round-off in some of them."""
    turned = (alfmu.derive(four_bar_in_the_plane(turn)) for turn in np.linspace(-3, 3, 9))
    assert len({Probe.of(equations).iterations_needed() for equations in turned}) == 1


def test_the_first_step_hardly_matters():
    """Steps of order 8 replace short ones soon, however short the first step was."""
    counts = [
        alfmu.simulate("slider_crank", 2.0, 0.1, parameters={"solver.step_size": h}).counters.evaluations
        for h in (0.1, 0.02, 1e-3, 1e-4)
    ]
    assert max(counts) <= 1.1 * min(counts)


def landing_gear() -> Mechanism:
    """A strut with a sprung wheel and a folding brace, in joint coordinates, in a field in proportion to the size."""
    m = Mechanism("landing_gear")
    size = m.parameter("size", 1.0, "m")
    strut = m.body("strut", mass=40.0, inertia=12.0 * size**2)
    wheel = m.body("wheel", mass=25.0, inertia=2.5 * size**2)
    at, slope = np.array([0.1, -1.25]), float(np.arctan2(-1.25, 0.1))

    def hinge(name: str, first: alfmu.Marker, second: alfmu.Marker, start: float | None = None) -> alfmu.Joint:
        placed = {} if start is None else {"coordinate": m.coordinate(name.lower(), start=start)}
        return m.revolute(name, first, second, **placed)

    def on(body: alfmu.Body, *place: float) -> alfmu.Marker:
        return body.at(*(x * size for x in (np.array(place) - ((0.05, -0.6) if body is strut else 0.0)).tolist()))

    def bar(name: str, mass: float, a: NDArray, b: NDArray) -> tuple[alfmu.Body, float]:
        return m.bar(name, mass=mass, length=float(np.hypot(*(b - a))) * size), float(np.arctan2(*(b - a)[::-1]))

    hinge("O", on(m.ground, 0, 0), on(strut, 0, 0), 0.0)
    m.prismatic("W", on(strut, *at), wheel.at(0, 0), axis=slope, coordinate=m.coordinate("w", "m", start=0.0))
    knee, foot, top, mid = (np.array(x) for x in ((-0.5, -0.35), (0.03, -0.5), (-0.35, 0.1), (-0.4, -0.1)))
    up, first = bar("up", 6.0, np.array([-0.8, 0.05]), knee)
    low, second = bar("low", 7.0, knee, foot)
    motor = hinge("P", on(m.ground, -0.8, 0.05), up.start, first)
    hinge("K", up.end, low.start, second - first)
    hinge("Q", low.end, on(strut, *foot))
    one, third = bar("one", 2.0, top, mid)
    two, fourth = bar("two", 2.0, mid, knee)
    hinge("L", on(m.ground, *top), one.start, third)
    hinge("M", one.end, two.start, fourth - third)
    hinge("N", two.end, up.end)
    m.spring_damper((on(strut, 0, 0), wheel.at(0, 0)), stiffness=4e4, damping=900, rest=1.28 * size)
    m.spring_damper((on(m.ground, -0.6, -0.6), low.at(low.length / 2)), stiffness=3e3, damping=200, rest=0.3 * size)
    m.drive(motor, size**2 * (120 * ca.sin(2 * m.time) + 200))
    m.gravity(0, -9.81 * size)
    return m


def test_a_slide_beside_hinges_takes_as_many_evaluations_in_all_sizes():
    """The convergence of accelerations in rad/s2 and m/s2 counts in one unit."""
    in_all_sizes(landing_gear(), "strut.angle", (1e-3, 1e3))


def beside_a_crank() -> Mechanism:
    """The same linkage with a coupler alone torn off."""
    m = Mechanism("mixed")
    L = m.parameter("L", 1.0, "m")
    th = m.start("angle", 0.8, "rad", rate=4.0)
    a, c = m.coordinate("a", "rad", start=th), m.coordinate("c", "rad", start=1.8)
    m.tie(th, a)
    x, y = m.coordinate("x", "m", start=0.65 * L), m.coordinate("y", "m", start=0.6 * L)
    crank, rocker = m.bar("crank", mass=1.0, length=L / 2), m.bar("rocker", mass=1.0, length=L)
    b = m.bar("b", mass=1.0, length=0.9 * L, pose=(x, y, m.coordinate("turn", "rad", start=0.6)))
    m.revolute("A", m.ground.at(0, 0), crank.start, coordinate=a)
    m.revolute("D", m.ground.at(1.2 * L, 0), rocker.start, coordinate=c)
    m.revolute("B", crank.end, b.start)
    m.revolute("C", b.end, rocker.end)
    m.gravity(0.0, -9.81)
    return m


@pytest.mark.parametrize(
    "make", [lambda: four_bar(True), lambda: four_bar(False), beside_a_crank], ids=["bodies", "points", "mixed"]
)
def test_a_four_bar_torn_apart_of_any_size_moves_alike(make):
    i, times = unit(make()), np.arange(STEPS + 1) / 10
    usual = angles(i, times, {"solver.relative_tolerance": 1e-9})
    for length in (1e4, 1e-2, 1e-4, 2e-6):
        second = length**0.5
        values = {"L": length, "start.angle_rate": 4 / second, "solver.relative_tolerance": 1e-9}
        assert np.abs(angles(i, second * times, values) - usual).max() <= 1e-9, length


def test_a_start_that_nothing_determines_is_in_proportion():
    """A five-bar has two freedoms and one start value: places and rates nearest to the guess decide the other one."""
    m = Mechanism("five_bar")
    L = m.parameter("L", 1.0, "m")
    guesses = {"a": (-0.07, 0.18, 1.9), "b": (0.2, 0.6, 0.6), "c": (0.8, 0.6, 2.3), "d": (1.05, 0.2, 1.2)}
    bars = {}
    for k, (name, (x, y, angle)) in enumerate(guesses.items()):
        start = {"start": angle, "rate": 3.0, "independent": True} if name == "a" else {"start": angle}
        pose = [m.coordinate(f"{name}x", "m", start=x * L), m.coordinate(f"{name}y", "m", start=y * L)]
        length = (0.4, 0.7, 0.7, 0.4)[k] * L
        bars[name] = m.bar(name, mass=1.0, length=length, pose=(*pose, m.coordinate(f"{name}th", "rad", **start)))
    m.revolute("A", m.ground.at(0, 0), bars["a"].start)
    m.revolute("B", bars["a"].end, bars["b"].start)
    m.revolute("C", bars["b"].end, bars["c"].end)
    m.revolute("D", bars["d"].end, bars["c"].start)
    m.revolute("E", m.ground.at(L, 0), bars["d"].start)
    m.gravity(0, 0)
    i = unit(m)

    def started(length: float) -> NDArray:
        i._unit.reset()
        initialized(i, {"L": length})
        return np.array([i.get(f"{bar}.{what}") for bar in bars for what in ("angle", "angular_velocity")])

    usual = started(1.0)
    assert usual[1] == pytest.approx(3.0, abs=1e-12)
    for length in (1e-2, 0.3, 0.7, 3.0, 100.0):
        assert np.abs(started(length) - usual).max() <= 1e-12, length


@pytest.mark.slow
def test_a_start_in_space_that_nothing_determines_is_in_proportion_and_turns_with_the_mechanism():
    """A rotor in two gimbals, of which only the rotor's hinge has a start rate, in absolute coordinates."""

    m = Mechanism("gimbals")
    L = m.parameter("L", 1.0, "m")
    R = [[m.parameter(f"r{i}{j}", float(i == j), "1") for j in range(3)] for i in range(3)]

    def turned(x: float, y: float, z: float, size: ca.SX = 1.0) -> tuple[ca.SX, ...]:
        return tuple(size * (row[0] * x + row[1] * y + row[2] * z) for row in R)

    last, origin = m.spatial_ground, np.zeros(3)
    inertia = (L**2 / 50,) * 3
    for name, axis, at in (("outer", (0, 0, 1), np.array([0.1, 0, 0])), ("inner", (1, 0, 0), np.array([0, 0.1, 0.2]))):
        body = m.spatial_body(name, mass=1.0, inertia=inertia, position=turned(*at, L))
        ends = last.at(*turned(*-origin, L)), body.at(*turned(*-at, L))
        m.spatial_revolute(f"{name}_hinge", *ends, axis=turned(*axis))
        last, origin = body, at
    body = m.spatial_body("rotor", mass=1.0, inertia=inertia)
    spin = m.spatial_revolute("spin", last.at(*turned(*-origin, L)), body.at(), axis=turned(0, 1, 0.2))
    m.tie(m.start("spin_angle", 0.0, "rad", rate=40.0), spin.free)
    m.gravity(0, 0, 0)
    i = unit(m, ["*.angular_velocity.*"])

    def started(size: float, turn: NDArray) -> NDArray:
        i._unit.reset()
        initialized(i, {"L": size} | {f"r{k}{j}": turn[k, j] for k in range(3) for j in range(3)})
        rates = [[i.get(f"{name}.angular_velocity.{k}") for k in "xyz"] for name in ("outer", "inner", "rotor")]
        return np.array(rates) @ turn

    usual = started(1.0, np.eye(3))
    assert np.abs(usual[0]).max() > 0.1  # a gimbal moves along, as near the guess as the rotor
    for k, size in enumerate((1.0, 0.01, 0.3, 7.0)):
        turn = Rotation.random(random_state=k).as_matrix()
        assert np.abs(started(size, turn) - usual).max() <= 1e-10, size


# Constraints that hardly agree ------------------------------------------------------------------------------------


def two_bars(name: str) -> tuple[Mechanism, dict]:
    """Two parallel bars on the ground, 1 m apart."""
    m, found = Mechanism(name), {}
    for k, x in (("A", 0.0), ("D", 1.0)):
        th = m.coordinate(
            f"th{k}", "rad", start=0.5, **({"independent": True, "rate": 2.0} if name == "rods" and not x else {})
        )
        bar = m.bar(f"bar{k}", mass=1.0, length=1.0)
        found[k] = m.revolute(k, m.ground.at(x, 0), bar.start, coordinate=th), bar
    m.gravity(0, -9.81)
    return m, found


@cache
def rods() -> Mechanism:
    """Two rods between the bars, one of them redundant and a little too long."""
    m, bars = two_bars("rods")
    (_, a), (_, b) = bars.values()
    m.distance("rod1", a.end, b.end, length=1.0)
    m.distance("rod2", a.at(0.5), b.at(0.5), length=1.0 + m.parameter("off", 0.0, "m"))
    return m


@cache
def motors() -> Mechanism:
    """Each bar turned by a motor, and a rod between them; one motor is a little too fast."""
    m, bars = two_bars("motors")
    (A, a), (D, b) = bars.values()
    m.distance("rod", a.end, b.end, length=1.0)
    m.motion(A, 0.5 + 2 * m.time)
    m.motion(D, 0.5 + (2 + m.parameter("off", 0.0, "rad/s")) * m.time)
    return m


@cache
def balance() -> Mechanism:
    """Two beams on a column, and a hanger at either side; the lower pivot is a little high, so that the loops close
    exactly only where the beams stand upright."""
    m = Mechanism("balance")
    th = m.coordinate("th", "rad", start=0.3, independent=True)
    top, lower = (m.bar(name, mass=1.0, length=1.2) for name in ("top", "lower"))
    m.revolute("A", m.ground.at(0, 0.5), top.at(0.6), coordinate=th)
    m.revolute(
        "D", m.ground.at(0, m.parameter("off", 0.0, "m")), lower.at(0.6), coordinate=m.coordinate("low", start=0.3)
    )
    for side, place, mass in (("left", 0.0, 2.0), ("right", 1.2, 2.2)):
        hanger = m.bar(side, mass=mass, length=0.5)
        turn = m.coordinate(f"{side}_turn", start=-0.3 - np.pi / 2)
        m.revolute(f"{side}_top", top.at(place), hanger.start, coordinate=turn)
        m.revolute(f"{side}_end", hanger.end, lower.at(place))
    m.gravity(0, -9.81)
    return m


@pytest.mark.slow
@pytest.mark.parametrize(("make", "named"), [(rods, "rod2"), (motors, "rod"), (balance, "left_end")])
@pytest.mark.parametrize("off", [1e-6, 1e-9, 1e-12])
def test_constraints_that_contradict_each_other_are_named_at_the_start(make, named, off):
    with pytest.raises(alfmu.AlfmuError, match=rf"(contradict each other|cannot be closed|no motion).*{named}") as said:
        alfmu.simulate(make(), 0.1, 0.02, parameters={"off": off})
    assert "step" not in str(said.value)


@pytest.mark.slow
@pytest.mark.parametrize("make", [rods, motors])
def test_constraints_that_agree_within_round_off_run(make):
    exactly = {"solver.relative_tolerance": 1e-10}
    there, other = (
        alfmu.simulate(make(), 2.0, 0.02, parameters={"off": off, **exactly})["barA.angle"] for off in (1e-13, 0.0)
    )
    assert np.abs(np.array(there) - np.array(other)).max() <= 1e-9


def test_a_rod_that_agrees_within_round_off_costs_nothing():
    """A third crank under the rod of a parallelogram, 1e-13 m too long."""
    m = Mechanism("cranks")
    rod, longer = m.bar("rod", mass=1.0, length=1.0), m.parameter("off", 0.0, "m")
    bars = [m.bar(f"bar{k}", mass=1.0, length=0.4 + longer * (k == 2)) for k in range(3)]
    for k, (bar, x) in enumerate(zip(bars, (0.0, 1.0, 0.45), strict=True)):
        th = m.coordinate(f"th{k}", start=0.9, independent=k == 0)
        m.revolute(f"A{k}", m.ground.at(x, 0), bar.start, coordinate=th)
        turn = m.coordinate("turn", start=-0.9) if k == 0 else None
        m.revolute(f"B{k}", bar.end, rod.at(x), coordinate=turn)
    m.gravity(0, -9.81)
    for rate in (0.0, 20.0):
        exact, off = (alfmu.simulate(m, 0.5, 0.05, parameters={"off": d, "start.th0_rate": rate}) for d in (0.0, 1e-13))
        assert off["bar0.angle"] == pytest.approx(exact["bar0.angle"], abs=1e-7)
        assert off.counters.patient == 0
        assert off.counters.evaluations <= 1.2 * exact.counters.evaluations


@pytest.mark.slow
@pytest.mark.parametrize(
    ("size", "away", "absolute"),
    [(1.0, 100.0, False), (1.0, 700.0, False), (1.0, 100.0, True), (1e-3, 0.1, False), (1e-3, 0.03, True)],
)
def test_round_off_of_places_far_from_the_origin_is_no_contradiction(caplog, size, away, absolute):
    """Three cranks of 40 mm, or 40 um, on one rod, at the origin and far from it. The rod does not turn."""

    def cranks(x: float) -> Mechanism:
        m, along, th = Mechanism("cranks"), np.array([np.cos(1.1), np.sin(1.1)]), 2.0
        end = 0.04 * size * np.array([np.cos(th), np.sin(th)])

        def bar(name: str, mass: float, start: NDArray, angle: float, length: float) -> alfmu.Body:
            if not absolute:
                return m.bar(name, mass=mass, length=length)
            center = start + length / 2 * np.array([np.cos(angle), np.sin(angle)])
            free = {"rate": 12.0 / size**0.5, "independent": True} if name == "crank0" else {}
            pose = [m.coordinate(f"{name}.{k}", "m", start=float(c)) for k, c in zip("xy", center, strict=True)]
            return m.bar(name, mass=mass, length=length, pose=(*pose, m.coordinate(f"{name}.a", start=angle, **free)))

        at = [x + 0.05 * size * k * along for k in range(3)]
        cranks = [bar(f"crank{k}", 0.2, at[k], th, 0.04 * size) for k in range(3)]
        rod = bar("rod", 0.3, at[0] + end, 1.1, 0.1 * size)
        for k, crank in enumerate(cranks):
            free = {"rate": 12.0 / size**0.5, "independent": True} if k == 0 else {}
            turn = None if absolute else m.coordinate(f"th{k}", start=th, **free)
            m.revolute(f"A{k}", m.ground.at(*map(float, at[k])), crank.start, coordinate=turn)
        m.revolute("B0", cranks[0].end, rod.start, coordinate=None if absolute else m.coordinate("turn", start=-0.9))
        for k in (1, 2):
            m.revolute(f"B{k}", rod.at(0.05 * size * k), cranks[k].end)
        m.gravity(0, -9.81)
        return m

    def run(x: float) -> Result:
        return alfmu.simulate(cranks(x), 0.25 * size**0.5, 0.01 * size**0.5)

    with caplog.at_level("WARNING"):
        here, there = run(0.0), run(away)
    assert not [r.message for r in caplog.records if "independent" not in r.message]
    inertia, weight = 3 * 0.2 * 0.04**2 / 3 + 0.3 * 0.04**2, 9.81 * (3 * 0.2 * 0.02 + 0.3 * 0.04)
    right = ode.motion(lambda t, x, v: -weight * np.cos(x) / inertia, 2.0, 12.0, there.time / size**0.5)
    assert np.abs(there["crank0.angle"] - right[:, 0]).max() <= 1e-6
    assert there.counters.evaluations <= 1.1 * here.counters.evaluations


@pytest.mark.parametrize("coordinates", ["joint", "absolute"])
def test_a_small_mechanism_far_from_the_origin_is_told_of_round_off(caplog, coordinates):
    for size, away, told in ((1.0, 100.0, False), (1e-3, 10.0, False), (1.0, 1e5, True), (1e-3, 300.0, True)):
        m = Mechanism("pair")
        end = size * np.array([np.cos(2.0), np.sin(2.0)])
        bars = []
        for name, (X, Y), angle in (("left", (0, 0), 2.0), ("right", (size, 0), 2.0), ("rod", end, 0.0)):
            pose = ()
            if coordinates == "absolute":
                free = {"independent": True} if name == "left" else {}
                X, Y = away + X + size / 2 * np.cos(angle), away + Y + size / 2 * np.sin(angle)
                pose = (m.coordinate(f"{name}.X", "m", start=float(X)), m.coordinate(f"{name}.Y", "m", start=float(Y)),
                        m.coordinate(f"{name}.turn", start=angle, **free))  # fmt: skip
            bars.append(m.bar(name, mass=1.0, length=size, **({"pose": pose} if pose else {})))
        turns = [None] * 3
        if coordinates == "joint":
            turns = [m.coordinate(f"q{k}", start=x, independent=k == 0) for k, x in enumerate((2.0, 2.0, -2.0))]
        left, right, rod = bars
        m.revolute("A", m.ground.at(away, away), left.start, coordinate=turns[0])
        m.revolute("B", m.ground.at(away + size, away), right.start, coordinate=turns[1])
        m.revolute("C", left.end, rod.start, coordinate=turns[2])
        m.revolute("D", rod.end, right.end)
        m.gravity(0, -9.81)
        caplog.clear()
        unit(m, ["rod.angle"]).initialize()
        assert ("times the size of its smallest loop" in caplog.text) == told


@pytest.mark.slow
def test_a_rod_on_a_crank_of_a_tenth_of_a_millimetre_is_told_to_take_a_pose():
    """The two angles of joints differ by 1e-8 of their inertia; in a pose of its own the rod moves as it should."""

    def slider_crank(placed: bool) -> Mechanism:
        m, r, l, th = Mechanism("eccentric"), 1e-4, 0.9, 0.5
        slope = -np.arcsin(r * np.sin(th) / l)
        middle = r * np.cos(th) + l / 2 * np.cos(slope), r / 2 * np.sin(th), slope
        names = ("x", "m"), ("y", "m"), ("turn", "rad")
        pose = [m.coordinate(*name, start=at) for name, at in zip(names, middle, strict=True)] if placed else None
        crank, slider = m.bar("crank", mass=0.1, length=r), m.body("slider", mass=0.5)
        rod = m.bar("rod", mass=1.0, length=l, pose=pose)
        free = m.coordinate("th", start=th, rate=20.0, independent=True)
        m.revolute("A", m.ground.at(), crank.start, coordinate=free)
        m.revolute("B", crank.end, rod.start, coordinate=None if placed else m.coordinate("q", start=-th))
        m.prismatic("guide", m.ground.at(), slider.at(), coordinate=m.coordinate("s", "m", start=l))
        m.revolute("C", rod.end, slider.at())
        m.gravity(0, -9.81)
        return m

    def turn(t: float, th: float, w: float) -> float:
        """Acceleration of the crank, to r/l: the rod slides as the slider does and turns by r/l cos th."""
        r, s, c = 1e-4, np.sin(th), np.cos(th)
        mass = r * r * (0.1 / 3 + 1.5 * s * s + c * c / 3)
        change = r * r * (3.0 - 2 / 3) * s * c
        return (-9.81 * r * c * (0.05 + 0.5) - change * w * w / 2) / mass

    with pytest.raises(alfmu.StepError, match="as long as the link that turns it, give the body a pose"):
        alfmu.simulate(slider_crank(False), 0.3, 0.01)
    run = alfmu.simulate(slider_crank(True), 0.3, 0.01)
    right = ode.motion(turn, 0.5, 20.0, run.time)[:, 0]
    assert np.abs(run["crank.angle"] - right).max() <= 2e-3


def test_the_error_of_a_short_crank_in_joint_coordinates_is_estimated(caplog):
    """A crank of 0.3 mm and a rod of 0.9 m, of which the motion moves only 1e-7 of the masses that C holds."""
    m, r, l = Mechanism("eccentric"), 3e-4, 0.9
    crank, rod, slider = m.bar("crank", mass=0.1, length=r), m.bar("rod", mass=1.0, length=l), m.body("s", mass=0.5)
    free = m.coordinate("th", start=0.5, rate=20.0, independent=True)
    m.revolute("A", m.ground.at(), crank.start, coordinate=free)
    m.revolute("B", crank.end, rod.start, coordinate=m.coordinate("q", start=-0.5))
    m.prismatic("guide", m.ground.at(), slider.at(), coordinate=m.coordinate("x", "m", start=l))
    m.revolute("C", rod.end, slider.at())
    m.gravity(0, -9.81)
    x, w = ca.SX.sym("x"), ca.SX.sym("w")
    pin = r * ca.vertcat(ca.cos(x), ca.sin(x))
    middle = pin + ca.vertcat(ca.sqrt(l**2 - pin[1] ** 2), -pin[1]) / 2
    end, turn = pin[0] + ca.sqrt(l**2 - pin[1] ** 2), -ca.asin(pin[1] / l)
    inertia = 0.1 * r**2 / 3 + ca.sumsqr(ca.jacobian(middle, x)) + l**2 / 12 * ca.jacobian(turn, x) ** 2
    inertia += 0.5 * ca.jacobian(end, x) ** 2
    height = 9.81 * (0.1 * pin[1] / 2 + middle[1])
    rate = ca.Function("rate", [x, w], [(-ca.jacobian(height, x) - ca.jacobian(inertia, x) * w**2 / 2) / inertia])
    with caplog.at_level("WARNING"):
        run = alfmu.simulate(m, 0.3, 0.01)
    right = ode.motion(lambda t, x, v: float(rate(x, v)), 0.5, 20.0, run.time)[:, 0]
    [told] = re.findall(r"round-off causes an error of about (\S+),", caplog.text)
    assert 1e-6 < np.abs(run["crank.angle"] - right).max() <= 2 * float(told) <= 2e-3


def test_where_error_control_cannot_go_on_rk4_does():
    """Motors that begin together and are 1e-12 rad apart after some seconds: more than steps may leave open."""
    i = unit(motors())
    times = np.arange(151) / 50
    assert np.abs(angles(i, times, {"off": 2.4e-13}, of="barA.angle") - 0.5 - 2 * times).max() <= 1e-11
    assert i.counters.patient > 0


def test_constraints_that_hold_to_second_order_alone_are_named(caplog):
    """Two slides on parallel rails, and a rod between them as long as the rails are apart."""
    m, slides = Mechanism("rails"), []
    for k, x in (("a", 0.0), ("b", 1.0)):
        y = m.coordinate(k, "m", start=0.2)
        body = m.body(f"slide_{k}", mass=1.0, pose=(x, y, 0.0))
        slides.append(body)
    m.distance("rod", slides[0].at(0, 0), slides[1].at(0, 0), length=1.0)
    m.gravity(0, -9.81)
    initialized(alfmu.Instance(m))
    assert "rails: rod stop a motion to second order only" in caplog.text


# Singular positions -----------------------------------------------------------------------------------------------

ENDED = (
    *((0.6844713720368576, 0.0, 4.0), (-0.7079874108956625, 2.0, 4.0), (-2.936665234018724, 0.0, 8.0)),
    *((-2.6698728452320317, 2.0, 1.0), (-1.9923070987796339, 2.0, 1.0), (2.9791723304271622, -1.0, 8.0)),
)
"""Angles [rad], speeds [rad/s] and torques [N.m] of runs that ended: communication points lie on singular positions."""


@pytest.mark.slow
def test_no_phase_of_a_parallelogram_ends_by_default():
    """Without gravity its angle is a parabola: 5/3 kg.m2 under a torque."""
    i, times = unit(alfmu.load("four_bar")), np.arange(126) * 0.02
    random = np.random.default_rng(3)
    starts = list(ENDED)
    for off in 10.0 ** random.uniform(-14, -2, 100):  # a communication point so near to a singular position
        t, w, torque = times[random.integers(5, 100)], random.choice([0.0, 2.0, -1.0]), random.choice([4.0, 8.0, -3.0])
        starts.append((random.integers(-3, 4) * np.pi + off - w * t - 0.3 * torque * t**2, w, torque))
    for angle, w, torque in starts:
        values = {"g": 0.0, "start.angle": angle, "start.angular_velocity": w}
        found = angles(i, times, values, torque, "link1.angle")
        assert np.abs(found - angle - w * times - 0.3 * torque * times**2).max() <= 1e-7, (angle, w, torque)


FAST = ((-1.171232731897223, 2.0, 4.0), (-0.9037082488756895, 2.0, 8.0), (-1.1122772877362392, 2.0, 8.0))
"""The same of runs that turn twice, whose regular steps left 4e-7 rad."""


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["joint", "natural"])
def test_no_phase_of_a_slider_crank_with_equal_links_ends_by_default(coordinates):
    i, times = unit(alfmu.load("slider_crank", coordinates=coordinates)), np.arange(126) * 0.02
    starts = [(angle, 0.0, 4.0) for angle in np.random.default_rng(4).uniform(-1.4, 1.4, 30)]
    for angle, w, torque in [*starts, *FAST]:
        values = {"g": 0.0, "l1": 1.0, "l2": 1.0, "start.angle": angle, "start.angular_velocity": w}
        off = angles(i, times, values, torque) - crank(1.0, 0.0, torque, (angle, w), times)
        assert np.abs(off).max() <= 1e-7, (angle, w, torque)


SCALED = ((1e-6, 1.0), (1e-3, 1e-9), (1e4, 1e6)) if ALL else ((1e-6, 1e-9), (1e4, 1e6))


def sized(linkage: turned.Linkage, length: float, mass: float) -> Mechanism:
    """A linkage in space of bodies with coordinates of their own, in proportion."""
    scaled = deepcopy(linkage)
    for link in scaled.links:
        link.mass, link.center = mass * link.mass, length * link.center
        link.inertia = mass * length**2 * link.inertia
    for joint in scaled.joints:
        joint.point = length * joint.point
    scaled.rate /= np.sqrt(length)
    return scaled.declared(absolute="lc")


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*if millimetres were meant")
def test_bodies_in_space_move_and_load_joints_in_proportion():
    """Under the same gravity times go with the root of the length, and forces with the mass."""
    linkage, found = turned.four_bar(np.random.default_rng(0)), []
    for length, mass in ((1.0, 1.0), *SCALED):
        time, asked = np.sqrt(length), [*(f"{link.name}.?" for link in linkage.links), "J0.force.*"]
        r = alfmu.simulate(sized(linkage, length, mass), 0.3 * time, 0.02 * time, parameters=TIGHT, outputs=asked)
        places = np.array([r[f"{link.name}.{axis}"] for link in linkage.links for axis in "xyz"]) / length
        found.append((places, np.array([r[f"J0.force.{axis}"] for axis in "xyz"]) / mass))
    for places, forces in found[1:]:
        assert np.abs(places - found[0][0]).max() <= 1e-9
        assert np.abs(forces - found[0][1]).max() <= 1e-7 * np.abs(found[0][1]).max()
