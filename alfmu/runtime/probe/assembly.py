"""The start of a run: loops closed from a guess, velocities made consistent, massless bodies checked."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ...equations import Equations, Mobility
from ...kernel.program import Backend, Call
from ...kernel.thresholds import LONGEST_TURN, MOST, RANKED, ROUGH, TOLERANCE, TRIES
from ...model.errors import AssemblyError

__all__ = ["Assembly"]


Matrix = Any
"""A dense array, or a sparse one where there are many coordinates."""


class Assembly:
    """The start of one mechanism: places, rates, masses, freedoms. `held` (l,) says which constraints are closed."""

    def __init__(self, equations: Equations, backend: Backend):
        self.e = equations
        self._closure, self._guesses, self._constraints, self._dynamics = (
            Call(backend, name, equations.signatures[name])
            for name in ("closure", "guesses", "constraints", "dynamics")
        )

    def assemble(self, p: NDArray, s: NDArray, held: NDArray) -> NDArray:
        """Coordinates (n,) that close the loops and keep the start values s, nearest to the guess.

        Gauss-Newton steps of least norm, short enough to stay on the way. Raises AssemblyError, with the loop and its
        gap, where the loops cannot be closed, where the start values contradict each other, and where the way from the
        guess leads elsewhere than to the nearest assembly that is found around it.
        """
        e, loops = self.e, _Loops(self.e, self._closure, p, s, held)
        guess = self._guesses(p, s, np.zeros_like(s))[0].copy()
        if not np.isfinite(guess).all():
            raise AssemblyError(f"{e.name}: the start guess is not finite; check the dimensions and start values")
        q, step = loops.followed(guess)
        moved = float(np.linalg.norm(q - guess)) if loops.closes(q) else np.inf
        if moved <= 1.5 * step + 1e-6:
            return q
        # A long way, or none: is there an assembly nearer to the guess?
        other = loops.nearest(guess, min(moved, 3.0))
        if other is None and moved == np.inf:
            closed = np.abs(loops.misfit(q)[: e.l]).max(initial=0.0) <= ROUGH
            reason = "the start values contradict each other" if closed else "the loops cannot be closed"
            many = len(e.tied) > 1
            advice = "give fewer or consistent start values" if many else "check lengths, offsets and start values"
            raise AssemblyError(f"{e.name}: {reason}; the nearest assembly leaves {loops.say(q)}; {advice}")
        if other is not None and np.linalg.norm(other - guess) < 0.99 * moved:
            worst = int(np.argmax(np.abs(other - guess)))
            raise AssemblyError(
                f"{e.name}: the guess leaves {loops.say(guess)} and leads to an assembly elsewhere than the nearest "
                f"one, where {e.coordinates[worst].name} is {other[worst]:.6g} {e.coordinates[worst].unit}; "
                "give start values or guesses closer to the assembly you want"
            )
        return q

    def rates(self, q: NDArray, p: NDArray, s: NDArray, sdot: NDArray, held: NDArray) -> NDArray:
        """Velocities (n,) that keep the loops closed and have the start rates sdot, nearest to the guess.

        At a singular position, where several motions are possible, the rate of the guess decides which one begins; it
        must be one of them, not a mixture, for which no accelerations keep the loops closed.
        """
        e = self.e
        v = self._guesses(p, s, sdot)[1].copy()
        C = _rows(held, self._constraints(q, v, p)[1])
        J = _stacked(C, self._closure(q, p, s)[1])
        wanted = np.concatenate([np.zeros(e.l), sdot[e.tied]])
        for _ in range(2):
            v = v + _least_norm(J, wanted - J @ v, 1e-10)
        left = J @ v - wanted
        if np.abs(left).max(initial=0.0) > ROUGH * max(1.0, np.abs(v).max()):
            worst = int(np.argmax(np.abs(left)))
            what = e.rows[worst].name if worst < e.l else e.start_rates[e.tied[worst - e.l]].name
            raise AssemblyError(
                f"{e.name}: no motion has the given start rates; {what} is missed by {abs(left[worst]):.3g} per "
                "second; give the rates of fewer coordinates, or rates that belong together"
            )
        xi = self._dynamics(q, v, np.zeros(len(e.inputs)), p, 0.0)[3] * held
        # A motion keeps what C hardly holds (a relative singular value below 1e-5) within that times its acceleration.
        lost = xi - C @ _least_norm(C, xi, 1e-5) if e.l else xi
        if np.abs(lost).max(initial=0.0) > 1e-3 * max(1.0, np.abs(xi).max(initial=0.0)):
            worst = e.rows[int(np.argmax(np.abs(lost)))]
            raise AssemblyError(
                f"{e.name}: the start is a singular position, and its rates belong to none of the motions possible "
                f"there ({worst.name} would open by {np.abs(lost).max():.3g} {worst.unit}/s2); start a little beside it"
            )
        return v

    def check_masses(self, q: NDArray, p: NDArray, held: NDArray) -> None:
        """AssemblyError where a motion has neither mass nor constraint, so that H cannot complete M."""
        e = self.e
        M, C, _, _ = self._constraints(q, np.zeros(e.n), p)
        C = _rows(held, C)
        largest = max(abs(M).max(), 1e-300)
        if not isinstance(M, np.ndarray):
            motions, smallest = _weakest(M / largest + C.T @ C)
        else:
            _, sizes, all_motions = np.linalg.svd(np.vstack([M / largest, C]) if e.l else M, full_matrices=True)
            motions, smallest = all_motions[-1], sizes[-1] if len(sizes) == e.n else 0.0
        if smallest > 1e-13:
            return
        free = [e.coordinates[i].name for i in np.flatnonzero(np.abs(motions) > 0.1)]
        raise AssemblyError(
            f"{e.name}: the motion along {', '.join(free)} has no mass and no constraint that holds it (singular value "
            f"{smallest:.0e} of [M; C] at the start); a massless body must be held by constraints at both ends: never "
            "the last body of an open chain, never one placed by a joint coordinate alone"
        )

    def mobility(self, p: NDArray, q: NDArray, held: NDArray) -> Mobility:
        """Degrees of freedom and redundant constraints, from the rank of C at q (n,) and at assembled places near.

        Only constraints that are held (l,) count.
        """
        ranks = [_rank(C) for C, _ in self._around(p, q, held)]
        return Mobility(self.e.n - max(ranks), int(held.sum()) - max(ranks), self.e.n - ranks[0])

    def redundancy(self, p: NDArray, q: NDArray, held: NDArray) -> NDArray:
        """Multipliers (l, k) that move nothing at a regular position near q (n,): what redundant constraints share.

        A row's multiplier is unique where all of these are zero in it.
        """
        C, units = max(self._around(p, q, held), key=lambda place: _rank(place[0]))
        C = C if isinstance(C, np.ndarray) else C.toarray()
        rows, _, _ = np.linalg.svd(C[held])
        shares = np.zeros((self.e.l, int(held.sum()) - _rank(C)))
        shares[held] = rows[:, _rank(C) :]
        return shares / units[:, None]

    def _around(self, p: NDArray, q: NDArray, held: NDArray) -> Iterator[tuple[Matrix, NDArray]]:
        """C at q and at assembled places near, its rows in the units that are given with it (l,)."""
        e = self.e
        random = np.random.default_rng(0)
        C = self._at(q, p, held)[0]
        sparse = not isinstance(C, np.ndarray)
        places = 0.3 * random.standard_normal((2 if sparse else RANKED, e.n))
        places *= max(1.0, np.abs(q).max()) / np.sqrt(e.n)
        units = np.ones(e.l)
        if not sparse:  # Rows in other units are as independent as before.
            largest = [np.abs(self._at(place, p, held)[0]).max(axis=1, initial=0.0) for place in (q, *(q + places))]
            units = np.max(largest, axis=0)
            units[units == 0] = 1.0
        yield self._at(q, p, held / units)[0], units
        for aside in places:
            if sparse:  # Along the motion: in a long chain any other way leads far from an assembly.
                aside = aside - _least_norm(C, C @ aside, 1e-8)
                aside *= 0.3 / max(np.abs(aside).max(), 1e-300)
            near = q + aside
            for _ in range(30):
                J, Phi = self._at(near, p, held / units)
                if np.abs(Phi).max(initial=0.0) <= 1e-16 * np.abs(near).max():
                    break
                near = near - _least_norm(J, Phi, 1e-8)
            J, Phi = self._at(near, p, held / units)
            if np.abs(Phi).max(initial=0.0) < 1e-9:
                yield J, units

    def _at(self, q: NDArray, p: NDArray, weights: NDArray) -> tuple[Matrix, NDArray]:
        """C and Phi, each row times its weight (l,), which is zero where a constraint is not held."""
        _, C, Phi, _ = self._constraints(q, np.zeros(self.e.n), p)
        return _rows(weights, C.copy()), Phi * weights


@dataclass(frozen=True)
class _Loops:
    """What an assembly closes: the constraints that are held, and the start values."""

    e: Equations
    closure: Call
    p: NDArray
    s: NDArray
    held: NDArray

    def misfit(self, q: NDArray) -> NDArray:
        """How far [m, rad] each constraint is open (0 where it is not held), and each start value missed."""
        _, _, gaps, ties = self.closure(q, self.p, self.s)
        return np.concatenate([gaps * self.held, ties])

    def matrix(self, q: NDArray) -> Matrix:
        gaps, ties, _, _ = self.closure(q, self.p, self.s)
        return _stacked(_rows(self.held, gaps), ties)

    def closes(self, q: NDArray) -> bool:
        return bool(np.abs(self.misfit(q)).max(initial=0.0) <= ROUGH * max(1.0, np.abs(q).max()))

    def followed(self, q: NDArray) -> tuple[NDArray, float]:
        """Where the way from q ends, and the length of the first full step."""
        turns = np.array([c.unit == "rad" for c in self.e.coordinates])
        r, first = self.misfit(q), None
        for _ in range(MOST):
            if np.abs(r).max(initial=0.0) <= TOLERANCE * max(1.0, np.abs(q).max()):
                break
            dq = -_least_norm(self.matrix(q), r, 1e-10)
            first = float(np.linalg.norm(dq)) if first is None else first
            part = min(1.0, LONGEST_TURN / max(np.abs(dq[turns]).max(initial=0.0), 1e-300))
            while part > 1e-4 and not np.linalg.norm(self.misfit(q + part * dq)) < (1 - part / 10) * np.linalg.norm(r):
                part /= 2
            if part <= 1e-4:
                break
            q = q + part * dq
            r = self.misfit(q)
        return q, first or 0.0

    def nearest(self, guess: NDArray, size: float) -> NDArray | None:
        """The assembly nearest to the guess among those found from places around it; None where none is found."""
        random, sizes = np.random.default_rng(0), size * np.linspace(0.2, 1.5, TRIES)[:, None]
        starts = guess + sizes * random.standard_normal((TRIES, self.e.n)) / np.sqrt(self.e.n)
        found = [q for q, _ in map(self.followed, starts) if self.closes(q)]
        return min(found, key=lambda q: np.linalg.norm(q - guess), default=None)

    def say(self, q: NDArray) -> str:
        """The widest gap at q, or the start value that is missed most."""
        return _name(self.e, self.misfit(q))


def _rows(weights: NDArray, matrix: Matrix) -> Matrix:
    """The rows times their weights, which are zero where a constraint is not held."""
    return matrix * weights[:, None] if isinstance(matrix, np.ndarray) else matrix.multiply(weights[:, None]).tocsc()


def _stacked(above: Matrix, below: Matrix) -> Matrix:
    if isinstance(above, np.ndarray):
        return np.vstack([above, below])
    from scipy.sparse import vstack

    return vstack([above, below], format="csc")


def _least_norm(J: Matrix, r: NDArray, rcond: float) -> NDArray:
    """x of least norm with J x = r as nearly as possible, singular values below rcond of the largest left alone."""
    if isinstance(J, np.ndarray):
        return np.linalg.lstsq(J, r, rcond=rcond)[0]
    H = _regular(J.T @ J, rcond**2)
    x = H.solve(J.T @ r)
    for _ in range(3):
        x = x + H.solve(J.T @ (r - J @ x))
    return x


def _regular(square: Matrix, ratio: float) -> Any:
    """LDL' factors of a sparse J' J made regular by a small multiple of its largest entry."""
    from scipy.sparse import eye_array
    from scipy.sparse.linalg import splu

    size = ratio * abs(square).max()
    matrix = (square + max(size, 1e-300) * eye_array(square.shape[0])).tocsc()
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True})


def _weakest(square: Matrix) -> tuple[NDArray, float]:
    """The direction that a sparse positive matrix holds least, and how much."""
    factors = _regular(square, 1e-30)
    x = np.random.default_rng(0).standard_normal(square.shape[0])
    for _ in range(3):
        x = factors.solve(x / np.linalg.norm(x))
    return x / np.linalg.norm(x), 1 / np.linalg.norm(x)


def _rank(C: Matrix) -> int:
    if not isinstance(C, np.ndarray):
        pivots = _regular(C.T @ C, 1e-12).U.diagonal()
        return int((pivots > 1e-8 * abs(pivots).max()).sum())
    return int(np.linalg.matrix_rank(C, tol=1e-7 * max(1.0, np.abs(C).max()))) if C.size else 0


def _name(e: Equations, r: NDArray) -> str:
    worst = int(np.argmax(np.abs(r)))
    if worst < e.l:
        row = e.rows[worst]
        gap = np.linalg.norm([x for x, other in zip(r, e.rows, strict=False) if other.name == row.name])
        return f"a gap of {gap:.3g} {row.unit} at {row.name}"
    start = e.starts[e.tied[worst - e.l]]
    return f"{start.name} missed by {abs(r[worst]):.3g} {start.unit}"
