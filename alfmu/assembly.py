"""The start of a run: loops closed from a guess, velocities made consistent, massless bodies checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .equations import Equations
from .errors import AssemblyError

__all__ = ["Mobility", "assemble", "assemble_rates", "check_masses", "mobility"]

_TOLERANCE = 1e-12
_MOST = 100


def assemble(equations: Equations, p: NDArray, s: NDArray) -> NDArray:
    """Coordinates (n,) that close every loop and keep the start values s, nearest to the guess.

    Gauss-Newton steps of least norm with backtracking. Raises AssemblyError, with the loop and its gap, where the loops
    cannot be closed, where the start values contradict each other, and where the guess leads to a far assembly.
    """
    e = equations
    guess = _array(e.guess(p, s))
    if not np.isfinite(guess).all():
        raise AssemblyError(f"{e.name}: the start guess is not finite; check the dimensions and start values")

    def misfit(q: NDArray) -> NDArray:
        return np.concatenate([_array(e.Phi(q, p)), _array(e.ties(q, p, s))])

    q, r = guess, misfit(guess)
    first_gap, first_step = r, 0.0
    for i in range(_MOST):
        if np.abs(r).max(initial=0.0) <= _TOLERANCE * max(1.0, np.abs(q).max()):
            break
        J = np.vstack([np.array(e.C(q, p)), np.array(e.ties_matrix(q, p, s))])
        dq = np.linalg.lstsq(J, -r, rcond=1e-10)[0]
        if i == 0:
            first_step = float(np.linalg.norm(dq))
        part = 1.0
        while part > 1e-4 and not np.linalg.norm(misfit(q + part * dq)) < (1 - part / 10) * np.linalg.norm(r):
            part /= 2
        if part <= 1e-4:
            break
        q = q + part * dq
        r = misfit(q)
    if np.abs(r).max(initial=0.0) > 1e-9 * max(1.0, np.abs(q).max()):
        _refuse(e, r)
    moved = float(np.linalg.norm(q - guess))
    if moved > 3 * first_step + 1e-6:
        worst = int(np.argmax(np.abs(q - guess)))
        raise AssemblyError(
            f"{e.name}: the guess leaves {_name(e, first_gap)} and leads to an assembly elsewhere "
            f"({e.coordinates[worst].name} moves by {abs(q - guess)[worst]:.3g} {e.coordinates[worst].unit}); "
            "give start values or guesses closer to the assembly you want"
        )
    return q


def assemble_rates(equations: Equations, q: NDArray, p: NDArray, s: NDArray, sdot: NDArray) -> NDArray:
    """Velocities (n,) that keep the loops closed and have the start rates sdot, nearest to the rate of the guess.

    At a singular position, where several motions are possible, the guess decides which one begins.
    """
    e = equations
    v = _array(e.guess_rate(p, s, sdot))
    J = np.vstack([np.array(e.C(q, p)), np.array(e.ties_matrix(q, p, s))])
    wanted = np.concatenate([np.zeros(e.l), sdot[e.tied]])
    for _ in range(2):
        v = v + np.linalg.lstsq(J, wanted - J @ v, rcond=1e-10)[0]
    left = J @ v - wanted
    if np.abs(left).max(initial=0.0) > 1e-9 * max(1.0, np.abs(v).max()):
        worst = int(np.argmax(np.abs(left)))
        what = e.rows[worst].name if worst < e.l else e.start_rates[e.tied[worst - e.l]].name
        raise AssemblyError(
            f"{e.name}: no motion has the given start rates; {what} is missed by {abs(left[worst]):.3g} per second; "
            "give the rates of fewer coordinates, or rates that belong together"
        )
    return v


def check_masses(equations: Equations, q: NDArray, p: NDArray) -> None:
    """AssemblyError where a motion has neither mass nor constraint, so that H cannot complete M."""
    e = equations
    M, C = np.array(e.M(q, p)), np.array(e.C(q, p))
    held = np.vstack([M / max(np.abs(M).max(initial=0.0), 1e-300), C]) if e.l else M
    _, sizes, motions = np.linalg.svd(held, full_matrices=True)
    smallest = sizes[-1] if len(sizes) == e.n else 0.0
    if smallest > 1e-13:
        return
    free = [e.coordinates[i].name for i in np.flatnonzero(np.abs(motions[-1]) > 0.1)]
    raise AssemblyError(
        f"{e.name}: the motion along {', '.join(free)} has no mass and no constraint that holds it (singular value "
        f"{smallest:.0e} of [M; C] at the start); a massless body must be held by constraints at both ends: never the "
        "last body of an open chain, never one placed by a joint coordinate alone"
    )


@dataclass(frozen=True)
class Mobility:
    """How a mechanism can move: in general, and at one position."""

    freedom: int
    """Degrees of freedom at a regular position."""
    redundant: int
    """Constraints that follow from the others on the whole of the motion."""
    freedom_here: int
    """Independent velocities at the given position; more than `freedom` where it is singular."""


def mobility(equations: Equations, p: NDArray, q: NDArray) -> Mobility:
    """Degrees of freedom and redundant constraints, from the rank of C at q (n,) and at assembled positions near it."""
    e = equations
    random = np.random.default_rng(0)
    ranks = [_rank(np.array(e.C(q, p)))]
    for _ in range(8):
        near = q + 0.3 * random.standard_normal(e.n) * max(1.0, np.abs(q).max()) / np.sqrt(e.n)
        for _ in range(30):
            near = near - np.linalg.lstsq(np.array(e.C(near, p)), _array(e.Phi(near, p)), rcond=1e-8)[0]
        if np.abs(_array(e.Phi(near, p))).max(initial=0.0) < 1e-9:
            ranks.append(_rank(np.array(e.C(near, p))))
    return Mobility(e.n - max(ranks), e.l - max(ranks), e.n - ranks[0])


def _rank(C: NDArray) -> int:
    return int(np.linalg.matrix_rank(C, tol=1e-7 * max(1.0, np.abs(C).max()))) if C.size else 0


def _refuse(e: Equations, r: NDArray) -> None:
    closed = e.l == 0 or np.abs(r[: e.l]).max() <= 1e-9
    reason = "the start values contradict each other" if closed else "the loops cannot be closed"
    advice = "give fewer or consistent start values" if len(e.tied) > 1 else "check lengths, offsets and start values"
    raise AssemblyError(f"{e.name}: {reason}; the nearest assembly leaves {_name(e, r)}; {advice}")


def _name(e: Equations, r: NDArray) -> str:
    worst = int(np.argmax(np.abs(r)))
    if worst < e.l:
        row = e.rows[worst]
        gap = np.linalg.norm([x for x, other in zip(r, e.rows, strict=False) if other.name == row.name])
        return f"a gap of {gap:.3g} {row.unit} at {row.name}"
    start = e.starts[e.tied[worst - e.l]]
    return f"{start.name} missed by {abs(r[worst]):.3g} {start.unit}"


def _array(x) -> NDArray:
    return np.array(x, float).reshape(-1)
