"""Reactions of joints that give a little: springs and dampers in place of constraints, integrated by SciPy's Radau.

Nothing of the method is used: no multiplier, no projection, no rank. As springs get stiffer the motion tends to that
of rigid joints, and the forces of redundant ones to the shares that their compliances give them.
"""

import numpy as np
from scipy.integrate import solve_ivp

import alfmu

INERTIA = 1e-7
"""Of a massless coordinate [kg.m2]: the springs need something to move."""

DAMPING = 1.0
"""Time constant of the dampers times the root of the largest stiffness [s.(N/m)^(1/2)]: enough for what the start rings
with; they turn shares by the time constant over that of the motion, so that it must be short."""


def forces(
    e: alfmu.Equations, p: np.ndarray, q: np.ndarray, v: np.ndarray, stiffness: np.ndarray, end: float
) -> np.ndarray:
    """Force of each spring and damper (l,) at time `end`, from q, v at time 0, without inputs."""
    relaxing = DAMPING / np.sqrt(stiffness.max())
    n, u = e.n, np.array([x.start for x in e.inputs])

    def springs(q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        C = np.array(e.C(q, p))
        return C, stiffness * (np.array(e.Phi(q, p)).ravel() + relaxing * (C @ v))

    def rate(t: float, y: np.ndarray) -> np.ndarray:
        q, v = y[:n], y[n:]
        C, force = springs(q, v)
        M = np.array(e.M(q, p))
        M += INERTIA * np.diag(M.diagonal() == 0)
        right = np.array(e.f(q, v, u, p, t)).ravel() - np.array(e.d(q, v, p)).ravel() - C.T @ force
        return np.concatenate([v, np.linalg.solve(M, right)])

    solution = solve_ivp(rate, (0.0, end), np.concatenate([q, v]), "Radau", rtol=1e-8, atol=1e-11)
    assert solution.success, solution.message
    return springs(*np.split(solution.y[:, -1], 2))[1]
