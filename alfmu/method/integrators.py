"""Explicit integration of a state vector with a given rate, independent of mechanisms."""

from collections.abc import Callable
from typing import Any


def rk4(rate: Callable[[Any, Any], Any], t: Any, y: Any, dt: Any) -> Any:
    """Return one step of the classic Runge-Kutta method of order 4 from y at t to t + dt (Kutta 1901)."""
    k1 = rate(t, y)
    k2 = rate(t + dt / 2, y + dt / 2 * k1)
    k3 = rate(t + dt / 2, y + dt / 2 * k2)
    k4 = rate(t + dt, y + dt * k3)
    return y + dt / 6 * (k1 + 2 * (k2 + k3) + k4)
