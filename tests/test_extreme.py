"""Extreme scenes: mass ratios, lengths, speeds, long runs, steps that cannot be taken, numbers that are none.

Each against the exact motion of one degree of freedom, and RK4 on that equation with the same step.
"""

from functools import cache

import numpy as np
import pytest
from oracles import ode
from oracles.parallelogram import Parallelogram
from scenes import derived

import alfmu
from alfmu.simulation import prepared


@cache
def five_bar(coordinates: str) -> alfmu.Equations:
    return prepared(derived("five_bar", coordinates=coordinates), "vm")


def error(given: dict, step: float, steps: int, coordinates: str = "mixed") -> tuple[float, alfmu.Instance]:
    """Largest angle error [rad] of the five-bar under gravity."""
    i = alfmu.Instance(five_bar(coordinates))
    for name, value in {**given, "solver.step_size": step}.items():
        i.set(name, value)
    i.initialize()
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


@pytest.mark.parametrize("coordinates", ["mixed", "joint"])
@pytest.mark.parametrize("mass", ["m1", "m2"])
@pytest.mark.parametrize("ratio", [1e-6, 1e6])
def test_mass_ratios(ratio, mass, coordinates):
    """One link a million times lighter or heavier than the others, through singular positions: 5e-7 rad in 5 s."""
    worst, i = error({mass: ratio}, 0.01, 500, coordinates)
    assert worst <= 5e-7
    assert i.counters.unconverged == i.counters.unprojected == 0
    assert i.counters.position_error <= 1e-13


@pytest.mark.parametrize(("length", "step"), [(1e-3, 2e-4), (1e3, 0.1)])
def test_lengths(length, step):
    """Millimetres and kilometres: 1e-7 rad over 500 steps that suit the period; place to round-off of the length."""
    worst, i = error({"l": length, "start.angular_velocity": 2.0 / np.sqrt(length)}, step, 500)
    assert worst <= 1e-7
    assert i.counters.position_error <= 1e-13 * max(1.0, 10 * length)


def test_ten_thousand_radians_per_second():
    worst, _ = error({"start.angular_velocity": 1e4}, 5e-6, 200)
    assert worst <= 1e-7


def test_ten_million_steps_do_not_drift():
    """The particle on its circle, free: radius to round-off, speed to 1e-11."""
    i = alfmu.Instance(prepared(derived("particle_on_circle"), "compiled"))
    i.set("solver.step_size", 1e-3)
    i.initialize()
    i.step(1e4)
    assert i.counters.steps == 10_000_000
    assert abs(np.hypot(*i.q) - 1.0) <= 4e-16
    assert abs(np.hypot(*i.v) - 1.0) <= 1e-11


def test_steps_much_too_long_are_refused_and_keep_the_state():
    i = alfmu.Instance(five_bar("mixed"))
    i.set("solver.step_size", 3.0)
    i.initialize()
    before = [i.save()]

    def further() -> None:
        for k in range(20):
            before[0] = i.save()
            i.step(3.0, 3.0 * k)

    with pytest.raises(alfmu.StepError, match=r"five_bar, t = .* s: .*; reduce solver\.step_size"):
        further()
    assert i.save() == before[0]
    assert np.isfinite(i.read()).all()


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
