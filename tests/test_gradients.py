"""Derivatives of runs: of the discrete steps against complex steps, of motions against closed forms and an unrelated
integrator, forward against back, by every integrator, through singular positions, redundant constraints and locks."""

import math

import casadi as ca
import numpy as np
import pytest
from oracles.complex_steps import EPSILON, Complex
from scipy.integrate import solve_ivp

import alfmu
from alfmu.gradients import Columns, Final, Integral, Maximum, TimeOfMaximum, derivatives, gradient
from alfmu.gradients.run import Runs
from alfmu.runtime import Instance

NUMBERS = {"l": 1.0, "m1": 1.0, "m2": 0.7, "m3": 1.0, "m4": 1.0, "g": 9.81}
"""Parameters of the five-bar, in the order of its declaration."""


def parallelogram(l: complex, a: complex, w: complex) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and velocities of the five-bar by its angle and angular velocity."""
    c, s = np.cos(a), np.sin(a)
    q = [a, l * c + l / 2, l * s, 0, a, l / 2 * c + l / 2, l / 2 * s, 0]
    v = [w, -l * s * w, l * c * w, 0, w, -l / 2 * s * w, l / 2 * c * w, 0]
    return np.array(q), np.array(v)


def by_complex_steps(name: str, method: str, angle: float, steps: int, h: float) -> tuple[np.ndarray, list[str]]:
    """Derivatives of q and v of the five-bar after some steps, and the tiers of the steps."""
    unit = Instance("five_bar")
    numbers = {**NUMBERS, "start.angle": angle, "start.angular_velocity": 2.0}
    for key, value in {**numbers, "solver.method": method, "solver.step_size": h}.items():
        unit.set(key, value)
    unit.initialize()
    numbers[name] += 1j * EPSILON
    q, v = parallelogram(numbers["l"], numbers["start.angle"], numbers["start.angular_velocity"])
    own = len(unit.equations.parameters)
    p = [numbers[v.name] for v in unit.parameters[:own]]
    np.testing.assert_allclose(q.real, unit.q, atol=1e-14)
    np.testing.assert_allclose(v.real, unit.v, atol=1e-13)
    found = Complex(unit, q, v, p)
    if method == "rk4":
        found.rk4(steps, h)
    else:
        for k in range(steps):
            found.method((k + 1) * h)
    return found.m["z"][:16].imag / EPSILON, found.tiers


def coordinates(method: str, name: str, angle: float, steps: int, h: float) -> np.ndarray:
    """The same by tangents."""
    unit = Instance("five_bar")
    given = {**NUMBERS, "start.angle": angle, "solver.method": method, "solver.step_size": h}
    outputs = ["link1.angle", "link2.x", "link2.y", "link2.angle", "link3.angle", "link4.x", "link4.y", "link4.angle"]
    rates = [
        *("link1.angular_velocity", "link2.vx", "link2.vy", "link2.angular_velocity", "link3.angular_velocity"),
        *("link4.vx", "link4.vy", "link4.angular_velocity"),
    ]
    del unit
    found = derivatives("five_bar", [name], steps * h, h, outputs=[*outputs, *rates], parameters=given)
    return found.values[-1, :, 0]


@pytest.mark.parametrize("name", ["l", "m2", "start.angle"])
@pytest.mark.parametrize(
    ("method", "angle", "steps", "bound"),
    [("rk4", 0.3, 12, 1e-11), ("rk4", 0.0, 6, 1e-9), ("stiff", 0.3, 3, 1e-9), ("explicit", 0.3, 3, 1e-9)],
)
def test_discrete_steps_have_the_derivatives_that_complex_steps_tell(
    method: str, angle: float, steps: int, bound: float, name: str
):
    wanted, tiers = by_complex_steps(name, method, angle, steps, 0.02)
    found = coordinates(method, name, angle, steps, 0.02)
    assert np.abs(found - wanted).max() <= bound * np.abs(wanted).max()
    if angle == 0.0 and method == "rk4":
        assert "branch" in tiers  # begins in a singular position
