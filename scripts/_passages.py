"""Exact motions of linkages through singular positions, and runs of alfmu for comparison.

Each motion has one degree of freedom, on the branch that is followed. RK4 with the same step on the same scalar
equation shows the best accuracy that RK4 can have.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.integrate import solve_ivp

import alfmu
from alfmu import simulate
from alfmu.method.integrators import rk4
from alfmu.simulation import prepared, with_defaults

GRAVITY = 9.81

OWN, PAPER = "continue", "paper"
"""Values of solver.branch: the default, and the plain scheme."""

DRIVEN_SPEED = 2.0
"""Driven linkages start exactly at 0 with this speed [rad/s]."""

ROW_START = (np.pi / 2, -1.0)
CRANK_START, CRANK_STEP, ROD = (np.pi / 4, 0.0), 0.00125, 0.5
"""Starts of the N-four-bar and the slider-crank [rad, rad/s], its step [s] and the length of its links [m]."""

# The exact motion -------------------------------------------------------------------------------------------------

Acceleration = Callable[[NDArray, NDArray, float | NDArray], NDArray]
"""Function of th, th' and a torque on the crank that returns th''; all may be arrays over motions."""

LARGEST = 0.005
"""Longest step of the reference [s]; its error is then round-off."""


@cache
def parallelogram(m2: float = 1.0, m4: float = 0.0) -> Acceleration:
    """Return th'' of the five-bar on its parallelogram branch, links of 1 m and 1 kg; m4 = 0 is the four-bar.

    (m1/3 + m3/3 + m2 + m4/4) l^2 th'' = torque - (m1/2 + m3/2 + m2 + m4/2) g l cos th
    """
    inertia, weight = 2 / 3 + m2 + m4 / 4, (1 + m2 + m4 / 2) * GRAVITY
    return lambda th, w, torque: (torque - weight * np.cos(th)) / inertia


def row(loops: int) -> Acceleration:
    """Return th'' of the N-four-bar, links of 1 m and 1 kg: (4 N + 1) / 3 m l^2 th'' = -(3 N + 1) / 2 m g l cos th."""
    return lambda th, w, torque: (torque - (3 * loops + 1) / 2 * GRAVITY * np.cos(th)) / ((4 * loops + 1) / 3)


def slider_crank(th: NDArray, w: NDArray, torque: float | NDArray) -> NDArray:
    """Return th'' of a slider-crank of equal links whose rod mirrors the crank, with masses of 1 kg.

    The centres of the rod at l (3/2 cos th, 1/2 sin th) and of the slider at 2 l cos th give J th'' + J' th'^2 / 2.
    """
    s, c = np.sin(th), np.cos(th)
    J = ROD**2 * (1 / 3 + 1 / 12 + 9 / 4 * s**2 + c**2 / 4 + 4 * s**2)
    return (torque - GRAVITY * ROD * c - 6 * ROD**2 * s * c * w**2) / J


class Reference(NamedTuple):
    """Angles (steps + 1, motions) [rad], exact and by RK4, and the change of the exact ones if the steps are halved."""

    exact: NDArray
    by_rk4: NDArray
    change: float


def reference(acceleration: Acceleration, start: Sequence, torque: float | NDArray, dt: float, steps: int) -> Reference:
    """Return the motions from angles and speeds [rad, rad/s] under a torque."""
    y = np.array([np.atleast_1d(x) for x in start], float)
    by_rk4 = [y]
    for _ in range(steps):
        by_rk4.append(rk4(partial(_rate, acceleration, torque), 0.0, by_rk4[-1], dt))
    times = dt * np.arange(steps + 1)
    exact, finer = (motion(acceleration, y, torque, times, largest) for largest in (LARGEST, LARGEST / 2))
    return Reference(exact[:, 0], np.array(by_rk4)[:, 0], float(np.abs(exact - finer)[:, 0].max()))


def motion(acceleration: Acceleration, y: NDArray, torque: float | NDArray, times: NDArray, largest: float) -> NDArray:
    """Return angles and speeds (times, 2, motions) by DOP853."""
    solution = solve_ivp(
        lambda t, z: _rate(acceleration, torque, t, z.reshape(y.shape)).ravel(),
        (times[0], times[-1]),
        y.ravel(),
        "DOP853",
        times,
        rtol=1e-13,
        atol=1e-13,
        max_step=largest,
    )
    return solution.y.T.reshape(len(times), *y.shape)


def _rate(acceleration: Acceleration, torque: float | NDArray, t: float, y: NDArray) -> NDArray:
    return np.array([y[1], acceleration(y[0], y[1], torque)])


# Runs -------------------------------------------------------------------------------------------------------------


@cache
def scene(name: str, **options: str | int) -> alfmu.Equations:
    """Return the scene of a mechanism for the interpreter and RK4; each run sets its step."""
    return prepared(with_defaults(alfmu.derive(alfmu.load(name, **options)), {"solver.method": "rk4"}), "vm")


@dataclass
class Run:
    """Results of a run up to its end; `stopped` is the reason of an early end."""

    angles: NDArray
    """Angles of the crank after each step [rad]."""
    evaluations: int
    stopped: str | None = None

    def error(self, exact: NDArray) -> float:
        """Return the largest angle error [rad]."""
        return float(np.abs(self.angles - exact[: len(self.angles)]).max())


def drive(
    equations: alfmu.Equations, given: Mapping[str, float | str], torques: Mapping[str, float], dt: float, steps: int
) -> Run:
    """Step a linkage from an assembled start under constant torques."""
    i, stopped, angles = alfmu.Instance(equations), None, []
    crank = [c.name for c in equations.coordinates].index("th1")
    for name, value in {"g": GRAVITY, **given, **torques, "solver.step_size": dt}.items():
        i.set(name, value)
    try:
        i.initialize()
        angles.append(i.q[crank])
        for k in range(steps):
            i.step(dt, k * dt)
            angles.append(i.q[crank])
    except alfmu.AlfmuError as error:
        stopped = str(error)
    return Run(np.array(angles), i.counters.evaluations, stopped)


class Phase(NamedTuple):
    """Start and drive of the four-bar."""

    angle: float
    torque: float
    speed: float


def phases(number: int) -> list[Phase]:
    """Return phases with random starting angles [rad] and cyclic torques [N.m] and speeds [rad/s]."""
    angles = np.random.default_rng(1).uniform(-np.pi, np.pi, number)
    torques, speeds = (4.0, 2.0, 1.0, -3.0, 8.0), (2.0, 2.0, 0.5)
    return [Phase(float(x), torques[k % 5], speeds[k % 3]) for k, x in enumerate(angles)]


def run_phases(dt: float, starts: Sequence[Phase]) -> list[Run]:
    """Run the four-bar from these phases over 2.5 s."""
    equations, runs = scene("four_bar", coordinates="mixed"), []
    for phase in starts:
        given = {"start.angle": phase.angle, "start.angular_velocity": phase.speed}
        runs.append(drive(equations, given, {"A.torque": phase.torque}, dt, round(2.5 / dt)))
    return runs


def crank_run(exact: NDArray) -> tuple[float, int]:
    """Run the slider-crank in natural coordinates; return the largest error [rad] every 0.05 s, and evaluations."""
    given = {"l1": ROD, "l2": ROD, "start.angle": CRANK_START[0], "start.angular_velocity": CRANK_START[1]}
    given |= {"solver.step_size": CRANK_STEP, "g": GRAVITY}
    equations = scene("slider_crank", coordinates="natural")
    r = simulate(equations, 0.05 * (len(exact) - 1), 0.05, parameters=given, kernel="vm")
    return float(np.abs(r["crank.angle"] - exact).max()), r.counters.evaluations
