"""Small motions about a state: the equations of motion in independent coordinates, to first order.

With S (n, f) the motions q' = S z' that the constraints allow, C S = 0, and z independent coordinates, small changes
are

    dq = S dz,  dv = S dz' + T dz,  C T = -d(C v)/dq S
    da = S dz'' + what the constraints ask for, C da = dX,  X = xi - C a
    S' M S dz'' = S' (dR - M (da - S dz'')),  R = f - d - M a - C' lam

so that constraints of any rank and massless bodies are no obstacle, and the multipliers drop out. Their changes, which
outputs may show, are those of least norm: W lam = C y with weights W of the rows, as the runtime reads them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..model.errors import InputError
from .loops import Loops
from .situation import Situation, Vector

__all__ = ["ZERO", "Small", "independent", "ordered", "small_motions"]

Matrix = NDArray[np.float64]

WELL = 20.0
"""condition [1]: independent coordinates of a start are taken for a linearisation where they tell its motions better
than this; others are chosen otherwise."""

EARLIER = 0.3
"""part [1] by which the coordinate declared last counts less than the first, where both tell a motion."""

ZERO = 1e-7
"""real part over the largest eigenvalue [1]: a smaller one cannot be told from none, as a double root moves by the
square root of round-off."""

CONSISTENT = 1e-6
"""part of a change of the constraints that no motion follows, over the change [1]: above it the position is too near a
singular one."""

SYMMETRIC = 1e-9
"""part of a stiffness that is not symmetric, over the stiffness [1]: with less loads have a potential."""


@dataclass(frozen=True)
class Small:
    """Small motions about a state, in independent coordinates z (f,) and further states x:
    z'' = P z + Q z' + X x + U u, x' = G (z, z', x) + Gu u."""

    independent: list[int]
    """Coordinates z."""
    S: Matrix
    T: Matrix
    mass: Matrix
    """S' M S (f, f)."""
    P: Matrix
    Q: Matrix
    X: Matrix
    U: Matrix
    G: Matrix
    Gu: Matrix
    rates: Vector
    """Of the further states [their unit per s]."""
    a: Vector
    lam: Vector
    """Accelerations (n,) and multipliers (l,) of least norm at the state."""
    readings: Vector
    """Outputs at the state."""
    by_state: Matrix
    """Their derivatives by (z, z', x)."""
    by_input: Matrix
    load: float
    """The largest acceleration of z [per s2]: none at rest."""

    @property
    def A(self) -> Matrix:
        f, more = len(self.P), self.X.shape[1]
        top = [np.zeros((f, f)), np.eye(f), np.zeros((f, more))]
        return np.vstack([np.hstack(top), np.hstack([self.P, self.Q, self.X]), self.G])

    @property
    def B(self) -> Matrix:
        return np.vstack([np.zeros_like(self.U), self.U, self.Gu])

    @property
    def eigenvalues(self) -> NDArray[np.complex128]:
        """Of A [1/s], the slowest first, the upper one of a pair first."""
        return ordered(np.linalg.eigvals(self.A))[0]

    def stability(self, isolated: bool) -> tuple[str, str]:
        """What the small motions tell of a position of rest, and by what: Lagrange's and Lyapunov's theorems."""
        values, K, D = self.eigenvalues, -self.mass @ self.P, -self.mass @ self.Q
        if not len(values):
            return "stable", "it has no motion"
        margin = ZERO * np.abs(values).max()
        if values.real.max() > margin:
            return "unstable", f"a small motion grows by {values.real.max():.4g} 1/s"
        if not isolated:
            return "not judged", "a motion has no stiffness, so that terms of higher order decide"
        if values.real.max() < -margin:
            return "asymptotically stable", "all small motions decay"
        if self.X.size:
            return "not judged", "small motions neither grow nor decay, and states beside the motion drive it"
        symmetric = np.abs(K - K.T).max() <= SYMMETRIC * np.abs(K).max()
        least = np.linalg.eigvalsh(K + K.T).min()
        damped = np.linalg.eigvalsh(D + D.T).min() >= -ZERO * max(np.abs(D).max(), 1e-300)
        if symmetric and least > 0 and damped:
            return "stable", "the potential energy is least there"
        return "not judged", "small motions neither grow nor decay, and the loads have no potential"


def ordered(values: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.intp]]:
    """Eigenvalues, the slowest first and the upper one of a pair first, and their places."""
    size = np.abs(values)
    clean = np.where(np.abs(values.imag) <= 1e-12 * size, values.real + 0j, values).astype(complex)
    order = np.lexsort((-clean.imag, clean.real, np.round(np.log(np.maximum(size, 1e-12)), 9)))
    return clean[order], order


def small_motions(where: Situation, freedom: int, wanted: Sequence[int] = ()) -> Small:
    """The small motions about the state of a situation, at a regular position of so many degrees of freedom.

    Raises InputError where it is too near a singular one, or a motion has no mass.
    """
    e, s, held = where.equations, where.state, where.held
    loops = Loops(where)
    n, rank = e.n, e.n - freedom
    units = where.units[held]
    M, C = where.value("M", s), where.value("C", s)[held] / units[:, None]
    F, xi = where.value("f", s) - where.value("d", s), where.value("xi", s)[held] / units
    U, sizes, V = np.linalg.svd(C * loops.scale)
    left = U[:, rank:]
    inverse = loops.scale[:, None] * (V[:rank].T / sizes[:rank]) @ U[:, :rank].T  # of C, of least norm
    N = V[rank:].T
    z = independent(where, N, wanted)
    S = (loops.scale[:, None] * N) @ np.linalg.inv(N[z]) / loops.scale[z]

    def followed(right: Matrix) -> Matrix:
        """What the constraints ask for, with z as they are."""
        found = inverse @ right
        return found - S @ found[z]

    mass = S.T @ M @ S
    if freedom and not np.linalg.cond(mass * np.outer(loops.scale[z], loops.scale[z])) < 1e13:
        raise InputError(
            f"{where.name}: a motion of {', '.join(e.coordinates[i].name for i in z)} has no mass here; give a mass to "
            "what moves"
        )
    asked = followed(xi)
    acceleration = np.linalg.solve(mass, S.T @ (F - M @ asked)) if freedom else np.zeros(0)
    a = asked + S @ acceleration
    # Multipliers of least norm: W lam = C y.
    lengths = np.isin(np.flatnonzero(held), e.lengths)
    weights = np.where(lengths, 0.0, 1 / (where.shares[held] * units**2))
    weights /= weights.max(initial=0.0) or 1.0

    def shared(lam: Matrix, more: Matrix | float = 0.0) -> Matrix:
        """Multipliers that act like lam, with U' (W lam) = U' more for the rows U that are redundant."""
        if not left.size:
            return lam
        wanted = left.T @ (more - weights.reshape(-1, *[1] * (lam.ndim - 1)) * lam)
        return lam + left @ np.linalg.solve(left.T @ (weights[:, None] * left), wanted)

    lam = shared(inverse.T @ (F - M @ a))
    full = np.zeros(e.l)
    full[held] = lam / units
    Rq, Rv, Xq, Xv = where.change("tangents", s, a=a, lam=full)
    Ru, Xu = where.change("inputs", s, a=a, lam=full)
    (turned,) = where.change("turned", s, w=s.v)
    Xq, Xv, Xu, turned = (x[held] / units[:, None] for x in (Xq, Xv, Xu, turned))
    T = followed(-turned @ S)
    _check(where, C @ T + turned @ S, turned @ S)
    still = np.zeros((n, len(s.u)))
    ways = [(S, T), (np.zeros_like(S), S), (still, still)]
    (turned_y,) = where.change("turned", s, w=inverse @ (weights * lam))
    turned_y = turned_y[held] / units[:, None]
    Yq, Yv, Ya, Ylam, Yu = where.change("readings", s, a=a, lam=full)
    made = []
    for k, (dq, dv) in enumerate(ways):
        right = Xq @ dq + Xv @ dv + (Xu if k == 2 else 0.0)
        da = followed(right)
        _check(where, C @ da - right, right)
        R = Rq @ dq + Rv @ dv + (Ru if k == 2 else 0.0)
        change = np.linalg.solve(mass, S.T @ (R - M @ da)) if freedom else np.zeros((0, R.shape[1]))
        da = da + S @ change
        dlam = shared(inverse.T @ (R - M @ da), turned_y @ dq) / units[:, None]
        dy = Yq @ dq + Yv @ dv + Ya @ da + Ylam[:, held] @ dlam + (Yu if k == 2 else 0.0)
        made.append((change, dy))
    (P, by_z), (Q, by_rate), (B, by_u) = made
    y = where.value("readings", s, a=a, lam=full)
    inputs = len(e.inputs)
    X, U, by_x, by_u = B[:, inputs:], B[:, :inputs], by_u[:, inputs:], by_u[:, :inputs]
    Gq, Gv, Gu = where.change("rates", s)
    G = np.hstack([Gq @ S + Gv @ T, Gv @ S, Gu[:, inputs:]])
    rates = where.value("state_rates", s)
    by_state = np.hstack([by_z, by_rate, by_x])
    load = float(np.abs(acceleration).max(initial=0.0))
    return Small(z, S, T, mass, P, Q, X, U, G, Gu[:, :inputs], rates, a, full, y, by_state, by_u, load)


def _check(where: Situation, missed: Matrix, wanted: Matrix) -> None:
    """InputError where constraints ask for what no motion follows."""
    if np.abs(missed).max(initial=0.0) > CONSISTENT * max(1.0, np.abs(wanted).max(initial=0.0)):
        raise InputError(
            f"{where.name}, t = {where.state.t:.6g} s: the position is too near a singular one to be linearised, as "
            f"constraints would open by {np.abs(missed).max():.1e} for a unit of motion; take a state farther from it"
        )


def independent(where: Situation, N: Matrix, wanted: Sequence[int] = ()) -> list[int]:
    """The coordinates that tell the motions N (n, f) best; those that are wanted, or that a start gives, if they do."""
    from scipy.linalg import qr

    f = N.shape[1]
    if not f:
        return []
    for told in (list(wanted), list(where.equations.telling)):
        if len(told) == f and f and np.linalg.cond(N[told]) < WELL and np.linalg.norm(N[told], 2) > 1 / WELL:
            return sorted(told)
    # Of coordinates that tell them as well, the one declared first.
    weights = 1 - EARLIER * np.arange(len(N)) / len(N)
    return sorted(int(i) for i in qr((weights[:, None] * N).T, mode="r", pivoting=True)[1][:f])
