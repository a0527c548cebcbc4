"""Small motions about a state: the equations of motion in independent coordinates, to first order.

With S (n, f) the motions q' = S z' that the constraints allow, C S = 0, and z independent coordinates, small changes
are

    dq = S dz,  dv = S dz' + T dz,  C T = -d(C v)/dq S
    da = S dz'' + a particular solution of C da = dX,  X = xi - C a
    S' M S dz'' = S' (dR - M (da - S dz'')),  R = f - d - M a - C' lam

so that constraints of any rank and massless bodies are allowed, and the multipliers drop out. Changes of multipliers,
on which outputs may depend, minimise the loads of joints, as in the runtime; the condition is g = C y.

If laws of time or signals s prescribe motion, C v + Phi_t and xi contain their rates, and time is frozen: dq = S dz + Q
ds with C Q = -Phi_s, and so on for rates and accelerations. Dry friction of sliding joints has its own multipliers, mu
= law(q, v, a, lam, mu), which depend on all others.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..equations.changes import LEVELS
from ..equations.evaluation import telling
from ..model.errors import InputError
from .laws import Driving, driving
from .loops import Loops
from .situation import Situation, Vector

Matrix = NDArray[np.float64]

WELL = 20.0
"""Condition number [1] up to which a linearisation uses the independent coordinates of the start."""

EARLIER = 0.3
"""Relative reduction of weight [1] of the last coordinate against the first, if both describe a motion."""

ZERO = 1e-7
"""Real part over the largest eigenvalue [1] below which it counts as zero: round-off moves a double root by its square
root."""

SETTLED = 1e-13
"""Relative change of the multipliers of dry friction [1] at which Newton's method has converged."""

PASSES = 50
"""Largest number of its iterations [1]: without convergence the joints jam."""

CONSISTENT = 1e-6
"""Relative residual of a change of the constraints [1], above which the position is too close to a singular one."""

SYMMETRIC = 1e-9
"""Relative asymmetry of a stiffness [1] below which loads count as conservative."""


@dataclass(frozen=True)
class Small:
    """Small motions about a state, in independent coordinates z (f,) and states x: z'' = P z + Q z' + X x + U u, x' = G
    (z, z', x) + Gu u."""

    independent: list[int]
    """Indices of the coordinates z."""
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
    """Rates of the states [their unit per s]."""
    a: Vector
    lam: Vector
    """Accelerations (n,), and multipliers (l,) of least norm, at the state."""
    readings: Vector
    """Outputs at the state."""
    by_state: Matrix
    """Derivatives of the outputs by (z, z', x)."""
    by_input: Matrix
    load: float
    """Largest acceleration of z [per s2]; zero in equilibrium."""
    driving: list[Driving]
    """Inputs u: those of the mechanism, followed by derivatives of signals."""

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
        """Eigenvalues of A [1/s], the slowest first; of a pair, the one with positive imaginary part first."""
        return ordered(np.linalg.eigvals(self.A).astype(complex))[0]

    def stability(self, isolated: bool) -> tuple[str, str]:
        """Return the stability of an equilibrium and its criterion, by Lagrange's and Lyapunov's theorems."""
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
            return "not judged", "small motions neither grow nor decay, and states of first order drive the motion"
        symmetric = np.abs(K - K.T).max() <= SYMMETRIC * np.abs(K).max()
        least = np.linalg.eigvalsh(K + K.T).min()
        damped = np.linalg.eigvalsh(D + D.T).min() >= -ZERO * max(np.abs(D).max(), 1e-300)
        if symmetric and least > 0 and damped:
            return "stable", "the potential energy has a minimum there"
        return "not judged", "small motions neither grow nor decay, and the loads have no potential"


def ordered(values: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.intp]]:
    """Return eigenvalues in the order of `Small.eigenvalues`, and their permutation."""
    size = np.abs(values)
    clean = np.where(np.abs(values.imag) <= 1e-12 * size, values.real + 0j, values).astype(complex)
    order = np.lexsort((-clean.imag, clean.real, np.round(np.log(np.maximum(size, 1e-12)), 9)))
    return clean[order], order


def small_motions(where: Situation, freedom: int, wanted: Sequence[int] = ()) -> Small:
    """Return the small motions about the state of a situation, at a regular position with `freedom` degrees of freedom.

    Raises InputError if it is too close to a singular position, a motion has no mass, or loads are not finite.
    """
    e, s, held = where.equations, where.state, where.held
    loops = Loops(where)
    n, rank = e.n, e.dependent - freedom
    units = where.units[held]
    M, C = where.value("M", s), where.value("C", s)[held] / units[:, None]
    F, xi = where.value("f", s) - where.value("d", s), where.value("xi", s)[held] / units
    U, sizes, V = loops.parts(C * loops.scale)
    left = U[:, rank:]
    inverse = loops.scale[:, None] * (V[:rank].T / sizes[:rank]) @ U[:, :rank].T  # pseudoinverse of C
    N = V[rank:].T
    z = independent(where, N, wanted)
    S = (loops.scale[:, None] * N) @ np.linalg.inv(N[z]) / loops.scale[z]

    def followed(right: Matrix) -> Matrix:
        """Return the change that the constraints require at fixed z."""
        found = inverse @ right
        return found - S @ found[z]

    mass = S.T @ M @ S
    if freedom and not np.linalg.cond(mass * np.outer(loops.scale[z], loops.scale[z])) < 1e13:
        raise InputError(
            f"{where.name}: a motion of {', '.join(e.coordinates[i].name for i in z)} has no mass here; give the "
            "moving bodies a mass"
        )
    # The condition g = C y for least loads of joints, weighted by compliances, is linear in lam, a and the state.
    nothing = np.zeros(e.l)
    if not left.size or e.compliances:
        lengths = np.isin(np.arange(e.l), e.lengths)
        weights = np.divide(1.0, where.shares, out=np.zeros(e.l), where=held & ~lengths)
        by = [np.zeros((e.l, size)) for size in (n, n, n)] + [np.diag(weights), np.zeros((e.l, len(s.u)))]
        begun = np.zeros(e.l)
    else:
        by = where.change("shares", s, a=np.zeros(n), lam=nothing)
        begun = where.value("shares", s, a=np.zeros(n), lam=nothing)
    g_a, g_lam = by[2][held] / units[:, None], by[3][held] / units[:, None]
    W = g_lam[:, held] / units

    def shared(lam: Matrix, more: Matrix) -> Matrix:
        """Return multipliers with the effect of lam and U' (W lam) = U' more, for the dependencies U of redundant
        rows."""
        if not left.size:
            return lam
        return lam + left @ np.linalg.lstsq(left.T @ W @ left, left.T @ (more - W @ lam), rcond=None)[0]

    def answered(force: Matrix, right: Matrix, more: Matrix) -> tuple[Matrix, Matrix, Matrix]:
        """Return accelerations of z and of q, and multipliers (l, ...), due to forces (n, ...) and C a = right; `more`
        is the part of g due to other changes."""
        asked = followed(right)
        moved = np.linalg.solve(mass, S.T @ (force - M @ asked)) if freedom else np.zeros((0, *force.shape[1:]))
        a = asked + S @ moved
        lam = np.zeros((e.l, *force.shape[1:]))
        lam[held] = (shared(inverse.T @ (force - M @ a), more - g_a @ a).T / units).T
        return moved, a, lam

    slides = [x.row for x in e.frictions if where.rubs and not held[x.row]]
    pushed = -where.value("C", s)[slides].T
    by_mu = answered(pushed, np.zeros((len(units), len(slides))), -g_lam[:, slides])
    by_mu[2][slides] += np.eye(len(slides))
    acceleration, a, full = answered(F, xi, -begun[held] / units)
    if slides:
        mu = _rubbed(where, (a, full), by_mu)
        acceleration, a, full = (x + y @ mu for x, y in zip((acceleration, a, full), by_mu, strict=True))
    Rq, Rv, Xq, Xv = where.change("tangents", s, a=a, lam=full)
    if not all(np.isfinite(x).all() for x in (F, Rq, Rv)):
        raise InputError(
            f"{where.name}, t = {s.t:.6g} s: loads or their derivatives are not finite, as that of a spring between "
            "points that coincide; start beside it"
        )
    Ru, Xu = where.change("inputs", s, a=a, lam=full)
    (turned,) = where.change("turning", s)
    Xq, Xv, Xu, turned = (x[held] / units[:, None] for x in (Xq, Xv, Xu, turned))
    T = followed(-turned @ S)
    _check(where, C @ T + turned @ S, turned @ S)
    g = g_a @ a + g_lam @ full + begun[held] / units
    (turned_y,) = where.change("turned", s, w=inverse @ g)
    if left.size and not e.compliances:
        by = where.change("shares", s, a=a, lam=full)
    g_q, g_v, g_u = (x[held] / units[:, None] for x in (by[0], by[1], by[4]))
    g_q = g_q - turned_y[held] / units[:, None]
    Yq, Yv, Ya, Ylam, Yu = where.change("readings", s, a=a, lam=full)
    Lq, Lv, La, Llam, Lu, Ls = _laws(where, a, full, slides)
    Gq, Gv, Gu = where.change("rates", s)

    def changed(
        dq: Matrix, dv: Matrix, R: Matrix, X: Matrix, y: Matrix, law: Matrix, g: Matrix
    ) -> tuple[Matrix, Matrix]:
        """Return changes of the acceleration of z and of the outputs due to dq, dv, and to explicit changes of R, X,
        outputs, friction laws and g."""
        right = Xq @ dq + Xv @ dv + X
        found = answered(Rq @ dq + Rv @ dv + R, right, -(g_q @ dq + g_v @ dv + g))
        _check(where, C @ found[1] - right, right, np.abs(C) @ np.abs(S @ found[0]))
        if slides:
            asked = Lq @ dq + Lv @ dv + law + La @ found[1] + Llam @ found[2]
            mu = np.linalg.solve(np.eye(len(slides)) - La @ by_mu[1] - Llam @ by_mu[2], asked)
            found = found[0] + by_mu[0] @ mu, found[1] + by_mu[1] @ mu, found[2] + by_mu[2] @ mu
        change, da, dlam = found
        return change, Yq @ dq + Yv @ dv + Ya @ da + Ylam @ dlam + y

    def none(rows: int) -> Matrix:
        return np.zeros((rows, 1))

    alone = none(n), none(len(units)), none(len(e.outputs)), none(len(slides)), none(len(units))
    P, by_z = changed(S, T, *alone)
    Q, by_rate = changed(np.zeros_like(S), S, *alone)
    still = np.zeros((n, len(s.u)))
    B, by_u = changed(still, still, Ru, Xu, Yu, Lu, g_u)
    inputs, given = len(e.inputs), driving(where)
    X, U, by_x, by_u = B[:, inputs:], B[:, :inputs], by_u[:, inputs:], by_u[:, :inputs]
    G = np.hstack([Gq @ S + Gv @ T, Gv @ S, Gu[:, inputs:]])
    U, Gu, by_input = (
        np.hstack([each, np.zeros((len(each), len(given) - inputs))]) for each in (U, Gu[:, :inputs], by_u)
    )
    if e.followed:
        places, rates, Rs, Xs, Ys, Gs, shares = where.change("signals", s, a=a, lam=full)
        shares = shares[held] / units[:, None] if left.size and not e.compliances else np.zeros_like(Xs[held])
        places, rates, Xs = (x[held] / units[:, None] for x in (places, rates, Xs))
        dq = followed(-places)
        _check_driven(where, C @ dq + places, given)
        turn = rates + turned @ dq
        dv = followed(-turn)
        _check(where, C @ dv + turn, turn)
        by_signal = (*changed(dq, dv, Rs, Xs, Ys, Ls, shares), Gq @ dq + Gv @ dv + Gs)
        for column, each in enumerate(given):
            if each.signal >= 0:
                level = each.signal * LEVELS + each.level
                for matrix, found in zip((U, by_input, Gu), by_signal, strict=True):
                    matrix[:, column] += found[:, level] / (1, 1, 2)[each.level]
    y = where.value("readings", s, a=a, lam=full)
    rates = where.value("state_rates", s)
    by_state = np.hstack([by_z, by_rate, by_x])
    load = float(np.abs(acceleration).max(initial=0.0))
    return Small(z, S, T, mass, P, Q, X, U, G, Gu, rates, a, full, y, by_state, by_input, load, given)


def _laws(where: Situation, a: Vector, lam: Vector, slides: Sequence[int]) -> list[Matrix]:
    """Return derivatives of the multipliers of sliding joints by q, v, a, lam, u and signals."""
    e = where.equations
    if not slides:
        sizes = (e.n, e.n, e.n, e.l, len(where.state.u), LEVELS * len(e.followed))
        return [np.zeros((0, size)) for size in sizes]
    which = [k for k, x in enumerate(e.frictions) if x.row in slides]
    return [each[which] for each in where.change("rubbing", where.state, a=a, lam=lam)]


def _rubbed(where: Situation, smooth: tuple[Vector, Vector], by_mu: tuple[Matrix, Matrix, Matrix]) -> Vector:
    """Return multipliers of sliding joints, by Newton's method from zero; raise InputError if the joints jam."""
    (a, lam), (_, by_a, by_lam) = smooth, by_mu
    e, rows = where.equations, [x.row for x in where.equations.frictions if not where.held[x.row]]
    which, mu = [k for k, x in enumerate(e.frictions) if x.row in rows], np.zeros(len(rows))
    for _ in range(PASSES):
        here = {"a": a + by_a @ mu, "lam": lam + by_lam @ mu}
        _, _, La, Llam, _, _ = _laws(where, here["a"], here["lam"], rows)
        missed = where.value("rubbing", where.state, **here)[which] - mu
        step = np.linalg.solve(np.eye(len(rows)) - La @ by_a - Llam @ by_lam, missed)
        mu = mu + step
        if np.abs(step).max() <= SETTLED * np.abs(mu).max():
            return mu
    names = ", ".join(e.frictions[k].name for k in which)
    raise InputError(
        f"{where.name}, t = {where.state.t:.6g} s: no friction of {names} agrees with its load; the joints jam here, "
        "or are about to: take a state farther from that"
    )


def _check_driven(where: Situation, missed: Matrix, given: Sequence[Driving]) -> None:
    """Raise InputError if a signal cannot change independently."""
    for each in given:
        if each.signal >= 0 and not each.level:
            opened = np.abs(missed[:, each.signal * LEVELS]).max(initial=0.0)
            if opened > CONSISTENT:
                raise InputError(
                    f"{where.name}, t = {where.state.t:.6g} s: the input {each.name} cannot change by itself, as "
                    f"other motions or constraints hold the same motion (they would open by {opened:.1e} per unit of "
                    "the input); leave one of them out, or drive both by one input"
                )


def _check(where: Situation, missed: Matrix, *sizes: Matrix) -> None:
    """Raise InputError if the residual `missed` of a change of the constraints exceeds a share of the largest terms
    `sizes`: their round-off may be large, as forces move light bodies by any amount."""
    if np.abs(missed).max(initial=0.0) > CONSISTENT * max(1.0, *(np.abs(each).max(initial=0.0) for each in sizes)):
        raise InputError(
            f"{where.name}, t = {where.state.t:.6g} s: the position is too near a singular one to be linearised, as "
            f"constraints would open by {np.abs(missed).max():.1e} for a unit of motion; take a state farther from it"
        )


def independent(where: Situation, N: Matrix, wanted: Sequence[int] = ()) -> list[int]:
    """Return the coordinates that best describe the motions N (n, f): wanted ones or those of the start, if
    suitable."""
    from scipy.linalg import qr

    f = N.shape[1]
    if not f:
        return []
    for choice in (list(wanted), telling(where.equations)):
        if len(choice) == f and f and np.linalg.cond(N[choice]) < WELL and np.linalg.norm(N[choice], 2) > 1 / WELL:
            return sorted(choice)
    # Prefer the coordinate declared first if several describe the motions equally well.
    weights = 1 - EARLIER * np.arange(len(N)) / len(N)
    return sorted(int(i) for i in qr((weights[:, None] * N).T, mode="r", pivoting=True)[1][:f])
