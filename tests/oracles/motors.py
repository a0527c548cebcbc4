"""A DC motor on a flywheel by the matrix exponential, and on a slider-crank in its one coordinate by SciPy."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

__all__ = ["Circuit", "crank", "linear", "parallelogram"]


@dataclass(frozen=True)
class Circuit:
    """Resistance [Ohm], inductance [H], constant [N.m/A] and voltage [V] of a motor."""

    R: float = 1.0
    L: float = 0.05
    k: float = 0.5
    u: float = 12.0

    def rate(self, i: float, speed: float) -> float:
        """Rate of the current [A/s]."""
        return (self.u - self.R * i - self.k * speed) / self.L


def linear(matrix: NDArray, constant: NDArray, start: NDArray, t: float) -> NDArray:
    """y at t where y' = matrix y + constant."""
    n = len(start)
    whole = np.zeros((n + 1, n + 1))
    whole[:n, :n], whole[:n, n] = matrix, constant
    return (expm(whole * t) @ np.append(start, 1.0))[:n]


def crank(motor: Circuit, angle: float, speed: float, times: NDArray) -> NDArray:
    """Angle, speed and current of the registered slider-crank with a motor on its crank, by the angle alone.

    Its inertia J(th) is that of unit velocities, taken by complex steps through the places of its bodies:
    J th'' + J' th'^2 / 2 + V' = k i.
    """
    l1, l2, g, step = 0.5, 1.0, 9.81, 1e-30
    inertias = np.array([1.0, 1.0, l1**2 / 12, 1.0, 1.0, l2**2 / 12, 1.0])

    def places(th):
        phi = np.arcsin(-l1 / l2 * np.sin(th))
        x, y = l1 * np.cos(th), l1 * np.sin(th)
        middle = x + l2 / 2 * np.cos(phi), y + l2 / 2 * np.sin(phi)
        return np.array([x / 2, y / 2, th, *middle, phi, x + l2 * np.cos(phi)])

    def inertia(th: float) -> float:
        rates = places(th + 1j * step).imag / step
        return inertias @ rates**2

    def acceleration(th: float, w: float, i: float) -> float:
        d = 1e-3
        # Differences of order 6, whose error is far below what is judged.
        slope = sum(c * (inertia(th + j * d) - inertia(th - j * d)) for j, c in ((1, 45), (2, -9), (3, 1))) / (60 * d)
        rates = places(th + 1j * step).imag / step
        weight = g * (rates[1] + rates[4])
        return (motor.k * i - weight - slope * w**2 / 2) / inertia(th)

    def rate(_: float, y: NDArray) -> list[float]:
        th, w, i = y
        return [w, acceleration(th, w, i), motor.rate(i, w)]

    return _solved(rate, [angle, speed, 0.0], times)


def parallelogram(motor: Circuit, inertia: float, weight: float, angle: float, speed: float, times: NDArray) -> NDArray:
    """The same of the five-bar on its parallelogram branch, with a motor on its first link."""

    def rate(_: float, y: NDArray) -> list[float]:
        th, w, i = y
        return [w, (motor.k * i - weight * np.cos(th)) / inertia, motor.rate(i, w)]

    return _solved(rate, [angle, speed, 0.0], times)


def _solved(rate, start: list[float], times: NDArray) -> NDArray:
    found = solve_ivp(rate, (0.0, times[-1]), start, "DOP853", times, rtol=1e-12, atol=1e-13)
    assert found.success
    return found.y.T
