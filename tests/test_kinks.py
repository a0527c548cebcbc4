"""Forces with kinks: steps across one are judged by a bound that sees it, in every method that controls its error."""

import casadi as ca
import numpy as np
import pytest

import alfmu
from alfmu.kernel.kinks import kinks
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
