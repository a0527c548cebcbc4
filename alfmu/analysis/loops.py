"""Positions with closed loops: corrections onto them, their motions, and steps along these.

Coordinates are divided by their sizes (`Loops.scale`): 1 for angles, the size of the mechanism for lengths, so that
steps of all coordinates are comparable. Rows are divided by their units. The letters y, N stand for q and a basis of
motions in these coordinates. If time is the last coordinate, y includes it, and no motion changes it.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations.arrays import ArrayFunctions
from ..equations.reactions import square_of_size
from ..kernel.symbolic import ROUND_OFF
from ..model.errors import InputError
from ..model.parts import stack
from .situation import Situation, State, Vector

CLOSED = 1e-12
"""Largest gap of closed loops [units of a row]."""

ASSEMBLED = 1e-3
"""Largest difference of the slopes of gaps and of constraints [units of a row] of joints closed as at the start of a
run: elsewhere a row of unit slope differs by 2 or more."""

STEP = 0.3
"""Longest step [rad, or sizes]: short enough for a linear step to lead to the nearest assembly."""

REACH = 3.0
"""Size of a mechanism over its longest arm [1]: coordinates of linkages vary by about this size."""

CORRECTIONS = 60
"""Largest number of corrections until the loops of a position must be closed [1]."""

HALVED = 6
"""Largest number of halvings of a correction [1] that increases the gaps; the position is abandoned after two such
corrections."""

SETTLED = 20
"""Largest number of Newton steps for the equilibrium of states [1]; one suffices if rates are linear in the states."""

FARTHER = 10.0
"""Largest change of loads due to states in a step of length STEP, over the largest stiffness times a size [1]."""

NOTHING = 1e-10
"""Singular value over the largest [1], below which corrections in that direction are damped."""


class Loops:
    """Positions (n,) that close the loops of a situation, with `freedom` independent motions at regular ones.

    States keep their values of the situation, or with `settled` are in equilibrium at each position. The size of the
    mechanism is its largest length at the start, if none is given.
    """

    def __init__(self, situation: Situation, settled: bool = False, size: float = 0.0):
        self.situation = situation
        e = situation.equations
        self.units = np.array([c.unit for c in e.coordinates])
        lengths = np.abs(situation.state.q[self.units == "m"])
        self.size: float = size or float(lengths.max(initial=0.0)) or 1.0
        self.scale: Vector = np.where(self.units == "m", self.size, 1.0)
        self.freedom: int = situation.start.freedom
        self.rank: int = 0 if e.resting else e.dependent - self.freedom
        self.moving: int = e.dependent
        """Number of coordinates without time."""
        self._rows = situation.held
        self._weights = 1 / situation.units[self._rows]
        self.home: Vector = situation.state.q / self.scale
        n, l, s, more = e.n, e.l, situation.state, len(situation.state.u) - len(e.inputs)
        self._values = [np.zeros(size) for size in (n * l, l, n, more, more * more)]
        self._q, self._u, self._x = np.full(n, np.nan), s.u.copy(), s.u[len(e.inputs) :] if settled else np.zeros(0)
        self._arguments, self._backend = [self._q, self._u, situation.p.copy(), np.array([s.t])], ArrayFunctions(e)
        self._run = self._backend.bound(situation.source.changes["place"], self._arguments, self._values)
        self._by_x = self._values[4].reshape((more, more), order="F")
        self._C = self._values[0].reshape((l, n), order="F")

    def state(self, y: Vector) -> State:
        """Return the state at rest in a position, with its states."""
        self._at(y)
        return replace(self.situation.at_rest(y * self.scale), u=self._u.copy())

    def _at(self, y: Vector) -> None:
        """Evaluate the equations at a position once; states have their equilibrium values there."""
        q = y * self.scale
        if np.array_equal(q, self._q):
            return
        self._q[:] = q
        self._run()
        for _ in range(SETTLED if len(self._x) else 0):
            rates = self._values[3]
            if unsettled := self._unsettled():
                raise InputError(
                    f"{self.situation.name}: its states ({', '.join(unsettled)}) have no steady values in some "
                    "positions; start it where they have"
                )
            before = self._u.copy()
            self._u[len(before) - len(self._x) :] -= np.linalg.solve(self._by_x, rates)
            self._run()
            if np.abs(self._u - before).max() <= 1e-15 * np.abs(self._u).max(initial=0.0):
                break

    def unsettled(self) -> list[str]:
        """Return the states whose rates cannot be zero at the home position for any values, such as the integral of a
        controller."""
        e = self.situation.equations
        if not e.states:
            return []
        plain = Loops(self.situation)
        plain._at(self.home)
        return plain._unsettled()

    def _unsettled(self) -> list[str]:
        """Return the unsettled states at the last evaluated position."""
        names = [x.name for x in self.situation.equations.states]
        if not np.isfinite(self._by_x).all():
            return names
        U, sizes, _ = np.linalg.svd(self._by_x)
        free = np.abs(U[:, sizes <= NOTHING * sizes[0]]).max(axis=1, initial=0.0)
        return [name for name, part in zip(names, free, strict=True) if part > NOTHING]

    def gaps(self, y: Vector) -> Vector:
        """Return the gap of each constraint in force, in units of its row."""
        self._at(y)
        return self._weights * self._values[1][self._rows]

    def opened(self, y: Vector) -> float:
        """Return the largest gap, in units of its row or of its round-off over `CLOSED` if that is larger."""
        round_off = ROUND_OFF * np.abs(self.matrix(y)) @ np.abs(y)
        return float((np.abs(self.gaps(y)) / np.maximum(1.0, round_off / CLOSED)).max(initial=0.0))

    def matrix(self, y: Vector) -> NDArray[np.float64]:
        """Return the constraint matrix of rows in force, in these coordinates."""
        self._at(y)
        return self.weighted(self._C)

    def weighted(self, C: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return rows (l, n) in force, in these coordinates."""
        return self._weights[:, None] * C[self._rows] * self.scale

    def along_time(self, y: Vector) -> NDArray[np.float64]:
        """Return the constraint matrix with the partial time derivatives of its rows in the column of time."""
        found, e = self.matrix(y), self.situation.equations
        found[:, e.dependent] = self._weights * self.situation.value("Phi_dot", self.state(y))[self._rows]
        return found

    def motions(self, y: Vector, count: int | None = None) -> NDArray[np.float64]:
        """Return the motions (n, count), orthonormal, that constraints fix least; `freedom` of them by default."""
        count = self.freedom if count is None else count
        return self.parts(self.matrix(y))[2][self.moving - count :].T

    def parts(self, matrix: NDArray[np.float64]) -> tuple[Any, Any, Any]:
        """Return U, s, V of rows (k, n) without time, with rows of V (moving, n) extended by a zero for time; None for
        rows that are not finite."""
        if not np.isfinite(matrix).all():
            return None, None, None
        U, s, V = np.linalg.svd(matrix[:, : self.moving])
        return U, s, np.pad(V, ((0, 0), (0, matrix.shape[1] - self.moving)))

    def sizes(self, y: Vector) -> Vector:
        """Return the `rank` largest singular values of the constraint matrix."""
        return np.asarray(np.linalg.svd(self.matrix(y), compute_uv=False)[: self.rank], float)

    def closed(self, y: Vector, near: Vector | None = None) -> Vector | None:
        """Return the nearest position that closes the loops, by corrections (10) of least norm; None if none is found.

        Corrections leave free motions unchanged. With `near`, returns None if the position is farther than STEP from
        it.
        """
        y, before, stuck = y.copy(), np.inf, 0
        for _ in range(CORRECTIONS):
            gaps, left = self.gaps(y), self.opened(y)
            if not np.isfinite(left):
                return None
            if left <= CLOSED / 100 or (left <= CLOSED and left > before / 2):
                far = near is not None and np.abs(y - near).max() > 2 * STEP
                return None if far else y
            U, s, V = self.parts(self.matrix(y))
            if U is None:
                return None
            U, s, V = U[:, : self.rank], s[: self.rank], V[: self.rank]
            d = -V.T @ (_inverses(s) * (U.T @ gaps))
            longest = np.abs(d).max()
            d *= min(1.0, STEP / longest) if longest > 0 else 1.0
            before, size = left, float(np.linalg.norm(gaps))
            for _ in range(HALVED):
                if np.linalg.norm(self.gaps(y + d)) < (1 - 1e-3) * size:
                    break
                d = d / 2
            else:
                stuck += 1
                if stuck > 1 and left > CLOSED:
                    return None
            y = y + d
        return y if self.opened(y) <= CLOSED else None

    def assembled(self, y: Vector) -> Vector | None:
        """Return the same if joints are closed as at the start of a run: at opposite axes, or half a turn off a thread,
        constraints hold, but the slopes of gaps are other ones than theirs."""
        found = self.closed(y)
        if found is None or not self._rows.any():
            return found
        s = self.state(found)
        slopes, constraints = (
            self.weighted(self.situation.value(name, s).reshape(self._C.shape)) for name in ("gaps_matrix", "C")
        )
        return found if np.abs(slopes - constraints).max() <= ASSEMBLED else None

    def walk(self, y: Vector, way: Vector, step: float, most: int) -> Iterator[Vector]:
        """Yield positions on the branch of the motion that begins at y in direction `way`, a step apart, up to
        its end."""
        before = y - step * way / np.linalg.norm(way)
        for _ in range(most):
            ahead = y - before
            for part in (1.0, 0.5, 0.25):
                found = self.closed(y + ahead * (part * step / np.linalg.norm(ahead)), y)
                if found is not None and (found - y) @ ahead > 0:
                    break
            else:
                return
            before, y = y, found
            yield y

    def scattered(self, count: int) -> Iterator[Vector]:
        """Yield positions within one size of home, with open loops, the same each time."""
        units = np.pad(self.units, (0, len(self.home) - len(self.units)))
        spread = np.where(units == "rad", np.pi, 1.0)[: self.moving]
        middle = np.where(np.isin(units, ("rad", "m")), self.home, 0.0)[: self.moving]
        for places in evenly(self.moving, count):
            yield np.append(middle + spread * (2 * places - 1), self.home[self.moving :])

    # Equality of positions ----------------------------------------------------------------------------------------

    @cached_property
    def turns(self) -> NDArray[np.bool_]:
        """Return which coordinates (n,) are angles of period 2 pi, loads included."""
        home = self.home[: len(self.units)]
        places = [home, home + 0.3 + 0.1 * np.arange(len(home))]
        found = self.units == "rad"
        places[1][self.moving :] = home[self.moving :]
        for i in np.flatnonzero(found):
            turned = np.where(np.arange(len(found)) == i, 2 * np.pi, 0.0)
            found[i] = all(self._alike(y, y + turned) for y in places)
        return found

    def _alike(self, y: Vector, other: Vector) -> bool:
        """Return whether loops, loads and rates of states are the same at two positions."""
        pairs = [(self.gaps(a), self.matrix(a).ravel(), self.loads(a), self._values[3].copy()) for a in (y, other)]
        limits = [1e-9 * max(1.0, np.abs(x).max(initial=0.0)) for x in pairs[0]]
        return all(np.abs(a - b).max(initial=0.0) <= limit for a, b, limit in zip(*pairs, limits, strict=True))

    @cached_property
    def attitudes(self) -> list[NDArray[np.intp]]:
        """Return groups of coordinates that are Euler parameters of one body, equivalent with all signs changed."""
        e = self.situation.equations
        if not e.lengths:
            return []
        pattern = np.array(ca.DM(e.functions["C"].sparsity_out(0)))  # at the start three of the four may be zero
        return [np.flatnonzero(pattern[row]) for row in e.lengths]

    def nearer(self, y: Vector, to: Vector) -> Vector:
        """Return the equivalent position, by whole turns and signs of Euler parameters, that is nearest to
        another one."""
        y = np.where(self.turns, to + np.remainder(y - to + np.pi, 2 * np.pi) - np.pi, y)
        for group in self.attitudes:
            if np.linalg.norm(y[group] + to[group]) < np.linalg.norm(y[group] - to[group]):
                y[group] = -y[group]
        return y

    def apart(self, y: Vector, other: Vector) -> float:
        """Return the largest difference of two positions [rad, sizes]."""
        return float(np.abs(self.nearer(y, other) - other).max(initial=0.0))

    def same(self, y: Vector, other: Vector, within: float) -> bool:
        """Return whether two closed positions are equal, also by turns of all angles together, as in gears."""
        if self.apart(y, other) <= within:
            return True
        apart = self.nearer(y, other) - other
        turns = np.where(self.units == "rad", 2 * np.pi * np.round(apart / (2 * np.pi)), 0.0)
        way = apart - turns
        return bool(np.abs(way).max(initial=0.0) <= within and self._alike(y, y - turns))

    # Loads --------------------------------------------------------------------------------------------------------

    def loads(self, y: Vector) -> Vector:
        """Return generalised forces (n,) at rest, in these coordinates [N.m, or N times the size]."""
        self._at(y)
        return self.scale * self._values[2]

    def balance(self, y: Vector, count: int | None = None) -> tuple[NDArray[np.float64], Vector, Vector]:
        """Return motions N (n, count), the loads along them, and multipliers of rows in force that best balance the
        others."""
        F, C = self.loads(y), self.matrix(y)
        count = self.freedom if count is None else count
        U, s, V = self.parts(C)
        if V is None or not np.isfinite(F).all():
            return np.zeros((len(y), count)), np.full(count, np.inf), np.zeros(len(C))
        rank = self.moving - count
        lam = U[:, :rank] @ ((V[:rank] @ F) * _inverses(s[:rank]))
        return V[rank:].T, V[rank:] @ F, lam

    def stiffness(self, y: Vector, N: NDArray[np.float64], lam: Vector) -> NDArray[np.float64]:
        """Return -dF/dz along motions N (n, k), with the geometric stiffness of constraints: positive if restoring."""
        s, still = self.state(y), np.zeros(len(y))
        full = np.zeros(len(self._rows))
        full[self._rows] = self._weights * lam
        Rq = self.situation.change("tangents", s, a=still, lam=full)[0]
        if len(self._x):  # dx = -Gx^-1 Gq dq keeps states in equilibrium
            Ru, Gq = (self.situation.change(name, s, a=still, lam=full)[0] for name in ("inputs", "rates"))
            Rq = Rq - Ru[:, -len(self._x) :] @ np.linalg.solve(self._by_x, Gq)
        return -N.T @ (self.scale[:, None] * Rq * self.scale) @ N


class WithStates(Loops):
    """Positions extended by states, for equilibria that must determine both together.

    A position is y followed by the states, each over its size. Its motions are those of the mechanism and the states;
    the equations of equilibrium are the loads along the former and the rates of the latter, in units of a load.
    """

    def __init__(self, situation: Situation, size: float = 0.0):
        super().__init__(situation, size=size)
        e, s = situation.equations, situation.state
        self._states = len(e.states)
        home = self.home
        N, loads, lam = super().balance(home)
        Rx, Gq, Gx = self._by_states(super().state(home), np.zeros(e.l))
        self._load: float = max(np.abs(x).max(initial=0.0) for x in (loads, super().stiffness(home, N, lam))) or 1.0
        rates = [np.abs(x).max(axis=1, initial=0.0) for x in (Gq @ (self.scale[:, None] * N), Gx)]
        rates.append(np.abs(situation.value("state_rates", s)))
        self._rate = np.maximum.reduce(rates)
        self._rate[self._rate == 0.0] = 1.0
        pushed = [self.scale[:, None] * Rx, self._load * Gx / self._rate[:, None]]
        most = np.maximum.reduce([np.abs(x).max(axis=0, initial=0.0) for x in pushed])
        self._sizes = FARTHER * self._load / np.where(most > 0.0, most, self._load)
        self.home = np.append(home, s.u[len(e.inputs) :] / self._sizes)

    def _by_states(self, s: State, lam: Vector) -> tuple[NDArray[np.float64], ...]:
        """Return derivatives of loads by states, and of the rates of states by coordinates and states."""
        inputs, still = len(self.situation.equations.inputs), np.zeros(len(s.q))
        Ru = self.situation.change("inputs", s, a=still, lam=lam)[0]
        Gq, _, Gu = self.situation.change("rates", s)
        return Ru[:, inputs:], Gq, Gu[:, inputs:]

    def _split(self, y: Vector) -> Vector:
        """Return the position alone; states are evaluated with their values in y."""
        x = y[len(self.units) :] * self._sizes
        if not np.array_equal(x, self._u[len(self._u) - self._states :]):
            self._u[len(self._u) - self._states :] = x
            self._q[:] = np.nan
        return y[: len(self.units)]

    def state(self, y: Vector) -> State:
        return super().state(self._split(y) if len(y) > len(self.units) else y)

    def closed(self, y: Vector, near: Vector | None = None) -> Vector | None:
        n = len(self.units)
        found = super().closed(self._split(y), None if near is None else near[:n])
        return None if found is None else np.append(found, y[n:])

    def motions(self, y: Vector, count: int | None = None) -> NDArray[np.float64]:
        return self._beside(super().motions(self._split(y), count))

    def _beside(self, N: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return motions of the mechanism, extended by states."""
        m = self._states
        return np.block([[N, np.zeros((len(N), m))], [np.zeros((m, N.shape[1])), np.eye(m)]])

    def balance(self, y: Vector, count: int | None = None) -> tuple[NDArray[np.float64], Vector, Vector]:
        place = self._split(y)
        N, r, lam = super().balance(place, count)
        self._at(place)
        return self._beside(N), np.append(r, self._load * self._values[3] / self._rate), lam

    def stiffness(self, y: Vector, N: NDArray[np.float64], lam: Vector) -> NDArray[np.float64]:
        place, n, m = self._split(y), len(self.units), self._states
        own = N[:n, : N.shape[1] - m]
        full = np.zeros(len(self._rows))
        full[self._rows] = self._weights * lam
        Rx, Gq, Gx = self._by_states(super().state(place), full)
        weight = (self._load / self._rate)[:, None]
        by_x = [own.T @ (self.scale[:, None] * Rx) * self._sizes, weight * Gx * self._sizes]
        by_z = [-super().stiffness(place, own, lam), weight * Gq @ (self.scale[:, None] * own)]
        return -np.hstack([np.vstack(by_z), np.vstack(by_x)])

    def nearer(self, y: Vector, to: Vector) -> Vector:
        n = len(self.units)
        return np.append(super().nearer(y[:n], to[:n]), y[n:])

    def same(self, y: Vector, other: Vector, within: float) -> bool:
        return self.apart(y, other) <= within


def arm_of(situation: Situation) -> float:
    """Return the longest arm from a centre of mass to a joint [m], independent of the position of the mechanism; 0 if
    bodies have neither joints nor bars."""
    m = situation.source.declared
    if not m or not (m.joints or m.spatial_joints or any(body.length is not None for body in m.bodies)):
        return 0.0
    p, arm = [x.symbol for x in m.parameters], ca.sqrt(square_of_size(m))
    return float(ca.Function("arm", [stack(p)], [arm])(situation.p[: len(p)]))


def _inverses(s: Vector) -> Vector:
    """Return 1 / s, bounded where s vanishes."""
    return s / (s**2 + (NOTHING * s.max(initial=0.0)) ** 2 + 1e-300)


def plain(x: float, unit: str = "1") -> str:
    """Format a coordinate, angles in degrees too; round-off counts as zero."""
    if abs(x) <= 1e-12:
        return "0"
    return f"{x:.6g}" + f" ({math.degrees(x):.4g} deg)" * (unit == "rad")


def evenly(dimensions: int, count: int) -> Iterator[Vector]:
    """Yield evenly distributed points (dimensions,) between 0 and 1, the same each time."""
    if not count:
        return
    from scipy.stats import qmc

    yield from qmc.Sobol(dimensions, scramble=False).random_base2(math.ceil(math.log2(count + 1)))[1 : count + 1]
