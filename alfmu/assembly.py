"""The start of a run: loops closed from a guess, velocities made consistent, massless bodies checked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .equations import Equations
from .errors import AssemblyError

__all__ = ["Mobility", "assemble", "assemble_rates", "check_masses", "mobility"]

_TOLERANCE = 1e-12
_ROUGH = 1e-9
_MOST = 200
_TURN = 0.3
"""Longest turn of a coordinate in one step [rad]."""
_TRIES = 32
"""Places around the guess from which a nearer assembly is looked for."""


@dataclass(frozen=True)
class _Loops:
    """What an assembly closes: the constraints that are held, and the start values."""

    e: Equations
    p: NDArray
    s: NDArray
    held: NDArray

    def misfit(self, q: NDArray) -> NDArray:
        """How far [m, rad] each constraint is open (0 where it is not held), and each start value missed."""
        return np.concatenate([_array(self.e.gaps(q, self.p)) * self.held, _array(self.e.ties(q, self.p, self.s))])

    def matrix(self, q: NDArray) -> NDArray:
        gaps = np.array(self.e.gaps_matrix(q, self.p)) * self.held[:, None]
        return np.vstack([gaps, np.array(self.e.ties_matrix(q, self.p, self.s))])

    def closes(self, q: NDArray) -> bool:
        return bool(np.abs(self.misfit(q)).max(initial=0.0) <= _ROUGH * max(1.0, np.abs(q).max()))

    def followed(self, q: NDArray) -> tuple[NDArray, float]:
        """Where the way from q ends, and the length of the first full step."""
        turns = np.array([c.unit == "rad" for c in self.e.coordinates])
        r, first = self.misfit(q), None
        for _ in range(_MOST):
            if np.abs(r).max(initial=0.0) <= _TOLERANCE * max(1.0, np.abs(q).max()):
                break
            dq = np.linalg.lstsq(self.matrix(q), -r, rcond=1e-10)[0]
            first = float(np.linalg.norm(dq)) if first is None else first
            part = min(1.0, _TURN / max(np.abs(dq[turns]).max(initial=0.0), 1e-300))
            while part > 1e-4 and not np.linalg.norm(self.misfit(q + part * dq)) < (1 - part / 10) * np.linalg.norm(r):
                part /= 2
            if part <= 1e-4:
                break
            q = q + part * dq
            r = self.misfit(q)
        return q, first or 0.0

    def nearest(self, guess: NDArray, size: float) -> NDArray | None:
        """The assembly nearest to the guess among those found from places around it; None where none is found."""
        random, sizes = np.random.default_rng(0), size * np.linspace(0.2, 1.5, _TRIES)[:, None]
        starts = guess + sizes * random.standard_normal((_TRIES, self.e.n)) / np.sqrt(self.e.n)
        found = [q for q, _ in map(self.followed, starts) if self.closes(q)]
        return min(found, key=lambda q: np.linalg.norm(q - guess), default=None)

    def say(self, q: NDArray) -> str:
        """The widest gap at q, or the start value that is missed most."""
        return _name(self.e, self.misfit(q))


def assemble(equations: Equations, p: NDArray, s: NDArray, held: NDArray) -> NDArray:
    """Coordinates (n,) that close the loops `held` (l,) and keep the start values s, nearest to the guess.

    Gauss-Newton steps of least norm, short enough to stay on the way. Raises AssemblyError, with the loop and its gap,
    where the loops cannot be closed, where the start values contradict each other, and where the way from the guess
    leads elsewhere than to the nearest assembly that is found around it.
    """
    e, loops = equations, _Loops(equations, p, s, held)
    guess = _array(e.guess(p, s))
    if not np.isfinite(guess).all():
        raise AssemblyError(f"{e.name}: the start guess is not finite; check the dimensions and start values")
    q, step = loops.followed(guess)
    moved = float(np.linalg.norm(q - guess)) if loops.closes(q) else np.inf
    if moved <= 1.5 * step + 1e-6:
        return q
    # A long way, or none: is there an assembly nearer to the guess?
    other = loops.nearest(guess, min(moved, 3.0))
    if other is None and moved == np.inf:
        closed = np.abs(loops.misfit(q)[: e.l]).max(initial=0.0) <= _ROUGH
        reason = "the start values contradict each other" if closed else "the loops cannot be closed"
        advice = (
            "give fewer or consistent start values" if len(e.tied) > 1 else "check lengths, offsets and start values"
        )
        raise AssemblyError(f"{e.name}: {reason}; the nearest assembly leaves {loops.say(q)}; {advice}")
    if other is not None and np.linalg.norm(other - guess) < 0.99 * moved:
        worst = int(np.argmax(np.abs(other - guess)))
        raise AssemblyError(
            f"{e.name}: the guess leaves {loops.say(guess)} and leads to an assembly elsewhere than the nearest one, "
            f"where {e.coordinates[worst].name} is {other[worst]:.6g} {e.coordinates[worst].unit}; "
            "give start values or guesses closer to the assembly you want"
        )
    return q


def assemble_rates(equations: Equations, q: NDArray, p: NDArray, s: NDArray, sdot: NDArray, held: NDArray) -> NDArray:
    """Velocities (n,) that keep the loops `held` (l,) closed and have the start rates sdot, nearest to the guess.

    At a singular position, where several motions are possible, the rate of the guess decides which one begins; it must
    be one of them, not a mixture, for which no accelerations keep the loops closed.
    """
    e = equations
    v = _array(e.guess_rate(p, s, sdot))
    C = np.array(e.C(q, p)) * held[:, None]
    J = np.vstack([C, np.array(e.ties_matrix(q, p, s))])
    wanted = np.concatenate([np.zeros(e.l), sdot[e.tied]])
    for _ in range(2):
        v = v + np.linalg.lstsq(J, wanted - J @ v, rcond=1e-10)[0]
    left = J @ v - wanted
    if np.abs(left).max(initial=0.0) > _ROUGH * max(1.0, np.abs(v).max()):
        worst = int(np.argmax(np.abs(left)))
        what = e.rows[worst].name if worst < e.l else e.start_rates[e.tied[worst - e.l]].name
        raise AssemblyError(
            f"{e.name}: no motion has the given start rates; {what} is missed by {abs(left[worst]):.3g} per second; "
            "give the rates of fewer coordinates, or rates that belong together"
        )
    xi = _array(e.xi(q, v, p)) * held
    # A motion keeps what C hardly holds (a relative singular value below 1e-5) within that times its acceleration.
    lost = xi - C @ np.linalg.lstsq(C, xi, rcond=1e-5)[0] if e.l else xi
    if np.abs(lost).max(initial=0.0) > 1e-3 * max(1.0, np.abs(xi).max(initial=0.0)):
        worst = e.rows[int(np.argmax(np.abs(lost)))]
        raise AssemblyError(
            f"{e.name}: the start is a singular position, and its rates belong to none of the motions possible there "
            f"({worst.name} would open by {np.abs(lost).max():.3g} {worst.unit}/s2); start a little beside it"
        )
    return v


def check_masses(equations: Equations, q: NDArray, p: NDArray, held: NDArray) -> None:
    """AssemblyError where a motion has neither mass nor constraint, so that H cannot complete M."""
    e = equations
    M, C = np.array(e.M(q, p)), np.array(e.C(q, p)) * held[:, None]
    both = np.vstack([M / max(np.abs(M).max(initial=0.0), 1e-300), C]) if e.l else M
    _, sizes, motions = np.linalg.svd(both, full_matrices=True)
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
