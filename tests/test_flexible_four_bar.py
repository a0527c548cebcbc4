"""The four-bar with a flexible coupler: Newton's and Euler's laws on each bar, fast oscillation upon slow motion."""

from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from oracles import ode
from oracles.flexible_four_bar import FlexibleFourBar
from scenes import by_rk4, derived, readings, started

import alfmu

START = (0.5, 1e-3, 6.0, 0.0)
"""Angle of the crank, bend, and their rates."""
PLAIN = FlexibleFourBar()
STIFF_AND_DAMPED = FlexibleFourBar(damping=300.0)


scene = partial(by_rk4, "flexible_four_bar")
"""The equations, traced once."""


@cache
def exact(linkage: FlexibleFourBar = PLAIN, stop: float = 0.05, method: str = "DOP853", rtol: float = 1e-12):
    times = np.linspace(0.0, stop, 11)
    return ode.solved(linkage.right_side(), START, times, method=method, rtol=rtol)


def simulated(linkage: FlexibleFourBar, h: float, stop: float = 0.05) -> alfmu.Result:
    given = {k: x for k, x in vars(linkage).items() if k != "torque"} | {"solver.method": "rk4", "solver.step_size": h}
    return alfmu.simulate(scene(), stop, stop / 10, parameters=given, inputs={"O.torque": linkage.torque})


@pytest.mark.slow
def test_the_reference_is_good_to_1e_9():
    """A tolerance ten times as loose, and for strong damping an implicit method; it closes the loop."""
    assert np.abs(exact(rtol=1e-11) - exact())[:, :2].max() <= 1e-12
    short = (STIFF_AND_DAMPED, 0.002)
    assert np.abs(exact(*short, "Radau", 1e-9) - exact(*short))[:, :2].max() <= 1e-9
    for th in np.linspace(0.0, 6.0, 7):
        for beta in (0.0, 0.3, -0.2):
            angles = PLAIN.angles(th, beta)
            ends = [PLAIN.lengths[bar] * np.exp(1j * angles[bar]) for bar in ("crank", "near", "far", "rocker")]
            assert abs(sum(ends[:3]) - ends[3] - PLAIN.l0) <= 1e-14


@pytest.mark.parametrize("seed", range(6))
def test_accelerations_and_all_joint_forces_at_random_states(seed):
    """Any dimensions, a bend of up to 0.3 rad, to 1e-11 of the largest."""
    random = np.random.default_rng(seed)
    fields = {k: x * random.uniform(0.9, 1.1) for k, x in vars(PLAIN).items() if k not in ("torque", "rest")}
    linkage = FlexibleFourBar(**fields, rest=random.uniform(-0.1, 0.1), torque=random.uniform(-9, 9))
    th, beta, w, rate = random.uniform([-3, -0.3, -9, -9], [3, 0.3, 9, 9])
    start = {"start.angle": th, "start.bend": beta, "start.angular_velocity": w, "start.bend_rate": rate}
    given = {**fields, "rest": linkage.rest, **start, "O.torque": linkage.torque}
    r = readings(started(derived("flexible_four_bar"), given))
    want = linkage.accelerations(th, beta, w, rate)
    scale = {kind: max(abs(x) for name, x in want.items() if kind in name) for kind in ("force", "a")}
    for name, x in want.items():
        assert abs(r[name] - x) <= 1e-11 * scale["force" if "force" in name else "a"]
    assert r["B.moment"] == pytest.approx(linkage.moment(beta, rate), rel=1e-13)


@pytest.mark.slow
@pytest.mark.parametrize("linkage", [PLAIN, replace(PLAIN, stiffness=2e4, torque=3.0)], ids=["stiff", "softer, driven"])
def test_fourth_order_upon_the_fast_oscillation(linkage):
    """0.05 s are 25 periods of the bend: amplitude and phase of it at fourth order, and the slow crank with them."""
    steps, errors = np.array([1e-4, 5e-5, 2.5e-5]), []
    for h in steps:
        r = simulated(linkage, h)
        errors.append([np.abs(r[n] - exact(linkage)[:, k]).max() for k, n in enumerate(("crank.angle", "B.angle"))])
        assert r.counters.position_error <= 1e-13
        assert r.counters.unconverged == 0
    slopes = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert (np.abs(slopes - 4) <= 0.35).all(), slopes
    assert np.max(errors[-1]) <= 3e-8


def test_the_bend_is_small_and_fast_the_crank_slow():
    """Without damping the bend passes its mean some 80 times in 0.1 s, and never exceeds 2 mrad."""
    r = alfmu.simulate(
        scene(), 0.1, 1e-4, parameters={"damping": 0.0, "solver.method": "rk4", "solver.step_size": 5e-5}
    )
    bend = r["B.angle"]
    assert np.abs(bend).max() <= 2e-3
    assert 60 <= np.count_nonzero(np.diff(np.sign(bend - bend.mean()))) <= 120
    assert r["crank.angle"][-1] - 0.5 == pytest.approx(0.4, abs=0.1)
    assert np.ptp(r["monitor.energy"]) <= 1e-4
    assert r.counters.energy_error <= 1e-4


def test_energy_balance_with_damping_and_torque():
    """What the damper takes and the torque gives, kept by the run, to the error of the steps; the sum shrinks."""
    r = simulated(replace(PLAIN, torque=2.0), 2.5e-5)
    assert r.counters.energy_error <= 1e-6
    still = simulated(PLAIN, 2.5e-5)
    assert still["monitor.energy"][-1] - still["monitor.energy"][0] <= -0.01


def test_a_strongly_damped_joint_and_its_limit_of_stability():
    """Damping of 300 N.m.s/rad: eigenvalues to 34000 1/s, so that RK4 takes 8e-5 s; a fifth more loses the motion."""

    def largest(y: np.ndarray) -> float:
        f, step = STIFF_AND_DAMPED.right_side(), 1e-7
        slopes = [(np.array(f(0, y + step * e)) - np.array(f(0, y - step * e))) / 2 / step for e in np.eye(4)]
        return np.abs(np.linalg.eigvals(np.array(slopes).T)).max()

    limit = 2.785 / max(largest(y) for y in exact(STIFF_AND_DAMPED, 0.02))
    assert 6e-5 < limit < 1.2e-4
    r = simulated(STIFF_AND_DAMPED, 0.95 * limit, 0.02)
    assert r["crank.angle"] == pytest.approx(exact(STIFF_AND_DAMPED, 0.02)[:, 0], abs=1e-5)
    lost = simulated(STIFF_AND_DAMPED, 1.2 * limit, 0.02)
    assert np.abs(lost["crank.angle"] - exact(STIFF_AND_DAMPED, 0.02)[:, 0]).max() > 1e-2


def test_what_cannot_be_assembled_or_is_out_of_bounds_is_refused():
    with pytest.raises(alfmu.AssemblyError, match="flexible_four_bar"):
        started(derived("flexible_four_bar"), {"l0": 3.0})
    with pytest.raises(alfmu.InputError, match="stiffness"):
        started(derived("flexible_four_bar"), {"stiffness": -1.0})
