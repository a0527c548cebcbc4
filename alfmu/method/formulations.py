"""Blajer's augmented-Lagrangian method, and the alternatives it is compared with, in the letters of the paper.

W. Blajer, "Augmented Lagrangian Formulation: Geometrical Interpretation and Application to Systems with Singularities
and Redundancy", Multibody System Dynamics 8 (2002) 141-159. Equation numbers stand at the lines. The functions use `@`,
`.T`, `+` and the given `solve` only, so that the same lines run on NumPy arrays (the oracle) and can be traced with
symbols (the kernel). M (n, n) mass matrix, F = f - d (n,) applied forces less velocity terms, C (l, n) constraint
matrix of any rank, xi (l,) constraint-induced accelerations, alpha (l, l) diagonal artificial masses, a (n,)
accelerations, lam (l,) multipliers, with M a + d = f - C' lam. `solve` applies the inverse of H, the augmented mass.
"""

from collections.abc import Callable
from typing import Any

CORRECTIONS = 20
"""Most projections (10) after a step, of q and of v each; two are enough away from singular positions."""

LIGHT = 1e-8
"""Largest mass over the largest penalty [1] in the search for multipliers of least norm: masses are scaled down to it,
so that a pass gains as much with any given penalty."""

GAIN = 2 / 3
"""Ratio of successive changes [1] above which further passes change only round-off."""

SETTLING = 1000
"""Most passes of `minimum_norm` after (8) [1]: the largest number of iterations that a user may set for (8)."""

SETTLED = 1e-10
"""Relative change of the multipliers [1] at which `minimum_norm` ends if it converges slowly. A direction that (8) has
not resolved by then contains round-off alone; a resolved one converges as fast as in (8)."""

HELD_SHARES = 1e9
"""Weight of C' lam over the weight of the loads of joints that share a load [1]. At a regular position a pass gains
this factor; near a singular one it gains the factor times the squared distance."""

EASE = 1e-6
"""Regularisation of the factors in a pass with HELD_SHARES, over the loads of joints [1]. Multipliers that no joint
transmits keep a pivot above the round-off of HELD_SHARES."""

Array = Any
Solve = Callable[[Array], Array]
Done = Callable[[Array, Array], bool]


def augmented_mass(M: Array, C: Array, alpha: Array) -> Array:
    """H (n, n): M completed by artificial masses; positive definite where M or C holds every motion."""
    return M + C.T @ alpha @ C  # (8)


def classic(
    M: Array, F: Array, C: Array, xi: Array, alpha: Array, solve: Solve, a: Array, lam: Array, most: int, done: Done
) -> tuple[Array, Array, int, bool]:
    """Iterate (8) as printed; return a, lam, the iterations used, and whether `done(da, a)` held within `most`."""
    h = F + C.T @ (alpha @ xi)  # (8)
    for i in range(1, most + 1):
        before, a = a, solve(h - C.T @ lam)  # (8)
        lam = lam + alpha @ (C @ a - xi)  # (8)
        if done(a - before, a):
            return a, lam, i, True
    return a, lam, most, False


def residual(
    M: Array, F: Array, C: Array, xi: Array, alpha: Array, solve: Solve, a: Array, lam: Array, most: int, done: Done
) -> tuple[Array, Array, int, bool]:
    """Iterate (8) in residual form: the same fixed point and result as `classic`, without its cancellation."""
    for i in range(1, most + 1):
        r1 = F - M @ a  # residual of (4), with -C' lam below
        r2 = xi - C @ a  # residual of (3)
        da = solve(r1 + C.T @ (alpha @ r2 - lam))  # (8) for the increment
        a = a + da
        lam = lam - alpha @ (r2 - C @ da)  # (8) for the increment
        if done(da, a):
            return a, lam, i, True
    return a, lam, most, False


def minimum_norm(C: Array, alpha: Array, solve: Solve, lam: Array, most: int, done: Done) -> Array:
    """Return the multipliers of least norm, weighted by 1 / alpha, among all with the same C' lam.

    lam = alpha C z with C' alpha C z = C' lam by iterated (10); each pass gains a factor of mass / alpha.
    """
    z = solve(C.T @ lam)
    for _ in range(most):
        dz = nearer_norm(C, alpha, solve, lam, z)
        z = z + dz
        if done(C @ dz, C @ z):
            break
    return alpha @ (C @ z)


def nearer_norm(C: Array, alpha: Array, solve: Solve, lam: Array, z: Array) -> Array:
    """Return the change of z in one pass of `minimum_norm`."""
    return solve(C.T @ (lam - alpha @ (C @ z)))


def settled(change: Array, before: Array, size: Array, tolerance: Array) -> Array:
    """Return whether `minimum_norm` has converged, from squared norms of the last two changes and of lam."""
    return (change <= tolerance**2 * size) + (change <= SETTLED**2 * size) * (change > GAIN**2 * before) > 0


def minimum_norm_of_joints(
    C: Array, alpha: Array, lengths: Array, inverse: Callable[[Array], Solve], lam: Array, most: int, done: Done
) -> Array:
    """Apply `minimum_norm` to the rows of joints alone; `lengths` (l, l) selects the other rows.

    Those others, E, keep Euler parameters at unit length, so that E E' = 1 on the motion. Rows of joints less their
    part along E, C - share E, are orthogonal to E, so the norms can be minimised separately. `inverse` returns a
    solver with M + C' alpha C for such a C.
    """
    E = lengths @ C
    share = C @ E.T - lengths
    C = C - share @ E
    lam = minimum_norm(C, alpha, inverse(C), lam + share.T @ lam, most, done)
    return lam - share.T @ lam


def shared_again(
    P: Array, g: Array, C: Array, alpha: Array, solve: Solve, d: Array, mu: Array, most: int, done: Done
) -> tuple[Array, Array]:
    """Return the change d of lam that minimises the loads of joints, d' P d / 2 + g' d, subject to C' d = 0, and its
    multipliers mu; both continue from given values.

    This is (8) with P (l, l) for the masses, -g for the forces and C' for the constraints, whose penalties are alpha
    (n, n). `solve` applies the inverse of P + C alpha C', with P regularised in directions that it leaves free.
    """
    return residual(P, -g, C.T, 0 * mu, alpha, solve, d, mu, most, done)[:2]


def stabilised(xi: Array, Cv: Array, Phi: Array, zeta: Array, omega: Array) -> Array:
    """Return the right-hand side of (3) with Baumgarte's damping zeta and frequency omega [1/s], as (6) uses it too."""
    return xi - 2 * zeta * omega * Cv - omega**2 * Phi  # (6)


def penalty(F: Array, C: Array, xi: Array, alpha: Array, solve: Solve) -> tuple[Array, Array]:
    """Solve (6), the full penalty method, with `xi` already stabilised; return a and the multipliers it implies."""
    a = solve(F + C.T @ (alpha @ xi))  # (6)
    return a, alpha @ (C @ a - xi)


def stiffness(F: Array, C: Array, Phi: Array, k: Array, solve: Solve) -> tuple[Array, Array]:
    """Solve (5), a penalty of stiffness k (l, l) alone [N/m by row]; `solve` applies the inverse of M itself."""
    lam = k @ Phi
    return solve(F - C.T @ lam), lam  # (5)


def dae(M: Array, F: Array, C: Array, xi: Array, solve: Callable[[list, list], tuple]) -> tuple[Array, Array]:
    """Solve (9), the index-1 DAE form; `solve` takes its blocks, and must accept a singular matrix."""
    return solve([[M, C.T], [C, 0]], [F, xi])  # (9)


def project(C: Array, alpha: Array, solve: Solve, residue: Array) -> Array:
    """Return one correction (10): of q when the residue is Phi, of v when it is C v."""
    return -solve(C.T @ (alpha @ residue))  # (10)


def project_residual(
    M: Array, C: Array, alpha: Array, solve: Solve, residue: Array, left: Callable[[Array], Array]
) -> Array:
    """Return a correction (10) in residual form; `left(d)` is the residue that remains after a correction d.

    As printed, (10) displaces q along the motion by round-off: eps alpha / mass of the correction itself. One step of
    iterative refinement with the same factors removes this.
    """
    d = project(C, alpha, solve, residue)
    return d - solve(M @ d + C.T @ (alpha @ left(d)))  # (10) for the residual of d
