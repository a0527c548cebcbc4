"""Bennett's linkage, over-constrained in space: fourth order for every penalty, and reactions of least norm."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from scenes import derived, started

import alfmu
from alfmu.simulation import prepared

STEPS = (0.02, 0.01, 0.005, 0.0025)
A, ALPHA, BETA, G = 0.3, 0.7, 1.2, 9.81


@cache
def reference() -> tuple[ca.Function, np.ndarray, np.ndarray]:
    """Acceleration of the one equation in th1, written down with screws instead of matrices of links; its motion."""
    th, w = ca.SX.sym("th"), ca.SX.sym("w")
    b = A * np.sin(BETA) / np.sin(ALPHA)
    k = np.sin((BETA + ALPHA) / 2) / np.sin((BETA - ALPHA) / 2)
    other = 2 * ca.atan2(k * ca.cos(th / 2), ca.sin(th / 2))

    def rotated(axis: ca.SX, angle: ca.SX, x: ca.SX) -> ca.SX:  # Rodrigues
        return x * ca.cos(angle) + ca.cross(axis, x) * ca.sin(angle) + axis * ca.dot(axis, x) * (1 - ca.cos(angle))

    place, hinge, normal = ca.SX.zeros(3), ca.SX([0, 0, 1]), ca.SX([1, 0, 0])
    kinetic = potential = 0
    for angle, length, twist in ((th, A, ALPHA), (other, b, BETA), (-th, A, ALPHA)):
        normal = rotated(hinge, angle, normal)
        center = place + length / 2 * normal
        kinetic += ca.sumsqr(ca.jtimes(center, th, w)) / 2 + length**2 / 24 * ca.sumsqr(ca.jtimes(normal, th, w))
        potential += G * center[1]
        place, hinge = place + length * normal, rotated(normal, twist, hinge)
    gap = ca.Function("gap", [th], [ca.norm_2(place + b * rotated(hinge, -other, normal))])
    assert max(float(gap(x)) for x in (0.3, 1.0, 2.5, -2.0)) < 1e-14  # the fourth link closes the loop
    inertia = ca.hessian(kinetic, w)[0]
    rate = (-ca.gradient(potential, th) - ca.gradient(inertia, th) * w**2 / 2) / inertia
    acceleration = ca.Function("acceleration", [th, w], [rate])
    times = np.arange(0.0, 2.05, 0.1)
    return acceleration, times, ode.motion(lambda t, x, v: float(acceleration(x, v)), 1.0, 3.0, times)


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-3, 1e-4, 1e-5])
def test_loose_tolerances_are_held_over_the_whole_run(tolerance):
    """Six turns, by steps so long that the estimate misses a part of their errors; few communication points."""
    acceleration, times = reference()[0], np.arange(0.0, 10.5)
    exact = ode.motion(lambda t, x, v: float(acceleration(x, v)), 1.0, 3.0, times)[:, 0]
    given = {"solver.method": "explicit", "solver.relative_tolerance": tolerance}
    r = alfmu.simulate(derived("bennett"), 10.0, 1.0, parameters=given)
    assert np.abs(r["hinge1.angle"] - exact).max() <= 10 * tolerance
    assert r.counters.evaluations <= 2_800


@pytest.mark.slow
@pytest.mark.parametrize("penalty", [0.0, 1.0, 1e3, 1e6, 1e9, 1e12])
def test_fourth_order_for_every_penalty(penalty):
    """The same error to 1 % for penalties over twelve decades, the default among them; no redundant row brakes."""
    _, _, exact = reference()
    errors = []
    for h in STEPS:
        given = {"solver.penalty": penalty, "solver.method": "rk4", "solver.step_size": h}
        if 0 < penalty < 1e4:
            given["solver.max_iterations"] = 200
        r = alfmu.simulate(derived("bennett"), 2.0, 0.1, parameters=given)
        errors.append(np.abs(r["hinge1.angle"] - exact[:, 0]).max())
        assert r.counters.position_error <= (1e-12 if penalty != 1.0 else 1e-9)  # 1 kg corrects little at a time
    assert np.ptp(exact[:, 0]) > 6.0  # more than a turn
    assert np.polyfit(np.log(STEPS), np.log(errors), 1)[0] == pytest.approx(4.0, abs=0.2)
    assert errors == pytest.approx(at_default(), rel=0.01)


@cache
def at_default() -> list[float]:
    _, _, exact = reference()
    found = []
    for h in STEPS:
        r = alfmu.simulate(derived("bennett"), 2.0, 0.1, parameters={"solver.method": "rk4", "solver.step_size": h})
        found.append(float(np.abs(r["hinge1.angle"] - exact[:, 0]).max()))
    return found


@pytest.mark.slow
def test_multipliers_are_those_of_least_norm():
    """Against a pseudo-inverse of C' from the same equations, to 1e-12 of the largest."""
    i = started(derived("bennett"), {"hinge1.torque": 2.0})
    i.step(0.5)
    e, p = i.equations, i.memory["p"]
    q, v, a = i.q, i.v, np.array([i.get(f"hinge{k}.angular_acceleration") for k in range(1, 5)])
    M, C, f, d = (np.array(x) for x in (e.M(q, p), e.C(q, p), e.f(q, v, [2.0], p, i.time), e.d(q, v, p)))
    lam = np.array([i.get(f"multiplier[{k}]") for k in range(1, 7)])
    assert np.linalg.matrix_rank(C, tol=1e-9) == 3
    exact = np.linalg.pinv(C.T, rcond=1e-9) @ (f.ravel() - d.ravel() - M @ a)
    assert np.abs(lam - exact).max() <= 1e-12 * np.abs(exact).max()
    assert a[0] == pytest.approx(-a[2], rel=1e-9)


@pytest.mark.slow
def test_mobility_and_kernel():
    """One freedom, three redundant rows; run by the kernel, also after a restore."""
    i = alfmu.Instance(prepared(derived("bennett"), "vm"))
    i.initialize()
    assert (i.mobility().freedom, i.mobility().redundant) == (1, 3)
    assert i.counters.patient == 0
    other = alfmu.Instance(i.equations)
    other.restore(i.save())
    for each in (i, other):
        each.step(0.3)
    assert np.array_equal(i.read(), other.read())


@pytest.mark.slow
def test_a_linkage_that_has_turned_many_times_goes_on():
    """Digits that turned angles have lost move its redundant rows, by which no velocities make C v vanish."""
    given = {"a": 0.56, "alpha": 0.24, "beta": 0.145, "m1": 0.11, "m2": 4.2, "m3": 6.7, "start.angle": 1.44}
    result = alfmu.simulate("bennett", 1.8, 0.02, inputs={"hinge1.torque": 120.0}, parameters=given)
    assert max(abs(result["hinge1.angle"])) > 60
    energy, work = result["monitor.energy"], result["monitor.work"]
    assert max(abs(energy - energy[0] - work)) < 1e-6 * max(work)


@pytest.mark.parametrize("beside", ["free", "law"])
def test_at_rest_beside_something_that_moves_it_is_the_same(beside):
    """Its redundant rows were not seen to brake where the motion at the start was that of another part alone."""
    how = {"parameters": {"solver.method": "rk4", "start.angular_velocity": 0.0}, "outputs": ["hinge1.angle"]}
    m = alfmu.load("bennett")
    if beside == "free":
        x = m.coordinate("x", "m", start=0.0, rate=1.0, independent=True)
        m.kinetic_energy(0.5 * m.rate(x) ** 2)
    else:
        bar, x = m.bar("bar", mass=1.0, length=0.3), m.coordinate("x", "rad")
        m.motion(m.revolute("motor", m.ground.at(0, 0), bar.start, coordinate=x), 0.5 * m.time)
    found, alone = (alfmu.simulate(each, 1.0, 0.01, **how)["hinge1.angle"] for each in (m, "bennett"))
    assert np.ptp(alone) > 4
    np.testing.assert_allclose(found, alone, atol=1e-11)
