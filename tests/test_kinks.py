"""Forces with kinks: steps across one are judged by a bound that sees it, in every method that controls its error."""

import casadi as ca
import fmpy
import numpy as np
import pytest
from scenes import initialized

import alfmu
from alfmu.equations.specialisation import specialised
from alfmu.kernel.kinks import kinks
from alfmu.kernel.memory import PACE, TALLY
from alfmu.method.stepping import (
    EXPLICIT5,
    EXPLICIT5_SHORT,
    EXPLICIT8,
    EXPLICIT8_BESIDE,
    RADAU9,
    Collocation,
    kink_bounds,
)
from alfmu.simulation import prepared, with_defaults

MASS, STIFFNESS, HEIGHT, GRAVITY = 2.0, 5e4, 1.0, 9.81


def ball() -> alfmu.Mechanism:
    """A ball that falls on a spring it does not stick to; a state sums up how far it rises."""
    m = alfmu.Mechanism("ball", experiment=alfmu.Experiment(5.0, 1e-3))
    y = m.coordinate("y", "m", start=HEIGHT, independent=True)
    body = m.body("ball", mass=MASS)
    m.prismatic("rail", m.ground.at(0, 0), body.at(0, 0), axis=np.pi / 2, coordinate=y)
    m.gravity(0.0, -GRAVITY)
    m.force(body.at(0, 0), y=STIFFNESS * ca.fmax(-y, 0.0))
    m.state("risen", "m", rate=ca.fmax(m.rate(y), 0.0), start=0.0)
    return m


def flown(time: float) -> tuple[float, float]:
    """Height and how far it rose, piece by piece: parabolas, and a sine of the spring."""
    flight, frequency, sag = np.sqrt(2 * HEIGHT / GRAVITY), np.sqrt(STIFFNESS / MASS), MASS * GRAVITY / STIFFNESS
    size, phase = np.hypot(sag, GRAVITY * flight / frequency), np.arctan2(GRAVITY * flight / frequency, sag)
    contact = 2 * (np.pi - phase) / frequency
    falls, t = divmod(time, 2 * flight + contact)
    rise, deep = falls * (HEIGHT + size + sag), -sag - size
    if t < flight:
        return HEIGHT - GRAVITY * t**2 / 2, rise
    if t < flight + contact:
        y = -sag + size * np.cos(frequency * (t - flight) + phase)
        return y, rise + (y - deep) * (t > flight + contact / 2)
    t -= flight + contact
    y = GRAVITY * flight * t - GRAVITY * t**2 / 2
    return y, rise + y - deep


@pytest.fixture(scope="module")
def equations() -> alfmu.Equations:
    return alfmu.derive(ball())


@pytest.mark.parametrize(
    ("method", "tolerance"),
    [("explicit", 1e-4), ("explicit", 1e-10), ("stiff", 1e-4), ("stiff", 1e-10), ("auto", 1e-4), ("auto", 1e-10)],
)
def test_a_ball_on_a_spring_stays_within_the_tolerance(equations, method, tolerance):
    """By estimates of high order alone, `explicit` was 76 m off after 5 s at 1e-4, `stiff` 1e4 tolerances at 1e-11."""
    values = {"solver.method": method, "solver.relative_tolerance": tolerance}
    r = alfmu.simulate(prepared(with_defaults(equations, values)), 5.0, 0.25)
    exact = np.array([flown(t) for t in r.time])
    assert np.ptp(exact[:, 0]) > 0.9
    assert np.abs(r["ball.y"] - exact[:, 0]).max() <= 2 * tolerance
    assert np.abs(r["risen"] - exact[:, 1]).max() <= 2 * tolerance * exact[-1, 1]


@pytest.mark.parametrize("method", [EXPLICIT5, EXPLICIT5_SHORT, EXPLICIT8, EXPLICIT8_BESIDE, RADAU9])
@pytest.mark.parametrize(
    ("kink", "whole"),
    [(lambda x: x > 0, lambda x: x), (lambda x: x * (x > 0), lambda x: x**2 / 2)],
    ids=["jump", "kink"],
)
def test_the_bound_is_two_thirds_of_the_error_at_least(method, kink, whole):
    """Of a rate that depends on time alone, wherever in the step it jumps or has its kink."""
    implicit = isinstance(method, Collocation)
    nodes, weights = np.array(method.nodes), np.array(method.matrix[-1] if implicit else method.weights)
    bounds, places = np.array(kink_bounds(method)), np.append(0.0, nodes) if implicit else nodes
    for at in np.linspace(0.002, 0.998, 499):
        error = weights @ kink(nodes - at) - whole(1 - at)
        assert np.abs(bounds @ kink(places - at)).max() >= 2 / 3 * abs(error)
    for power in range(3):
        assert np.abs(bounds @ places**power).max() <= 1e-12


def test_what_has_kinks_is_found_once():
    x, y, p = (ca.SX.sym(name) for name in "xyp")
    each = [ca.fmax(x, y), ca.fmin(y, x), ca.if_else(x < y, x, 1.0), ca.fabs(x - 1), ca.sign(y * p), ca.fmax(p, 1.0)]
    f = ca.Function("f", [x, y, p], [ca.vertcat(*each, ca.sin(x) * y)])
    found = ca.Function("found", [x, y, p], [kinks(f, [x, y, p], ca.vertcat(x, y))])
    assert np.sort(np.abs(found(0.3, 0.7, 2.0).full().ravel())) == pytest.approx([0.4, 0.7, 1.4])


def test_a_scene_without_kinks_has_nothing_of_them():
    values = {"solver.method": "explicit"}
    functions = [prepared(with_defaults(alfmu.derive(m), values)).functions for m in (ball(), alfmu.load("four_bar"))]
    assert [any("kinks" in name for name in each) for each in functions] == [True, False]


# Contacts that are stiff once they touch ----------------------------------------------------------------------------

PRESSED = {
    **{"l1": 0.9034, "l2": 6.178, "m1": 218.8, "m2": 1.994e-4, "m3": 1.753, "radius": 0.0711, "stop": 1.639},
    **{"stiffness": 2.145e7, "dissipation": 0.8229, "onset": 5.549e-5, "start.angle": -0.1684},
    **{"start.angular_velocity": -1.781},
}
"""A rod of 0.2 g presses a slider against a stop, whose damping is stiff."""


def pressed(unit: alfmu.Instance) -> alfmu.Instance:
    initialized(unit, PRESSED)
    return unit


@pytest.mark.slow
def test_auto_goes_over_to_implicit_steps_where_a_contact_is_stiff():
    """By explicit steps alone 20 million evaluations."""
    automatic = pressed(alfmu.Instance("end_stop", outputs=["flywheel.angle"]))
    assert automatic.equations.decision.method == "explicit"
    assert automatic.equations.decision.reason.endswith("implicit steps where stability limits explicit ones")
    exact = prepared(with_defaults(alfmu.derive(alfmu.load("end_stop")), {"solver.method": "stiff"}))
    exact = pressed(alfmu.Instance(with_defaults(exact, {"solver.relative_tolerance": 1e-11})))
    for _ in range(30):
        automatic.step(0.01)
        exact.step(0.01)
    assert automatic.counters.evaluations < 5000
    size = np.maximum(np.abs(np.concatenate([exact.q, exact.v])), 1.0)
    assert np.max(np.abs(np.concatenate([automatic.q - exact.q, automatic.v - exact.v])) / size) < 1e-6


def damped():
    """Two arms with a damper between them."""
    m = alfmu.Mechanism("damped")
    angles = [m.coordinate(name, "rad", start=start, independent=True) for name, start in (("one", 1.0), ("two", 0.5))]
    damping = m.parameter("damping", 0.1, "N.m.s/rad", minimum=0.0)
    one, two = (m.body(name, mass=1.0, inertia=0.1) for name in ("first", "second"))
    m.revolute("A", m.ground.at(0, 0), one.at(0, 0), coordinate=angles[0])
    joint = m.revolute("B", one.at(1, 0), two.at(-1, 0), coordinate=angles[1])
    m.gravity(0.0, -9.81)
    m.spring_damper(joint, damping=damping)
    return m, "damping", 1e4


def motor():
    """An arm that a motor turns, whose current is a state."""
    m = alfmu.Mechanism("turned")
    angle = m.coordinate("angle", "rad", start=1.0, independent=True)
    inductance = m.parameter("inductance", 1.0, "H", minimum=1e-9)
    arm = m.body("arm", mass=1.0, inertia=0.1)
    joint = m.revolute("A", m.ground.at(0, 0), arm.at(-1, 0), coordinate=angle)
    m.gravity(0.0, -9.81)
    current = m.state("current", "A")
    m.derivative(current, (5.0 - 2.0 * current - 0.5 * m.rate(angle)) / inductance)
    m.drive(joint, 0.5 * current)
    return m, "inductance", 1e-7


@pytest.mark.parametrize("declared", [damped, motor])
def test_auto_goes_over_to_implicit_steps_where_parameters_make_a_scene_stiff(declared):
    """By explicit steps alone hundreds of thousands of evaluations."""
    mechanism, name, value = declared()
    ends = []
    for method, tolerance in (("auto", 1e-6), ("stiff", 1e-10)):
        unit = alfmu.Instance(prepared(with_defaults(alfmu.derive(mechanism), {"solver.method": method})))
        initialized(unit, {"solver.relative_tolerance": tolerance, name: value})
        for _ in range(50):
            unit.step(0.02)
        ends.append(np.concatenate([unit.q, unit.v]))
        if method == "auto":
            assert unit.equations.decision.method == "explicit"
            assert unit.counters.evaluations < 10_000
    assert np.max(np.abs(ends[0] - ends[1])) < 1e-6


@pytest.mark.slow
def test_a_state_has_which_steps_are_made():
    unit = pressed(alfmu.Instance("end_stop", outputs=["flywheel.angle"]))
    for _ in range(10):
        unit.step(0.01)
    state = unit.save()
    for _ in range(10):
        unit.step(0.01)
    there = unit.q, unit.v
    unit.restore(state)
    for _ in range(10):
        unit.step(0.01)
    assert np.array_equal([unit.q, unit.v], there)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["python", "native"])
def test_fmus_go_over_to_implicit_steps_too(tmp_path, kind):
    path = alfmu.export("end_stop", tmp_path / "stop.fmu", kind=kind, reference=False)
    how = {"stop_time": 0.3, "output_interval": 0.01, "start_values": PRESSED, "output": ["flywheel.angle"]}
    found = fmpy.simulate_fmu(str(path), **how)
    unit = pressed(alfmu.Instance("end_stop", outputs=["flywheel.angle"]))
    for _ in range(30):
        unit.step(0.01)
    assert found["flywheel.angle"][-1] == pytest.approx(unit.get("flywheel.angle"), rel=1e-12)


def test_explicit_steps_come_back_where_nothing_touches():
    """A light ball that falls on a stiff, damped ground is pressed against it, and then lifted off it."""
    m = alfmu.Mechanism("lifted")
    y = m.coordinate("y", "m", start=1e-3, independent=True)
    body = m.body("ball", mass=1e-3)
    m.prismatic("rail", m.ground.at(0, 0), body.at(0, 0), axis=np.pi / 2, coordinate=y)
    m.gravity(0.0, -9.81)
    lift = m.input("lift", "N")
    m.force(body.at(0, 0), y=lift + 1e7 * ca.fmax(-y, 0.0) * ca.fmax(1 - 100 * m.rate(y), 0.0))
    heights, stiff = [], []
    for method in ("auto", "explicit"):
        unit = alfmu.Instance(prepared(with_defaults(alfmu.derive(m), {"solver.method": method})))
        initialized(unit, {"solver.relative_tolerance": 1e-8} if method == "explicit" else {})
        for force, steps in ((-1.0, 20), (9.81e-3 + 1e-3, 300)):
            unit.set("lift", force)
            for _ in range(steps):
                unit.step(0.005)
            stiff.append(unit.memory["pace"][PACE.index("stiff")])
        heights.append(unit.get("ball.y"))
    assert stiff == [1.0, 0.0, 0.0, 0.0]
    assert heights[0] > 1.0
    assert heights[0] == pytest.approx(heights[1], rel=1e-6)


@pytest.mark.parametrize("name", ["five_bar", "four_bar", "slider_crank", "bennett", "n_four_bar"])
def test_scenes_that_never_become_stiff_carry_no_implicit_step(name):
    kernel = prepared(alfmu.derive(alfmu.load(name))).kernel
    assert "method" in kernel
    assert "stiff" not in kernel


@pytest.mark.slow
def test_implicit_steps_whose_multipliers_need_more_iterations_are_no_less_stable():
    """A governor of other masses: few iterations do not suit it, and explicit steps on the branch took 235 of 246."""
    unit = alfmu.Instance("flyball_governor", outputs=["slider.position", "monitor.*"])
    values = {"l": 1.416, "width": 0.007067, "density": 958.8, "m_ball": 22.19, "m_slider": 5.828, "side": 0.02657}
    values |= {"pivot": 0.009101, "stiffness": 142500.0, "damping": 263200.0, "rest": 0.3204, "g": 42.88}
    values |= {"start.angle": 2.484, "start.rod_angle": -1.72, "start.position": 0.4065}
    initialized(unit, values)
    for _ in range(3):
        unit.step(0.01)
    tally = dict(zip(TALLY, unit.memory["tally"], strict=True))
    assert tally["tries"] < 50
    assert tally["beside"] == 0


@pytest.mark.slow
def test_positions_that_masses_alone_make_look_singular_are_passed():
    """A governor of thick light rods with a stiff spring, by implicit steps."""
    values = {"l": 1.345, "width": 0.05422, "density": 582.0, "m_ball": 1.107, "m_slider": 3.802, "side": 0.04529}
    values |= {"pivot": 0.01121, "stiffness": 1.306e8, "damping": 21270.0, "rest": 0.2284, "g": 75.69}
    values |= {"start.angle": -1.889, "start.rod_angle": 1.251, "start.position": 0.4195}
    values |= {"start.angular_velocity": -2.115, "start.rod_rate": 6.431}
    ends = []
    for method, tolerance in (("auto", 1e-6), ("explicit", 1e-9)):
        governor = specialised(alfmu.derive(alfmu.load("flyball_governor")), ["slider.position", "monitor.*"])
        unit = alfmu.Instance(prepared(with_defaults(governor, {"solver.method": method})))
        initialized(unit, {**values, "solver.relative_tolerance": tolerance})
        for _ in range(6):
            unit.step(0.01)
        ends.append(unit)
    automatic, exact = ends
    assert automatic.equations.decision.method == "stiff"
    assert dict(zip(TALLY, automatic.memory["tally"], strict=True))["regular_tries"] > 0
    assert automatic.get("slider.position") == pytest.approx(exact.get("slider.position"), abs=1e-5)
    assert automatic.counters.energy_error < 1e-3 * automatic.energy_scale
