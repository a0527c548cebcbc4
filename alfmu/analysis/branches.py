"""Singular positions and the branches of motion through them.

At a singular position q more motions N with C N = 0 begin than at regular ones. A direction w = N x belongs to a branch
if the motion can be continued: to second order U' (dC/dq w) w = 0 for all U with U' C = 0, a set of quadratic equations
in x. Each solution is followed away from q, where it must close the loops.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .loops import CLOSED, Loops
from .situation import Vector

TOUCHED = 1e-7
"""Relative size of a quadratic equation [1] below which it counts as zero."""

BESIDE = 0.02
"""Distance from a singular position [rad, sizes] at which a branch must close the loops and be regular."""

STRAIGHT = 0.2
"""Largest deviation of a branch from its initial direction over that distance [1]."""

DENSITY = 3
"""Branches are searched from 2^(motions + DENSITY) directions [1], as there may be 2^(motions - 1) branches; half as
many directions find all branches of a row of three four-bars."""

PASSES = 60
"""Largest number of steps of Newton's method [1]: each halves the error at a double solution."""

ROOT = 1e-9
"""Residual of the quadratic equations of a branch [1] below which a direction is a solution."""

ALIKE = 1e-3
"""Difference of directions [1] below which they count as one branch."""


@dataclass(frozen=True)
class Way:
    """A branch that begins at a singular position."""

    way: Vector
    """Direction (n,) of the branch."""
    ends: bool
    """Whether the branch continues in one direction only."""
    singular: bool
    """Whether positions on the branch are singular, too."""


def ways(loops: Loops, y: Vector, motions: int) -> list[Way]:
    """Return the branches at a singular position with this number of independent velocities."""
    U, _, V = np.linalg.svd(loops.matrix(y))
    rank = len(y) - motions
    left, N = U[:, rank:], V[rank:].T
    s = loops.state(y)
    turned = [loops.weighted(loops.situation.change("turned", s, w=loops.scale * w)[0]) @ N for w in N.T]
    forms = np.einsum("lj,klm->jkm", left, np.array(turned))
    size = np.abs(forms).max(initial=0.0)
    forms = forms[np.abs(forms).max(axis=(1, 2)) > TOUCHED * size] / (size or 1.0)
    found: list[Way] = []
    for way in (N @ x for x in _roots(forms, motions)):
        if any(min(np.abs(way - w.way).max(), np.abs(way + w.way).max()) < ALIKE for w in found):
            continue
        leads = [_leads_on(loops, y, sign * way) for sign in (1, -1)]
        if any(leads):
            found.append(Way(way if leads[0] else -way, not all(leads), max(leads) > loops.freedom))
    return found


def _roots(forms: NDArray[np.float64], count: int) -> list[Vector]:
    """Return distinct unit vectors x (count,) with x' Q x = 0 for all forms Q, by Newton's method from
    many directions."""
    from scipy.special import ndtri
    from scipy.stats import qmc

    numbers = qmc.Sobol(count, scramble=False).random_base2(count + DENSITY)[2:]
    x = ndtri(0.5 + (numbers - 0.5) * (1 - 1e-9))
    for _ in range(PASSES):
        x = x / np.linalg.norm(x, axis=1, keepdims=True)
        left = np.einsum("jkm,dk,dm->dj", forms, x, x)
        if np.abs(left).max(initial=0.0) < 1e-15:
            break
        slopes = np.concatenate([2 * np.einsum("jkm,dm->djk", forms, x), x[:, None, :]], axis=1)
        left = np.concatenate([left, np.zeros((len(x), 1))], axis=1)
        x = x - np.einsum("dkj,dj->dk", np.linalg.pinv(slopes, rcond=1e-10), left)
    x = x / np.linalg.norm(x, axis=1, keepdims=True)
    left = np.abs(np.einsum("jkm,dk,dm->dj", forms, x, x)).max(axis=1, initial=0.0)
    found: list[Vector] = []
    for each in x[left < ROOT]:
        way = each * np.sign(each[np.argmax(np.abs(each) > ALIKE)])
        if all(min(np.abs(way - other).max(), np.abs(way + other).max()) > ALIKE for other in found):
            found.append(way)
    return found


def _leads_on(loops: Loops, y: Vector, way: Vector) -> int:
    """Return the number of independent velocities a short distance along a direction; 0 if the loops do not close
    there."""
    there = y + BESIDE * way
    for _ in range(12):
        gaps = np.append(loops.gaps(there), way @ (there - y) - BESIDE)
        if max(loops.opened(there), abs(gaps[-1])) < CLOSED:
            break
        there = there - np.linalg.lstsq(np.vstack([loops.matrix(there), way]), gaps, rcond=1e-9)[0]
        if not np.isfinite(there).all() or np.abs(there - y).max() > 5 * BESIDE:
            return 0
    aside = there - y - BESIDE * way
    closed = loops.opened(there) < 10 * CLOSED
    if not closed or np.linalg.norm(aside) > STRAIGHT * BESIDE:
        return 0
    return loops.situation.mobility(there * loops.scale)[0].freedom_here


def polished(loops: Loops, y: Vector) -> Vector | None:
    """Return the nearest singular position, by Newton's method for Phi = 0, C' mu = 0, mu' mu = 1; None if there is
    none.

    If laws of time leave no freedom, the time of the singular position is determined, too.
    """
    begin, n = y, len(y)
    U, _, _ = np.linalg.svd(loops.matrix(y))
    mu = U[:, loops.rank - 1]
    where = loops.situation
    for _ in range(30):
        C, s = loops.matrix(y), loops.state(y)
        full = np.zeros(len(where.held))
        plain = where.change("tangents", s, a=np.zeros(n), lam=full)[0]
        full[where.held] = mu / where.units[where.held]
        bent = loops.scale[:, None] * (plain - where.change("tangents", s, a=np.zeros(n), lam=full)[0]) * loops.scale
        left = np.concatenate([loops.gaps(y), C.T @ mu, [(mu @ mu - 1) / 2]])
        if np.abs(left).max() < 1e-13:
            break
        along = loops.along_time(y) if where.equations.timed and not loops.freedom else C
        J = np.block([[along, np.zeros((len(C), len(mu)))], [bent, C.T], [np.zeros((1, n)), mu[None]]])
        if not np.isfinite(J).all():
            return None
        d = np.linalg.lstsq(J, left, rcond=1e-9)[0]
        if loops.freedom:
            d[loops.moving : n] = 0.0
        y, mu = y - d[:n], mu - d[n:]
        if not np.isfinite(y).all() or np.abs(y - begin).max() > 0.1:
            return None
    return y if np.abs(left).max() < 1e-10 else None
