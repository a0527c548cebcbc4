"""Extreme scenes: mass ratios, lengths, speeds, long runs, steps that cannot be taken, numbers that are none.

Each against the exact motion of one degree of freedom, and RK4 on that equation with the same step.
"""

from functools import cache

import numpy as np
import pytest
from oracles import ode
from oracles.parallelogram import Parallelogram
from oracles.slider_crank import SliderCrank
from pairs import ALL, pairs
from scenes import by_the_oracle, cusp, derived, initialized, made, refused

import alfmu
from alfmu import simulate
from alfmu.fmi.drive import Fmu
from alfmu.simulation import prepared, run


@cache
def five_bar(coordinates: str) -> alfmu.Equations:
    return prepared(derived("five_bar", coordinates=coordinates), "vm")


def error(given: dict, step: float, steps: int, coordinates: str = "mixed") -> tuple[float, alfmu.Instance]:
    """Largest angle error [rad] of the five-bar under gravity."""
    i = initialized(alfmu.Instance(five_bar(coordinates)), {**given, "solver.method": "rk4", "solver.step_size": step})
    sizes = {name: value for name, value in given.items() if name in ("l", "m1", "m2", "m3", "m4", "g")}
    linkage = Parallelogram(**sizes)
    inertia, weight = float(linkage.inertia), float(linkage.weight)
    times = step * np.arange(steps + 1)
    exact = ode.motion(lambda t, x, v: -weight * np.cos(x) / inertia, i.q[0], i.v[0], times)[:, 0]
    worst = 0.0
    for k in range(1, steps + 1):
        i.step(step, times[k - 1])
        worst = max(worst, abs(i.q[0] - exact[k]))
    return worst, i


@pytest.mark.slow
@pytest.mark.parametrize(("ratio", "mass", "coordinates"), pairs([1e-6, 1e6], ["m1", "m2"], ["mixed", "joint"]))
def test_mass_ratios(ratio, mass, coordinates):
    """One link a million times lighter or heavier than the others, through singular positions: 5e-7 rad in 5 s."""
    worst, i = error({mass: ratio}, 0.01, 500, coordinates)
    assert worst <= 5e-7
    assert i.counters.unconverged == i.counters.unprojected == 0
    assert i.counters.position_error <= 1e-13


@pytest.mark.parametrize("ratio", [1.0, 1e3, 1e6])
def test_the_distance_is_an_angle_whatever_mass_a_singular_start_has(ratio):
    """At 0.03 rad, by what was calibrated at the singular position itself."""
    margin = by_the_oracle(five_bar("joint"), {"m1": ratio}).margin(0.03 * np.array([1.0, -1.0, 1.0, -1.0]))[1]
    assert np.sqrt(margin) == pytest.approx(0.03, rel=0.01)


@pytest.mark.slow
@pytest.mark.parametrize(("length", "step"), [(1e-3, 2e-4), (1e3, 0.1)])
def test_lengths(length, step):
    """Millimetres and kilometres: 1e-7 rad over 500 steps that suit the period; place to round-off of the length."""
    worst, i = error({"l": length, "start.angular_velocity": 2.0 / np.sqrt(length)}, step, 500)
    assert worst <= 1e-7
    assert i.counters.position_error <= 1e-13 * max(1.0, 10 * length)


def test_ten_thousand_radians_per_second():
    worst, _ = error({"start.angular_velocity": 1e4}, 5e-6, 200)
    assert worst <= 1e-7


@pytest.mark.slow
def test_millions_of_steps_do_not_drift():
    """The particle on its circle, free: radius to round-off, speed to 1e-11."""
    i = alfmu.Instance(prepared(derived("particle_on_circle"), "vm"))
    initialized(i, {"solver.method": "rk4", "solver.step_size": 1e-3})
    millions = 10 if ALL else 2
    for _ in range(millions):
        i.step(1e3)  # as many as one call makes
    assert i.counters.steps == millions * 1_000_000
    assert abs(np.hypot(*i.q) - 1.0) <= 4e-16
    assert abs(np.hypot(*i.v) - 1.0) <= 1e-11


def test_steps_much_too_long_are_refused_and_keep_the_state():
    i = initialized(alfmu.Instance(five_bar("mixed")), {"solver.method": "rk4", "solver.step_size": 3.0})
    before = [i.save()]

    def further() -> None:
        for k in range(20):
            before[0] = i.save()
            i.step(3.0, 3.0 * k)

    with pytest.raises(alfmu.StepError, match=r"five_bar, t = .* s: .*; reduce solver\.step_size"):
        further()
    assert i.save() == before[0]
    assert np.isfinite(i.read()).all()


EXTREMES = {
    "mass ratio": ({"m2": 1e6}, 0.01),
    "other mass ratio": ({"m1": 1e-6}, 0.01),
    "a millimetre": ({"l": 1e-3, "start.angular_velocity": 60.0}, 2e-4),
    "a kilometre": ({"l": 1e3, "start.angular_velocity": 0.06}, 0.1),
    "fast": ({"start.angular_velocity": 1e4}, 5e-6),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", EXTREMES)
def test_extreme_scenes_are_the_same_through_an_fmu(exported, case):
    given, step = EXTREMES[case]
    parameters = {**given, "solver.method": "rk4", "solver.step_size": step}
    own = simulate(five_bar("mixed"), 40 * step, step, parameters=parameters)
    with Fmu(exported("five_bar")) as fmu:
        result = run(fmu, 40 * step, step, parameters=parameters)
    assert np.array_equal(result.values, own.values)


@pytest.mark.slow
def test_refused_steps_and_bad_numbers_through_an_fmu(exported):
    with Fmu(exported("four_bar")) as fmu:
        initialized(fmu, {"solver.method": "rk4", "start.angle": 0.5})
        fmu.step(0.02, 0.0)
        before = fmu.read()
        for bad in (1e6, -1e6, np.nan, np.inf):
            fmu.set("A.torque", bad)
            with pytest.raises(alfmu.StepError, match="more than half a turn" if np.isfinite(bad) else "finite number"):
                fmu.step(0.02, 0.02)
        fmu.set("A.torque", 0.0)
        assert np.array_equal(fmu.read(), before)
        fmu.step(0.02, 0.02)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_none_are_refused_everywhere(bad):
    i = alfmu.Instance(five_bar("mixed"))
    for variable in [*i.parameters, *i.input_variables]:
        before = i.get(variable.name)
        with pytest.raises(alfmu.InputError, match="must be a finite number"):
            i.set(variable.name, bad)
        assert i.get(variable.name) == before
    i.initialize()
    state = i.save()
    for step in (bad, 0.0, -1.0):
        with pytest.raises(alfmu.InputError, match="communication step"):
            i.step(step)
    assert i.save() == state


def test_a_kilometre_stays_in_the_kernel():
    _, i = error({"l": 1e3, "start.angular_velocity": 0.06, "start.angle": 0.4}, 0.1, 40)
    assert i.counters.evaluations <= 1.5 * 4 * i.counters.steps  # not by the oracle, step after step


@pytest.mark.slow
@pytest.mark.parametrize(("crank", "rod"), [(1e-3, 1e3), (1e-3, 1.0), (1.0, 1e3)])
def test_a_millimetre_and_a_kilometre_in_one_scene(crank, rod):
    """Slider-crank with constraints of very different size: what a crank of its length loses with any rod."""
    step = 0.5e-3 * min(1.0, (crank / 1e-3) ** 0.5)
    times = np.linspace(0.0, 0.2, 21)
    exact = SliderCrank(l1=crank, l2=rod).motion(0.7, 0.0, times)[:, 0]
    given = {"l1": crank, "l2": rod, "start.angle": 0.7, "solver.method": "rk4", "solver.step_size": step}
    i = initialized(alfmu.Instance(prepared(derived("slider_crank"), "vm")), given)
    worst = 0.0
    for k in range(1, 21):
        i.step(times[k] - times[k - 1])
        worst = max(worst, abs(i.get("crank.angle") - exact[k]))
    assert worst <= 5e-5
    assert i.counters.position_error <= 1e-16 * 1e3 * rod + 1e-13


@pytest.mark.slow
@pytest.mark.parametrize("coordinates", ["mixed", "joint"])
@pytest.mark.parametrize("torque", [1e6, -1e6])
def test_a_torque_step_of_a_million_is_refused_until_the_step_suits_it(coordinates, torque):
    """Steps that turn a link by more than half a turn are refused; short ones give the exact motion."""
    equations = prepared(derived("four_bar", coordinates=coordinates), "vm")
    i = initialized(alfmu.Instance(equations), {"solver.method": "rk4", "start.angle": 0.5})
    i.step(0.02)
    before = i.save()
    i.set("A.torque", torque)
    with pytest.raises(alfmu.StepError, match=r"turned by \d+ rad in one step, more than half a turn; reduce solver"):
        i.step(0.02)
    i.set("A.torque", 0.0)
    assert i.save() == before
    fine = alfmu.Instance(equations)
    initialized(fine, {"start.angle": 0.5, "solver.method": "rk4", "solver.step_size": 1e-5})
    fine.set("A.torque", torque)
    linkage = Parallelogram(m4=None)
    inertia, weight = float(linkage.inertia), float(linkage.weight)
    times = np.linspace(0.0, 0.01, 21)
    exact = ode.motion(lambda t, x, v: (torque - weight * np.cos(x)) / inertia, 0.5, 2.0, times)[:, 0]
    for k in range(1, 21):
        fine.step(times[k] - times[k - 1])
        assert abs(fine.q[0] - exact[k]) <= 5e-9 * max(1.0, abs(exact[k]))


@pytest.mark.slow
def test_a_motion_that_ends_is_said_to_be_locked_up():
    arrival = (13**1.5 - 8) / 27 / np.hypot(1.0, 1.5)
    for kernel in ("oracle", "vm"):
        i = initialized(made(alfmu.derive(cusp()), kernel), {"solver.method": "rk4", "solver.step_size": 0.005})
        i.step(0.79)
        # The whole communication step is undone.
        at = r"cusp, t = 0\.\d+ s: locked up at x = .*, y = .*; no motion continues"
        with refused(i, alfmu.StepError, match=at) as said:
            i.step(0.02)
        assert float(str(said.value).split("t = ")[1].split(" s")[0]) == pytest.approx(arrival, rel=0.005)
        assert np.hypot(*i.v) == pytest.approx(np.hypot(1.0, 1.5), rel=1e-5)
        assert np.isfinite(i.read()).all()  # so near that there is no limit to be read


@pytest.mark.slow
@pytest.mark.parametrize("communication", [0.1, 0.0371])
def test_tiny_steps_pass_singular_positions(communication):
    """Five-bar at 2e-4 s past -pi: a motion that goes on is not taken for one that is locked up."""
    i = alfmu.Instance(prepared(derived("five_bar"), "vm"))
    initialized(i, {"solver.method": "rk4", "solver.step_size": 2e-4})
    while i.time < 1.2:
        i.step(communication)
    assert i.q[0] < -np.pi
    assert abs(i.get("monitor.energy") - i.energy_start) <= 1e-9
