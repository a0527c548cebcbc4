"""Branches of the motion at singular positions, and where these are.

At a position q more motions N with C N = 0 may begin than at regular ones. Those belong to a branch whose way can be
continued: to second order U' (dC/dq w) w = 0 for w = N x and all U with U' C = 0, which are quadratic equations in x;
each solution is followed beside the position, where it has to close the loops.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .loops import CLOSED, Loops
from .situation import Vector

__all__ = ["STRAIGHT", "Way", "polished", "ways"]

TOUCHED = 1e-7
"""size of a quadratic equation over the largest [1]: a smaller one is none."""

BESIDE = 0.02
"""way from a singular position [rad, sizes]: a branch has to close the loops there, and is regular there."""

STRAIGHT = 0.2
"""part of that way that leads elsewhere than the branch begins [1]: a place with more is not on it."""

DENSITY = 3
"""logarithm of a number of directions [1]: branches are looked for from so many times 2^motions, as there may be
2^(motions - 1); a row of three four-bars has all of its own from half as many."""

PASSES = 60
"""number of steps of Newton's method [1]: each halves what is left where a solution is double."""

ROOT = 1e-9
"""what is left of the quadratic equations of a branch [1]: a direction with less is a solution."""

ALIKE = 1e-3
"""difference of directions [1]: those that differ by less are one branch."""


@dataclass(frozen=True)
class Way:
    """A branch that begins at a singular place."""

    way: Vector
    """Its direction (n,)."""
    ends: bool
    """Whether it leads away in one direction alone."""
    singular: bool
    """Whether the places on it are singular, too."""


def ways(loops: Loops, y: Vector, motions: int) -> list[Way]:
    """Return the branches that begin at a singular place with so many independent velocities."""
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
    """Return unit vectors x (count,) with x' Q x = 0 for all forms Q, each once, by Newton's method from many
    directions."""
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
    """Return independent velocities a little way along a direction; 0 if the loops do not close there."""
    there = y + BESIDE * way
    for _ in range(12):
        gaps = np.append(loops.gaps(there), way @ (there - y) - BESIDE)
        if np.abs(gaps).max() < CLOSED:
            break
        there = there - np.linalg.lstsq(np.vstack([loops.matrix(there), way]), gaps, rcond=1e-9)[0]
        if not np.isfinite(there).all() or np.abs(there - y).max() > 5 * BESIDE:
            return 0
    aside = there - y - BESIDE * way
    closed = np.abs(loops.gaps(there)).max(initial=0.0) < 10 * CLOSED
    if not closed or np.linalg.norm(aside) > STRAIGHT * BESIDE:
        return 0
    return loops.situation.mobility(there * loops.scale)[0].freedom_here


def polished(loops: Loops, y: Vector) -> Vector | None:
    """Return the singular place nearest by: Newton's method for Phi = 0, C' mu = 0, mu' mu = 1; None if there is none.

    Where laws of time leave no freedom, the time at which they pass it is found too.
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
        d = np.linalg.lstsq(J, left, rcond=1e-9)[0]
        if loops.freedom:
            d[loops.moving : n] = 0.0
        y, mu = y - d[:n], mu - d[n:]
        if not np.isfinite(y).all() or np.abs(y - begin).max() > 0.1:
            return None
    return y if np.abs(left).max() < 1e-10 else None
