"""Reference motions by an explicit method of order eight, Dormand and Prince's DOP853, tighter than what they judge."""

from collections.abc import Callable

import numpy as np
from scipy.integrate import solve_ivp

RTOL, ATOL = 1e-13, 1e-14
"""A hundred times round-off; scipy refuses less than that."""


def motion(acceleration: Callable[[float, float, float], float], x: float, v: float, times: np.ndarray) -> np.ndarray:
    """Place and velocity (len(times), 2) at `times` of x'' = acceleration(t, x, x') from x, v at times[0]."""
    solution = solve_ivp(
        lambda t, y: (y[1], acceleration(t, *y)),
        (times[0], times[-1]),
        (x, v),
        "DOP853",
        times,
        rtol=RTOL,
        atol=ATOL,
        first_step=1e-3,
    )
    assert solution.success, solution.message
    return solution.y.T


def plain_steps(acceleration: Callable[[float, float], float], x: float, v: float, h: float, steps: int) -> np.ndarray:
    """Places (steps + 1,) by Kutta's method of order four on x'' = acceleration(x, x'): what its step alone costs."""
    places = [x]
    for _ in range(steps):
        x1, v1, a1 = x, v, acceleration(x, v)
        x2, v2 = x + h / 2 * v1, v + h / 2 * a1
        a2 = acceleration(x2, v2)
        x3, v3 = x + h / 2 * v2, v + h / 2 * a2
        a3 = acceleration(x3, v3)
        x4, v4 = x + h * v3, v + h * a3
        a4 = acceleration(x4, v4)
        x = x1 + h * (v1 + 2 * v2 + 2 * v3 + v4) / 6
        v = v1 + h * (a1 + 2 * a2 + 2 * a3 + a4) / 6
        places.append(x)
    return np.array(places)


def solved(
    right_side: Callable[[float, np.ndarray], list[float]],
    start: tuple,
    times: np.ndarray,
    *,
    method: str = "DOP853",
    rtol: float = 1e-12,
    most: float = np.inf,
) -> np.ndarray:
    """y (len(times), n) at `times` of y' = right_side(t, y), by steps of at most `most`."""
    solution = solve_ivp(
        right_side,
        (times[0], times[-1]),
        start,
        method,
        times,
        rtol=rtol,
        atol=rtol / 100,
        first_step=1e-6,
        max_step=most,
    )
    assert solution.success, solution.message
    return solution.y.T
