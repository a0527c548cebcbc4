"""Angles that places tell up to whole turns: what depends on them counts the turns, in every way to run."""

from collections.abc import Callable
from functools import cache

import casadi as ca
import fmpy
import numpy as np
import pytest
from scenes import initialized
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

import alfmu
from alfmu import Mechanism, parts
from alfmu.model.parts import Body, Joint
from alfmu.model.spatial import SpatialBody, SpatialJoint

INERTIA, STIFFNESS, START, RATE = 1 / 3, 2.0, 0.5, 14.0
TIMES = np.linspace(0.0, 4.0, 41)
TIGHT = {"solver.relative_tolerance": 1e-10}


@cache
def natural(hinged: Callable[[Mechanism, Body, Joint], None]) -> Mechanism:
    """A bar of 1 m and 1 kg between the ground and a point, and what acts on its hinge."""
    m = Mechanism("natural")
    a = m.start("a", START, "rad", rate=RATE)
    x, y = m.coordinate("x", "m", start=ca.cos(a)), m.coordinate("y", "m", start=ca.sin(a))
    bar = m.bar("bar", mass=1.0, length=1.0, between=(m.ground.at(0, 0), m.point(x, y)))
    m.tie(a, bar.angle)
    hinged(m, bar, m.revolute("A", m.ground.at(0, 0), bar.start))
    return m


@cache
def spatial(hinged: Callable[[Mechanism, SpatialBody, SpatialJoint], None]) -> Mechanism:
    """The same bar in absolute coordinates in space, whose hinge constraints close."""
    m = Mechanism("spatial")
    a = m.start("a", START, "rad", rate=RATE)
    place, turn = (ca.cos(a) / 2, ca.sin(a) / 2, 0.0), (ca.cos(a / 2), 0.0, 0.0, ca.sin(a / 2))
    bar = m.spatial_body("bar", mass=1.0, inertia=(1e-3, 1 / 12, 1 / 12), position=place, attitude=turn)
    hinge = m.spatial_revolute("A", m.spatial_ground.at(), bar.at(-0.5), axis=(0, 0, 1))
    m.tie(a, hinge.free)
    hinged(m, bar, hinge)
    return m


def moved(torque: Callable[[float, float], float], start: float = START) -> np.ndarray:
    """Angles (41,) of the bar on the one equation of its hinge."""

    def rate(t: float, y: np.ndarray) -> list[float]:
        return [y[1], torque(y[0], y[1]) / INERTIA]

    found = solve_ivp(rate, (0, 4.0), [start, RATE], "DOP853", TIMES, rtol=1e-12, atol=1e-12, max_step=0.01)
    return found.y[0]


def sprung(m: Mechanism, body: object, hinge: object) -> None:
    m.spring_damper(hinge, stiffness=STIFFNESS, damping=0.1, name="spring")


@pytest.mark.slow
@pytest.mark.parametrize("made", [natural, spatial])
def test_a_torsion_spring_counts_turns(made):
    """Its torque jumped by STIFFNESS times a turn wherever the angle passed pi."""
    exact = moved(lambda angle, rate: -STIFFNESS * angle - 0.1 * rate)
    assert np.ptp(exact) > 2 * np.pi
    angle = "bar.angle" if made is natural else "A.angle"
    r = alfmu.simulate(made(sprung), 4.0, 0.1, parameters=TIGHT, outputs=[angle, "spring.elongation", "monitor.*"])
    assert np.abs(r[angle] - exact).max() < 1e-8
    assert np.abs(r["spring.elongation"] - exact).max() < 1e-8
    assert r.counters.energy_error < 1e-8


@pytest.mark.parametrize("settings", [{"kernel": "oracle"}, {"kernel": "vm"}, {"kernel": "compiled"}])
def test_every_kernel_counts_them(settings):
    exact = moved(lambda angle, rate: -STIFFNESS * angle - 0.1 * rate)[:11]
    rk4 = {"solver.method": "rk4", "solver.step_size": 0.0025}
    r = alfmu.simulate(natural(sprung), 1.0, 0.1, parameters=rk4, **settings)
    assert np.abs(r["bar.angle"] - exact).max() < 1e-5


@pytest.mark.parametrize(("kind", "fmi"), [("python", 2), ("native", 2), ("native", 3)])
def test_every_kind_of_fmu_counts_them(kind, fmi, tmp_path):
    made = alfmu.simulate(natural(sprung), 4.0, 0.1)
    path = alfmu.export(natural(sprung), tmp_path / "natural.fmu", kind=kind, fmi=fmi)
    found = fmpy.simulate_fmu(str(path), stop_time=4.0, output_interval=0.1, output=["bar.angle"])
    assert np.array_equal(found["bar.angle"], made["bar.angle"])


@cache
def placed(hinged: Callable[[Mechanism, SpatialBody, SpatialJoint], None] = sprung) -> Mechanism:
    """The bar in space, whose start tells its place, not the angle of its hinge."""
    m = Mechanism("placed")
    start = m.start("a", 3.14159, "rad", rate=RATE)
    place = (ca.cos(start) / 2, ca.sin(start) / 2, 0.0)
    turn = (ca.cos(start / 2), 0.0, 0.0, ca.sin(start / 2))
    bar = m.spatial_body("bar", mass=1.0, inertia=(1e-3, 1 / 12, 1 / 12), position=place, attitude=turn)
    hinge = m.spatial_revolute("A", m.spatial_ground.at(), bar.at(-0.5), axis=(0, 0, 1))
    m.tie(start, ca.atan2(bar.position[1], bar.position[0]))
    hinged(m, bar, hinge)
    return m


def shown(m: Mechanism, bar: SpatialBody, hinge: SpatialJoint) -> None:
    """Nothing depends on the angle."""


@pytest.mark.parametrize("way", ["auto", "rk4"])
def test_an_angle_that_is_only_shown_goes_on_from_its_start_too(way):
    run = alfmu.simulate(placed(shown), 1.0, 0.1, parameters={"solver.method": way}, outputs=["A.angle"])
    assert run["A.angle"] == pytest.approx(3.14159 + RATE * run.time, abs=1e-2 if way == "rk4" else 1e-7)


@pytest.mark.parametrize("way", ["auto", "order8", "exchange"])
def test_the_first_step_may_lead_past_pi(way, tmp_path):
    """Until then the angle was counted from zero: the spring's torque jumped by STIFFNESS times a turn."""
    start = 3.14159
    exact = moved(lambda angle, rate: -STIFFNESS * angle - 0.1 * rate, start)[:11]
    if way == "exchange":
        path = alfmu.export(placed(), tmp_path / "placed.fmu", interface="me")
        more = {"output_interval": 0.02, "relative_tolerance": 1e-9, "output": ["A.angle"]}
        angle = fmpy.simulate_fmu(str(path), fmi_type="ModelExchange", stop_time=1.0, **more)["A.angle"][::5]
    else:
        settings = {"solver.method": way, "solver.step_size": 0.01}
        angle = alfmu.simulate(placed(), 1.0, 0.1, parameters=settings, outputs=["A.angle"])["A.angle"]
    assert np.abs(angle - exact).max() < 1e-5


def test_a_stop_and_a_law_beyond_pi():
    """A stop at 1.5 turns, and a torque that the angle itself tells."""

    def hinged(m: Mechanism, bar: Body, hinge: Joint) -> None:
        m.end_stop("stop", hinge, upper=3 * np.pi, stiffness=500.0, onset=0.1)
        m.drive(hinge, -0.3 * bar.angle)

    def torque(angle: float, rate: float) -> float:
        deep = max(angle - 3 * np.pi, 0.0)
        z = min(deep / 0.1, 1.0)
        return -0.3 * angle - 500.0 * (0.1 * (2.5 * z**4 - 3 * z**5 + z**6) + max(deep - 0.1, 0.0))

    exact = moved(torque)
    assert exact.max() > 3 * np.pi
    r = alfmu.simulate(natural(hinged), 4.0, 0.1, parameters=TIGHT, outputs=["bar.angle", "stop.penetration"])
    assert np.abs(r["bar.angle"] - exact).max() < 1e-6
    assert r["stop.penetration"].max() > 0.0


def test_a_law_and_an_output_of_the_angle_of_a_joint_in_space():
    """Both jumped by a turn wherever the angle passed pi; at -pi, the spring had another angle than the hinge shows."""

    def hinged(m: Mechanism, bar: SpatialBody, hinge: SpatialJoint) -> None:
        m.spring_damper(hinge, stiffness=STIFFNESS, name="spring")
        m.drive(hinge, -0.3 * hinge.free)
        m.output("turned", hinge.free, "rad")

    names = ["A.angle", "turned", "spring.elongation"]
    for start in (START, np.pi, -np.pi):
        exact = moved(lambda angle, rate: -(STIFFNESS + 0.3) * angle, start)[:11]
        r = alfmu.simulate(placed(hinged), 1.0, 0.1, parameters={"start.a": start, **TIGHT}, outputs=names)
        for name in names:
            assert r[name] == pytest.approx(exact, abs=1e-8), start


def test_turns_begin_at_the_start_value_and_come_back_with_the_state():
    """A turn ahead the spring is wound up by it; a state that is restored has the turns of its time."""
    exact = moved(lambda angle, rate: -STIFFNESS * angle - 0.1 * rate, START + 2 * np.pi)
    unit = initialized(alfmu.Instance(natural(sprung)), {"start.a": START + 2 * np.pi, **TIGHT})
    states = []
    for k in range(20):
        states.append((unit.save(), unit.get("bar.angle")))
        unit.step(0.1)
        assert unit.get("bar.angle") == pytest.approx(exact[k + 1], abs=1e-8)
    at_end = unit.get("bar.angle")
    for k in (3, 11, 0):
        unit.restore(states[k][0])
        assert unit.get("bar.angle") == states[k][1]
        for _ in range(20 - k):
            unit.step(0.1)
        assert unit.get("bar.angle") == at_end


@pytest.mark.parametrize("made", [natural, spatial])
def test_an_equilibrium_beyond_pi(made):
    """The bar hangs on a wound spring; none was found, as its angle was counted from zero."""
    balance = brentq(lambda angle: STIFFNESS * (angle - 3.3) + 9.81 / 2 * np.cos(angle), 3.14, 5.0)

    def hinged(m: Mechanism, bar: Body, hinge: Joint) -> None:
        m.gravity(0.0, -9.81)
        m.spring_damper(hinge, stiffness=STIFFNESS, rest=3.3, name="spring")

    given = {"start.a": 3.0, "start.a_rate": 0.0}
    m = made(hinged)
    rest = alfmu.equilibrium(m, parameters=given).nearest
    assert rest.outputs["spring.elongation"] == pytest.approx(balance - 3.3, abs=1e-8)
    r = alfmu.simulate(m, 1.0, 0.1, parameters=given, start="equilibrium", outputs=["spring.elongation"])
    assert r["spring.elongation"] == pytest.approx(balance - 3.3, abs=1e-7)


def test_derivatives_follow_the_turns():
    """In both directions, against a difference of exact motions."""

    def last(stiffness: float) -> float:
        return moved(lambda angle, rate: -stiffness * angle)[20]

    def hinged(m: Mechanism, bar: Body, hinge: Joint) -> None:
        m.spring_damper(hinge, stiffness=m.parameter("k", STIFFNESS, "N.m/rad"))

    wanted = (last(STIFFNESS + 1e-4) - last(STIFFNESS - 1e-4)) / 2e-4
    given = {"stop_time": 2.0, "communication_step": 0.1, "parameters": TIGHT}
    along = alfmu.derivatives(natural(hinged), ["k"], outputs=["bar.angle"], **given)
    assert along["bar.angle", "k"][-1] == pytest.approx(wanted, rel=1e-5)
    back = alfmu.gradient(natural(hinged), "bar.angle", ["k"], **given)
    assert back["k"] == pytest.approx(wanted, rel=1e-5)


def test_a_rotor_behind_a_gearbox_counts_them():
    """Its angle jumped by the ratio times a turn."""

    def hinged(m: Mechanism, bar: Body, hinge: Joint) -> None:
        given = {"voltage": 1.0, "resistance": 0.5, "inductance": 0.01, "constant": 0.1, "inertia": 1e-3}
        parts.dc_motor(m, "motor", hinge, gearbox=parts.Gearbox(ratio=2.5), **given)

    r = alfmu.simulate(natural(hinged), 2.0, 0.05, parameters=TIGHT)
    assert np.ptp(r["bar.angle"]) > 2 * np.pi
    assert r["motor.rotor.angle"] == pytest.approx(2.5 * r["bar.angle"], abs=1e-12)


def test_what_needs_no_turns_carries_none():
    e = alfmu.derive(natural(lambda m, bar, hinge: m.drive(hinge, 1.0)))
    assert not e.counted
    assert not e.held


def test_a_spring_between_two_bars_does_not_depend_on_how_both_are_turned():
    """Its torque was that of the difference of their angles, each within half a turn: off by a turn at 3.0 rad."""

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        first, second, w1, w2 = y
        bend, c = STIFFNESS * (second - first), np.sin(second - first) / 2
        M = np.array([[4 / 3, np.cos(second - first) / 2], [np.cos(second - first) / 2, 1 / 3]])
        return np.concatenate([[w1, w2], np.linalg.solve(M, [bend + c * w2**2, -bend - c * w1**2])])

    exact = solve_ivp(rate, (0, 1), [0.0, 0.3, 0.0, 0.0], "DOP853", TIMES[:11], rtol=1e-12, atol=1e-12).y
    m = Mechanism("two")
    m.gravity(0.0, 0.0)
    turned = m.parameter("turned", 0.0, "rad")
    ends, bars = [m.ground.at()], []
    for k in range(2):
        x, y = (sum(f(turned + 0.3 * i) for i in range(k + 1)) for f in (ca.cos, ca.sin))
        ends.append(m.point(m.coordinate(f"x{k}", "m", start=x), m.coordinate(f"y{k}", "m", start=y)))
        bars.append(m.bar(f"bar{k}", mass=1.0, length=1.0, between=(ends[k], ends[k + 1])))
    m.revolute("A", m.ground.at(), bars[0].start)
    m.spring_damper(m.revolute("B", bars[0].end, bars[1].start), stiffness=STIFFNESS, name="spring")
    for angle in (0.0, 3.0):
        r = alfmu.simulate(m, 1.0, 0.1, parameters={"turned": angle, **TIGHT}, outputs=["spring.elongation"])
        assert r["spring.elongation"] == pytest.approx(exact[1] - exact[0], abs=1e-8)
