"""Loops that pass singular positions, or rest in one, while something else moves: a base, a slide, a rotor.

A parallelogram of three bars (1 kg, 1 m) in line has a single coordinate, its crank angle. Its equation is derived by
hand, and solved by an unrelated integrator. On a base that accelerates by a(t) it moves as under a weight of -a(t)
per mass.
"""

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import casadi as ca
import fmpy
import numpy as np
import pytest
from oracles.parallelogram import Parallelogram
from scenes import initialized
from scipy.integrate import solve_ivp

import alfmu
from alfmu import Mechanism

CRANK = 5 / 3  # moment of inertia of two cranks and the coupler about a crank's pivot [kg m2]
GRAVITY = 9.81
UNBALANCE, RADIUS, INERTIA = 0.2, 0.05, 0.01  # kg, m, kg m2: the rotor on the coupler

BASES: dict[str, tuple[dict[str, float], Callable[[Any], Any]]] = {
    "steady": ({"speed": 70.0}, lambda t: 0.0),
    "from rest": ({"half": 1.0}, lambda t: 2.0),
    "5 Hz": ({"amplitude": 0.01, "frequency": 30.0}, lambda t: -9.0 * np.sin(30 * t)),
    "50 Hz": ({"amplitude": 1e-4, "frequency": 300.0}, lambda t: -9.0 * np.sin(300 * t)),
}
"""Parameters of the law of a base, and its acceleration."""


def bars(m: Mechanism, base: Any, coordinates: str, started: bool = True) -> list[Any]:
    """The parallelogram on a base, from the parameter `angle`; its coupler is bar 2."""
    angle = m.parameter("angle", 0.0, "rad")
    c, s = ca.cos(angle), ca.sin(angle)
    if coordinates == "relative":
        made = [m.bar(f"bar{i}", mass=1.0, length=1.0) for i in (1, 2, 3)]
        crank = m.coordinate("crank", "rad", start=0.0, independent=True)
        turned = [crank, m.coordinate("coupler", "rad", start=-angle), m.coordinate("rocker", "rad", start=angle)]
    else:
        made, turned = [], [None] * 3
        for i, (x, y, th) in enumerate(((c / 2, s / 2, angle), (c + 0.5, s, 0.0), (1 + c / 2, s / 2, angle))):
            free = {"start": 0.0, "independent": True} if i == 0 and started else {"start": th}
            th = m.coordinate("crank" if i == 0 else f"th{i}", "rad", **free)
            pose = (m.coordinate(f"x{i}", "m", start=x), m.coordinate(f"y{i}", "m", start=y), th)
            made.append(m.bar(f"bar{i + 1}", mass=1.0, length=1.0, pose=pose))
    pivot = m.revolute("A", base.at(0.0, 0.0), made[0].start, coordinate=turned[0])
    m.revolute("B", made[0].end, made[1].start, coordinate=turned[1])
    m.revolute("D", base.at(1.0, 0.0), made[2].start, coordinate=turned[2])
    m.revolute("C", made[1].end, made[2].end)
    m.drive(pivot, m.input("A.torque", "N.m"))
    return made


@cache
def on_base(coordinates: str) -> Mechanism:
    m = Mechanism("parallelogram_on_a_base")
    if coordinates == "relative":
        base, place = m.body("base", mass=5.0, inertia=1.0), m.coordinate("place", "m", start=0.0)
    else:
        pose = [m.coordinate(name, unit, start=0.0) for name, unit in (("x", "m"), ("y", "m"), ("turn", "rad"))]
        base, place = m.body("base", mass=5.0, inertia=1.0, pose=(pose[0], pose[1], pose[2])), None
    speed, half = m.parameter("speed", 0.0, "m/s"), m.parameter("half", 0.0, "m/s2")
    shaken = m.parameter("amplitude", 0.0, "m") * ca.sin(m.parameter("frequency", 1.0, "rad/s") * m.time)
    rail = m.prismatic("rail", m.ground.at(0.0, 0.0), base.at(0.0, 0.0), axis=0.0, coordinate=place)
    m.motion(rail, speed * m.time + half * m.time**2 + shaken)
    bars(m, base, coordinates)
    m.gravity(0.0, -GRAVITY)
    return m


@cache
def with_rotor(coordinates: str) -> Mechanism:
    """An unbalanced rotor in the middle of the coupler, which turns at `start.phi_rate`."""
    m = Mechanism("parallelogram_with_a_rotor")
    coupler = bars(m, m.ground, coordinates)[1]
    turn = m.coordinate("phi", "rad", start=0.0, independent=True)
    if coordinates == "relative":
        rotor = m.body("rotor", mass=UNBALANCE, inertia=INERTIA, center=(RADIUS, 0.0))
    else:
        place = (m.coordinate(name, "m", start=x) for name, x in zip("xy", coupler.at(0.0, 0.0).position, strict=True))
        rotor = m.body("rotor", mass=UNBALANCE, inertia=INERTIA, center=(RADIUS, 0.0), pose=(*place, turn))
    joint = turn if coordinates == "relative" else None
    m.revolute("E", coupler.at(0.0, 0.0), rotor.at(0.0, 0.0), coordinate=joint)
    return m


def integrated(rates: Callable[[float, Any], Any], start: list[float], stop: float) -> Any:
    points = np.arange(0.0, stop + 1e-9, 0.02)
    return solve_ivp(rates, (0.0, stop), start, method="DOP853", rtol=1e-13, atol=1e-13, t_eval=points).y[0]


def crank_on_base(acceleration: Callable[[Any], Any], torque: float, start: list[float], stop: float) -> Any:
    def rates(t: float, y: Any) -> list[float]:
        weight = 2 * (acceleration(t) * np.sin(y[0]) - GRAVITY * np.cos(y[0]))
        return [y[1], (torque + weight) / CRANK]

    return integrated(rates, start, stop)


def crank_with_rotor(speed: float, torque: float, start: list[float], stop: float) -> Any:
    arm = UNBALANCE * RADIUS

    def rates(t: float, y: Any) -> list[float]:
        th, w, phi, turning = y
        both = arm * np.cos(th - phi)
        M = [[CRANK + UNBALANCE, both], [both, arm * RADIUS + INERTIA]]
        F = [torque - arm * np.sin(th - phi) * turning**2, arm * np.sin(th - phi) * w**2]
        a = np.linalg.solve(M, F)
        return [w, a[0], turning, a[1]]

    return integrated(rates, [*start, 0.0, speed], stop)


def crank(m: Mechanism, torque: float, stop: float, *of: dict[str, Any], angle: float = 0.0, rate: float = 0.0) -> Any:
    given = {"angle": angle, "start.crank": angle, "start.crank_rate": rate} if angle or rate else {}
    for each in of:
        given |= each
    return alfmu.simulate(m, stop, 0.02, parameters=given, inputs={"A.torque": torque})["bar1.angle"]


def rk4(step: float) -> dict[str, Any]:
    return {"solver.method": "rk4", "solver.step_size": step}


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["relative", "absolute"])
@pytest.mark.parametrize("base", BASES)
def test_base_that_a_law_moves(base: str, coordinates: str) -> None:
    """From rest in line, through the line at 180, 360 and more degrees; a limit at other times would be 1e-3 rad off,
    or lock up."""
    law, acceleration = BASES[base]
    right = crank_on_base(acceleration, 40.0, [0.0, 0.0], 1.0)
    assert right[-1] > 2 * np.pi
    m = on_base(coordinates)
    assert crank(m, 40.0, 1.0, law) == pytest.approx(right, abs=2e-7)
    assert crank(m, 40.0, 1.0, law, rk4(1e-3)) == pytest.approx(right, abs=2e-8)


@pytest.mark.parametrize("coordinates", ["relative", "absolute"])
def test_slow_passage_on_a_base_that_shakes(coordinates: str) -> None:
    """At some 0.1 rad/s the positions of a limit are 0.4 s away, in which the base moves to and fro twice."""
    law, acceleration = BASES["5 Hz"]
    angle, rate, torque = -0.02, 0.1, 2 * GRAVITY
    right = crank_on_base(acceleration, torque, [angle, rate], 0.6)
    assert right[0] < 0 < right[-1] < 0.2
    for how in ({}, rk4(1e-3)):
        found = crank(on_base(coordinates), torque, 0.6, law, how, angle=angle, rate=rate)
        assert found == pytest.approx(right, abs=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["relative", "absolute"])
@pytest.mark.parametrize("start", [(0.0, 0.0, 1.0), (-0.05, 0.1, 0.0)])
@pytest.mark.parametrize("speed", [3.0, 30.0, 300.0])
def test_rotor_that_turns_faster(speed: float, start: tuple[float, float, float], coordinates: str) -> None:
    angle, rate, torque = start
    right = crank_with_rotor(speed, torque, [angle, rate], 1.0)
    for how, bound in (({}, 1e-7), (rk4(5e-4), 5e-6)):
        given = {"start.phi_rate": speed, **how}
        found = crank(with_rotor(coordinates), torque, 1.0, given, angle=angle, rate=rate)
        assert found == pytest.approx(right, abs=bound)


@pytest.mark.parametrize("started", [True, False])
def test_rest_in_a_singular_position_without_a_start_value(started: bool, caplog: pytest.LogCaptureFixture) -> None:
    """Nothing tells whether the cranks turn together, or the coupler on the rocker; two motions are possible."""
    m = Mechanism("undecided")
    bars(m, m.ground, "absolute", started)
    crank(m, 40.0, 0.02)
    assert any("starts at rest in a singular position" in message for message in caplog.messages) != started


def test_start_rate_from_a_base_that_turns_by_a_law() -> None:
    """A bar in absolute coordinates starts at 1 rad/s from a base at w + w^2: rate and its derivatives by hand."""
    m = Mechanism("on_a_turntable")
    w = m.parameter("w", 0.6, "rad/s")
    turn, relative = w * m.time + ca.sin(w * w * m.time), m.start("relative", 0.1, "rad", rate=1.0)
    base = m.body("base", mass=0.0, inertia=0.0, pose=(0.0, 0.0, turn))
    pose = (m.coordinate("x", "m", start=0.5), m.coordinate("y", "m", start=0.0), m.coordinate("th", "rad", start=0.0))
    bar = m.bar("bar", mass=1.0, length=1.0, pose=pose)
    m.tie(relative, bar.angle - base.angle)
    m.revolute("A", base.at(0.0, 0.0), bar.start)
    m.gravity(0.0, 0.0)
    of = ["bar.angle", "bar.angular_velocity"]
    found = alfmu.derivatives(m, ["w", "start.relative_rate"], 0.2, 0.1, outputs=of)
    speed = 1.0 + 0.6 + 0.36
    assert found.result["bar.angular_velocity"] == pytest.approx(speed, abs=1e-9)
    assert found.result["bar.angle"] == pytest.approx(0.1 + speed * found.result.time, abs=1e-9)
    assert found["bar.angular_velocity", "w"] == pytest.approx(1.0 + 2 * 0.6, abs=1e-9)
    assert found["bar.angular_velocity", "start.relative_rate"] == pytest.approx(1.0, abs=1e-9)


@cache
def beside(name: str, what: str) -> Mechanism:
    m = alfmu.load(name)
    if what == "slide":
        m.kinetic_energy(0.5 * m.rate(m.coordinate("slide", "m", start=0.0, rate=1.0, independent=True)) ** 2)
    elif what == "bar":
        bar = m.bar("bar", mass=1.0, length=0.3)
        turn = m.coordinate("turn", "rad")
        m.motion(m.revolute("motor", m.ground.at(0.0, 0.0), bar.start, coordinate=turn), 0.5 * m.time)
    return m


@pytest.mark.slow
@pytest.mark.parametrize("method", ["auto", "rk4", "order8"])
@pytest.mark.parametrize(
    ("name", "torque", "given", "fourth"),
    [
        ("five_bar", 3.0, {"start.angular_velocity": 0.0}, 1.0),
        ("four_bar", 4.0, {"start.angle": 0.0, "start.angular_velocity": 0.0}, None),
    ],
)
def test_loop_at_rest_beside_a_part_that_moves(
    name: str, torque: float, given: dict[str, float], fourth: float | None, method: str
) -> None:
    """It starts in its singular position, as it does alone; the other part has nothing to do with it."""
    exact = Parallelogram(m4=fourth).driven(0.0, 0.0, np.linspace(0.0, 2.0, 101), torque)[:, 0]
    how = {"parameters": {**given, "solver.method": method}, "inputs": {"A.torque": torque}, "outputs": ["link1.angle"]}
    found = [
        alfmu.simulate(beside(name, what), 2.0, 0.02, **how)["link1.angle"] for what in ("nothing", "slide", "bar")
    ]
    assert np.ptp(exact) > 2
    assert found[0] == pytest.approx(exact, abs=2e-6)
    assert found[1] == pytest.approx(found[0], abs=1e-9)
    assert found[2] == pytest.approx(found[0], abs=1e-9)


@pytest.mark.parametrize(("fmi", "kind"), [(2, "native"), (3, "native"), (2, "python")])
def test_in_an_fmu(fmi: int, kind: str, tmp_path: Path) -> None:
    law, acceleration = BASES["5 Hz"]
    right = crank_on_base(acceleration, 40.0, [0.0, 0.0], 0.5)
    path = alfmu.export(on_base("absolute"), tmp_path / "base.fmu", kind=kind, fmi=fmi, reference=False)
    given = {"A.torque": 40.0, **law}
    found = fmpy.simulate_fmu(path, stop_time=0.5, output_interval=0.02, start_values=given, output=["bar1.angle"])
    assert found["bar1.angle"] == pytest.approx(right, abs=1e-7)


@pytest.mark.parametrize("coordinates", ["relative", "absolute"])
def test_what_is_read_changes_no_step(coordinates: str) -> None:
    ends = []
    for reads in (False, True):
        i = initialized(alfmu.Instance(on_base(coordinates)), {**BASES["5 Hz"][0], **rk4(1e-3), "A.torque": 40.0})
        for _ in range(600):
            i.step(1e-3)
            if reads:
                i.read()
        ends.append([*i.q, *i.v])
    assert ends[0] == ends[1]


@pytest.mark.slow
def test_oracle_takes_limits_in_the_same_direction() -> None:
    law, acceleration = BASES["from rest"]
    right = crank_on_base(acceleration, 40.0, [0.0, 0.0], 0.2)
    e, given = alfmu.derive(on_base("absolute")), {**law, **rk4(1e-3)}
    found = alfmu.simulate(e, 0.2, 0.02, parameters=given, inputs={"A.torque": 40.0}, kernel="oracle")
    assert found["bar1.angle"] == pytest.approx(right, abs=1e-10)
