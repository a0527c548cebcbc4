"""The slider-crank with masses a million apart and an end stop: one angle by Eksergian's equation, through impacts."""

from functools import cache

import casadi as ca
import numpy as np
import pytest
from oracles import ode
from oracles.end_stop import EndStop
from oracles.free_body import Balance
from scenes import derived, readings, started

import alfmu
from alfmu.fmi.drive import Fmu
from alfmu.model.stops import contact
from alfmu.simulation import prepared

PLAIN = EndStop()
START = (-2.0, 2.0, 0.0)


@cache
def scene() -> alfmu.Equations:
    """The equations, traced once."""
    return prepared(derived("end_stop"))


@cache
def exact(rtol: float = 1e-13, method: str = "DOP853", most: float = 1e-3) -> np.ndarray:
    """th, th', work at eleven times of 1 s; steps so short that none jumps over the impact."""
    return ode.solved(PLAIN.right_side, START, np.linspace(0.0, 1.0, 11), method=method, rtol=rtol, most=most)


@cache
def far() -> np.ndarray:
    """The same every 0.5 s of 5 s, through two impacts."""
    return ode.solved(PLAIN.right_side, START, np.linspace(0.0, 5.0, 11), most=1e-3)


def simulated(h: float, stop: float = 1.0, **given: float) -> alfmu.Result:
    return alfmu.simulate(scene(), stop, stop / 10, parameters={"solver.method": "rk4", "solver.step_size": h, **given})


@pytest.mark.slow
def test_the_reference_is_good_to_1e_12_rad():
    """Shorter steps, a looser tolerance and an implicit method through the impact; energy less work is kept."""
    assert np.abs(exact(most=5e-4) - exact())[:, 0].max() <= 1e-12
    assert np.abs(exact(rtol=1e-12) - exact())[:, 0].max() <= 5e-11
    assert np.abs(exact(rtol=1e-9, method="Radau") - exact())[:, 0].max() <= 1e-8
    # A thousand steps, in each of which 1e-13 of 250 J may be lost.
    assert np.ptp([PLAIN.energy(th, w) - work for th, w, work in exact()]) <= 1000 * 1e-13 * 250
    assert exact()[-1, 2] < -10.0  # what the stop dissipates of 250 J


def test_the_law_of_the_stop_is_smooth_and_comes_from_its_energy():
    """Three continuous derivatives of the push at touch and at full stiffness; by the reference's pieces."""
    x = ca.SX.sym("x")
    energy, push = contact(x, ca.SX(1e8), ca.SX(5e-4))
    slopes = [push]
    for _ in range(3):
        slopes.append(ca.gradient(slopes[-1], x))
    f = ca.Function("f", [x], [energy, ca.gradient(energy, x) - push, *slopes])
    for depth in (-1e-4, 1e-5, 2e-4, 4.9e-4, 5e-4, 3e-3):
        values = [float(y) for y in f(depth)]
        assert values[2::-2] == pytest.approx(PLAIN.spring(PLAIN.stop + depth), rel=1e-10)
        assert abs(values[1]) <= 1e-9 * max(1.0, values[2])
    for at in (0.0, 5e-4):
        below, above = (np.array([float(y) for y in f(at + d)])[2:] for d in (-1e-13, 1e-13))
        assert below == pytest.approx(above, rel=1e-6, abs=1e-6 * 1e8 / 5e-4**2)


@pytest.mark.parametrize("seed", range(6))
def test_accelerations_and_all_joint_forces_at_random_states(seed):
    """In and out of the stop, masses a million apart: th'' to 1e-10, and forces that balance on every body."""
    random = np.random.default_rng(seed)
    th, w = random.uniform([-0.53, -2.0], [-0.51, 2.0]) if seed % 2 else random.uniform([-3, -3], [3, 3])
    loads = {"O.torque": random.uniform(-50, 50), "ram.force": random.uniform(-200, 200)}
    law = EndStop(torque=loads["O.torque"], force=loads["ram.force"])
    r = readings(started(derived("end_stop"), {**loads, "start.angle": th, "start.angular_velocity": w}))
    assert r["flywheel.angular_acceleration"] == pytest.approx(law.acceleration(th, w), rel=1e-10)
    s, rate, _ = law.linkage.places(th)["s"]
    assert r["stop.force"] == pytest.approx(law.contact(s, rate * w), rel=1e-10)
    assert r["monitor.energy"] == pytest.approx(law.energy(th, w), rel=1e-12)
    wheel = law.m1 * law.radius**2 / 2
    bodies = {"flywheel": (law.m1, wheel, (0, 0)), "rod": (law.m2, law.m2 / 12, (0.5, 0)), "ram": (law.m3, 0, (0, 0))}
    b = Balance(r, bodies, (0.0, -law.g))
    b.joint("revolute", "O", "ground", "flywheel", (0, 0))
    b.joint("revolute", "B", "flywheel", "rod", (0, 0))
    b.joint("revolute", "C", "rod", "ram", (0, 0))
    b.joint("prismatic", "guide", "ground", "ram", (0, 0))
    b.left["flywheel"][2] += loads["O.torque"]
    b.left["ram"][0] += loads["ram.force"] + r["stop.force"]
    assert b.lack() <= 1e-11


@pytest.mark.slow
def test_fourth_order_through_the_impact():
    """1 s with one impact, resolved by steps of 0.1 ms and less; higher terms of the error still show in the slope."""
    steps, errors = np.array([1e-4, 5e-5, 2.5e-5]), []
    for h in steps:
        r = simulated(h)
        errors.append(np.abs(r["flywheel.angle"] - exact()[:, 0]).max())
        assert r.counters.position_error <= 1e-13
        assert r.counters.unconverged == 0
    assert np.polyfit(np.log(steps), np.log(errors), 1)[0] == pytest.approx(4.5, abs=0.6), errors
    assert errors[-1] <= 2e-11


@pytest.mark.slow
def test_the_declared_steps_hold_1e_7_rad_through_two_impacts():
    """5 s, with masses a million apart; communication points 1 ms apart, steps of 0.05 ms."""
    r = alfmu.simulate(scene(), parameters={"solver.method": "rk4"})
    assert (r.time[1], r.time[-1]) == (1e-3, 5.0)
    assert np.ptp(far()[:, 1]) > 3.0
    assert np.abs(r["flywheel.angle"][::500] - far()[:, 0]).max() <= 1e-7


@pytest.mark.slow
def test_the_defaults_are_right_through_two_impacts():
    """Short steps, too, see a force that sets in within them."""
    r = alfmu.simulate(scene())
    assert r.counters.steps < r.counters.evaluations <= 8 * r.counters.steps
    assert np.abs(r["flywheel.angle"][::500] - far()[:, 0]).max() <= 1e-5


@pytest.mark.slow
def test_the_ram_hits_the_stop_and_comes_back():
    """A push of some 200 kN for 10 ms, never a pull; what is lost is what the energy balance says."""
    r = alfmu.simulate(scene(), 1.0, 1e-3, parameters={"solver.method": "rk4", "solver.step_size": 1e-4})
    touching = r["stop.penetration"] > 0
    assert 8e-3 <= 1e-3 * np.count_nonzero(touching) <= 16e-3
    assert r["stop.force"].max() <= 0.0
    assert -5e5 <= r["stop.force"].min() <= -1e5
    assert r["flywheel.angular_velocity"][-1] < -1.5
    assert r["monitor.energy"][-1] - r["monitor.energy"][0] == pytest.approx(exact()[-1, 2], abs=1e-3)
    assert r.counters.energy_error <= 1e-3


def test_any_ratio_of_masses_gives_the_same_motion():
    """A rod of 1 g, of 1 mg, of nothing: a million and a thousand million times lighter than the flywheel."""
    angles = [simulated(1e-4, m2=m2)["flywheel.angle"][-1] for m2 in (1e-3, 1e-6, 0.0)]
    assert angles[1:] == pytest.approx([angles[0]] * 2, abs=1e-4)
    assert angles[1] == pytest.approx(angles[2], abs=1e-7)


def test_a_stop_a_hundred_times_as_stiff_needs_a_tenth_of_the_step():
    """An impact 0.02 s after a start close to the stop."""
    law = EndStop(stiffness=1e10, onset=5e-5)
    want = ode.solved(law.right_side, (-0.56, 2.0, 0.0), np.linspace(0.0, 0.05, 11), most=1e-4)
    given = {"stiffness": 1e10, "onset": 5e-5, "start.angle": -0.56}
    fine, coarse = (simulated(h, 0.05, **given)["flywheel.angle"] for h in (2e-5, 1e-3))
    assert want[-1, 1] < -1.0
    assert fine == pytest.approx(want[:, 0], abs=1e-6)
    assert np.abs(coarse - want[:, 0]).max() > 1e-3


def test_the_experiment_is_that_of_the_declaration_and_hits_the_stop(fmu_of):
    with Fmu(fmu_of("end_stop", kind="native")) as fmu:
        assert (fmu.stop_time, fmu.interval, fmu.parameters["solver.step_size"]) == (5.0, 1e-3, 5e-5)
    assert alfmu.simulate("end_stop", 0.75, 0.01, inputs={"O.torque": 5.0})["stop.force"].min() < -1e4


def test_what_cannot_be_assembled_or_is_out_of_bounds_is_refused():
    with pytest.raises(alfmu.AssemblyError, match="end_stop"):
        started(derived("end_stop"), {"l2": 0.2})
    with pytest.raises(alfmu.InputError, match="onset"):
        started(derived("end_stop"), {"onset": 0.0})
