"""Kinematics and inverse dynamics of mechanisms by their actuated joints, with loops of any kind.

Displacements x(q) of the actuated joints, or watched values w(q), determine a position together with the
loops. With motions N of the closed loops, C N = 0, rates and efforts follow from

    [C; x_q] v = [-Phi_t; x'],  [C; x_q] a = [xi; x'' - (x_q)' v],  (x_q N)' tau = N' (M a + d - f),

where tau are the efforts of the actuators, of least norm if there are more actuators than degrees of freedom. The kinds
of singular positions are those of C. Gosselin and J. Angeles (IEEE Transactions on Robotics and Automation 6, 1990,
281-290) and of D. Zlatanov, I. Bonev and C. Gosselin (ICRA 2002, 496-502); the manipulability is that of T. Yoshikawa
(International Journal of Robotics Research 4, 1985, 3-9).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Container, Mapping, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ..equations import Equations
from ..equations.changes import value
from ..equations.evaluation import symbols
from ..model.errors import InputError
from ..model.mechanism import Mechanism
from ..model.parts import EFFORTS, FREE, Joint, Marker, Motion, key_of, stack
from ..model.units import quotient, rate_of
from ..model.words import counted, shown, there_is
from ..simulation import by_name, names_in
from ..simulation.result import Result, Signal
from .loops import CLOSED, REACH, STEP, Loops, arm_of, plain
from .situation import Situation, State, Vector, begun, source

Matrix = NDArray[np.float64]
Values = Mapping[str, float | Sequence[float] | Vector] | Sequence[float] | Vector | None
"""Values by name, or those of all actuated joints in their order."""

Columns = dict[str, tuple[str, Sequence[float] | Vector]]
"""Units and values of columns by name."""

SINGULAR = 1e-5
"""Singular value [1] up to which a position is singular: where two assemblies meet, loops closed to 1e-12 determine the
position only to the square root of that, 1e-6."""

STARTS = 64
"""Default number of positions from which all solutions are searched [1]: 32 find the four solutions of a five-bar
robot, 256 all of a delta robot, whose platform may also turn over."""

SAME = 1e-6
"""Largest difference [rad, sizes] of positions that count as one solution."""

ALIKE = 1e-6
"""Largest change of the constraint matrix over its largest entry [1] with which loops are as they were: loops that
close to 1e-12 place what is nearly singular to the square root of that."""

_UNMOVED = "weld", "distance"
"""Kinds of joints without a motion that could be actuated."""

PACE, MOST = 0.05, 4000
"""Step of the search for dead positions [rad, sizes], and largest number of such steps [1]: 200 rad."""

HALVED = 12
"""Largest number of halvings of a step [1], before the given values count as out of reach."""

AGREES = 1e-9
"""Relative difference [1] above which rates of redundant actuators contradict each other."""


@dataclass(frozen=True)
class Position:
    """A position with closed loops: `position["tool.x"]` is a value, `position["tool"]` the array of its values."""

    mechanism: str
    actuated: Mapping[str, float]
    """Displacements of the actuated joints [rad or m]."""
    values: Mapping[str, float]
    """Coordinates, and outputs that follow from the position alone: of bodies, watched points, joints."""
    gap: float
    """Largest gap of the loops [units of a row]."""
    beyond: Mapping[str, float]
    """Penetration [rad or m] of each limit stop that the position violates."""
    q: Vector = field(repr=False)
    """All coordinates (n,), with time if laws move something."""

    def __getitem__(self, name: str) -> Any:
        if name in (known := {**self.values, **self.actuated}):
            return known[name]
        every = [x for x in self.values if x.rpartition(".")[0] == name]
        if not every:
            raise InputError(f"{self.mechanism} has no place {name!r}; {there_is(name, list(self.values))}")
        return np.array([self.values[x] for x in _parts(name, self.values) or every])


def _parts(name: str, known: Container[str]) -> list[str]:
    """Return the known values of a coordinate, an output, a joint, a body or a watched point."""
    ends = [x for end in (*"xyz", "angle", "e0", "e1", "e2", "e3") if (x := f"{name}.{end}") in known]
    return [name] if name in known else ends or [x for x in (f"{name}.displacement",) if x in known]


@dataclass(frozen=True)
class Transmission:
    """The Jacobian from actuated rates to rates of the watched values, and the singularity of a position.

    Three numbers [1] vanish at singular positions: `constraint`, the least singular value of the constraint matrix over
    its largest; `parallel`, the least rate of the actuators, and `serial`, the least rate of the watched values. Both
    are for motions with bodies at unit speed (rad/s, lengths over `size`) and do not depend on the choice of
    coordinates and axes.
    """

    rows: tuple[str, ...]
    """Rates of the watched values: velocities in ground axes."""
    columns: tuple[str, ...]
    """Actuated joints."""
    matrix: Matrix
    """(rows, columns) in SI units; NaN at a parallel or a constraint singularity."""
    singular_values: Vector
    """Singular values of the matrix in SI units; if units of its rows or columns differ, lengths are over `size`."""
    manipulability: float
    """Product of the singular values that do not vanish at all positions."""
    constraint: float
    parallel: float
    serial: float
    """Least rate of the watched values [1]; NaN if nothing is watched."""
    size: float
    """Length of the mechanism [m]."""

    @property
    def singular(self) -> tuple[str, ...]:
        """Kinds of singularity: "constraint" (loops allow more motions, and the other kinds are not defined),
        "parallel" (type 2: locked actuators cannot hold the mechanism), "serial" (type 1: watched values cannot move in
        a direction)."""
        found = [kind for kind in ("constraint", "parallel", "serial") if getattr(self, kind) <= SINGULAR]
        return ("constraint",) if "constraint" in found else tuple(found)

    def lines(self) -> list[str]:
        """Return a table as lines of text."""
        verdict = " and ".join(f"{kind} singularity" for kind in self.singular) or "regular"
        names = [f"{kind} {getattr(self, kind):.3g}" for kind in ("constraint", "parallel", "serial")]
        lines = [f"{verdict}: {', '.join(names)}; singular at or below {SINGULAR:g}"]
        if len(self.rows) and np.isfinite(self.matrix).all():
            lines += [f"Jacobian by the rates of {', '.join(self.columns)}:"]
            table = [" ".join(f"{x + 0.0:12.6g}" for x in row) for row in self.matrix]
            lines += [f"  {name:<28} {row}" for name, row in zip(self.rows, table, strict=True)]
            sizes = ", ".join(f"{x:.4g}" for x in self.singular_values)
            lines += [f"singular values {sizes}; manipulability {self.manipulability:.4g}"]
        return lines


class _Quantities:
    """Coordinates and outputs that depend on the position alone, as functions of it."""

    def __init__(self, e: Equations):
        x = symbols(e)
        q, v, y, n = x["q"], x["v"], value(e, "readings", x), e.dependent
        moved = set(ca.jacobian_sparsity(y, ca.vertcat(*(x[k] for k in ("v", "a", "lam", "u", "t")))).row())
        own = [i for i, o in enumerate(e.outputs) if not (i in moved or ("/s" in o.unit and y[i].is_constant()))]
        spin = [i for i, o in enumerate(e.outputs) if ".angular_velocity." in o.name]
        known = [*e.coordinates[: 0 if e.resting else n], *(e.outputs[i] for i in own)]
        self.names, self.units = [each.name for each in known], [each.unit for each in known]
        self.place = {name: i for i, name in enumerate(self.names)}
        self.wrapped = np.array([name in e.wrapped for name in self.names], bool)
        self.spins = [e.outputs[i].name for i in spin]
        """Components of angular velocities of bodies in space."""
        bodies = {name[:-2] for name in self.spins} | {o.name for o in e.outputs}
        bodies = {b.removesuffix(".angular_velocity") for b in bodies if b.endswith(".angular_velocity")}
        self.of_bodies = [i for b in sorted(bodies) for i in self.ends(b, "x", "y", "z", "angle")]
        y = ca.substitute(y, ca.vertcat(x["a"], x["lam"]), ca.SX.zeros(e.n + e.l))
        w = ca.vertcat(q[: len(known) - len(own)], y[own])
        by_v = [ca.jacobian(w, q[:n]), ca.jacobian(y[spin], v)[:, :n]]
        results = [w, *map(ca.densify, by_v), ca.jacobian(w, q[n:]), ca.jtimes(ca.jtimes(w, q, v), q, v)]
        self.run = ca.Function("quantities", [q, v, x["p"], x["u"], x["t"]], results)
        """w, w_q (w, n), derivatives of spins by v, w_t, second rates at a = 0."""

    def ends(self, name: str, *ends: str) -> list[int]:
        return [self.place[f"{name}.{end}"] for end in ends if f"{name}.{end}" in self.place]

    def parts(self, name: str) -> list[int]:
        """Return the rows of a coordinate, an output, a joint, a body or a watched point."""
        return [self.place[x] for x in _parts(name, self.place)]


class _Steered(Loops):
    """Loops with additional rows for quantities of given value; none at first, `steered` adds them."""

    def __init__(self, situation: Situation, of: _Quantities):
        self.of, self.rows, self.goal = of, np.zeros(0, int), np.zeros(0)
        self.arm = arm_of(situation)
        super().__init__(situation, size=REACH * self.arm)
        self.arm = self.arm or self.size
        self.weights: Vector = np.array([1 / self.arm if unit == "m" else 1.0 for unit in of.units])
        self._still = situation.at_rest(situation.state.q).v
        self._seen: tuple[bytes, list[Matrix]] = (b"", [])
        self.closing = self.rank

    def steered(self, rows: Sequence[int], goal: Vector, rank: int) -> _Steered:
        """Return these loops with given values, `rank` of which are independent."""
        found = copy(self)
        found.rows, found.goal, found.rank = np.array(rows, int), goal, self.closing + rank
        return found

    def look(self, y: Vector, v: Vector | None = None) -> list[Matrix]:
        """Return values, derivatives of values and spins by y, and rates and second rates due to time and v."""
        v, s = self._still if v is None else v, self.situation.state
        key = y.tobytes() + v.tobytes()
        if key != self._seen[0]:
            found = [np.array(x) for x in self.of.run(y * self.scale, v, self.situation.p, s.u, s.t)]
            scale = self.scale[: self.moving]
            self._seen = key, [found[0].ravel(), found[1] * scale, found[2] * scale, found[3].sum(1), found[4].ravel()]
        return self._seen[1]

    def missed(self, y: Vector) -> Vector:
        """Return the deviations of quantities from their given values; those of wrapped angles modulo whole turns."""
        apart = self.look(y)[0][self.rows] - self.goal
        turned = np.remainder(apart + np.pi, 2 * np.pi) - np.pi
        return np.where(self.of.wrapped[self.rows], turned, apart) * self.weights[self.rows]

    def gaps(self, y: Vector) -> Vector:
        return np.append(super().gaps(y), self.missed(y))

    def matrix(self, y: Vector) -> Matrix:
        given = self.look(y)[1][self.rows] * self.weights[self.rows, None]
        return np.vstack([super().matrix(y), np.pad(given, ((0, 0), (0, len(y) - self.moving)))])

    def sizes(self, y: Vector) -> Vector:
        """Return the singular values with lengths of coordinates and rows over the longest arm, equal at every size."""
        shorter, e = np.where(self.units == "m", self.arm / self.size, 1.0), self.situation.equations
        units = np.where([row.unit == "m" for row in e.rows], self.arm, self.situation.units)
        units[e.lengths] = 1.0
        rows = np.append(1 / (self._weights * units[self._rows]), np.ones(len(self.rows)))
        return np.asarray(np.linalg.svd(rows[:, None] * self.matrix(y) * shorter, compute_uv=False)[: self.rank], float)

    def loads(self, y: Vector) -> Vector:
        return np.zeros(len(y))  # loads do not change the solved positions

    def ahead(self, y: Vector, right: Vector) -> Vector:
        """Return the change of y, without time, of least norm that changes the rows by `right`."""
        U, s, V = np.linalg.svd(self.matrix(y)[:, : self.moving], full_matrices=False)
        r = self.rank
        return np.asarray(V[:r].T @ ((U[:, :r].T @ right) / np.maximum(s[:r], 1e-300)), float)

    def lasting(self, y: Vector) -> Matrix:
        """Return motions (n, freedom) with orthonormal body rates; an arbitrary basis if some motion moves no body."""
        of, N = self.of.of_bodies, self.motions(y)[: self.moving]
        rates = np.vstack([self.look(y)[1][of] * self.weights[of, None], self.look(y)[2]]) @ N
        _, s, V = np.linalg.svd(rates, full_matrices=False)
        apart = len(s) == N.shape[1] and s.size and s[-1] > SINGULAR * s[0]
        return np.asarray(N @ (V.T / s), float) if apart else N

    def rates(self, y: Vector, rows: Sequence[int]) -> Matrix:
        """Return the rates of quantities (rows, freedom) for the motions `lasting`, lengths over the size."""
        return (self.look(y)[1][list(rows)] * self.weights[list(rows), None]) @ self.lasting(y)


class Kinematics:
    """A mechanism by its actuated joints: positions, Jacobians, efforts and cycles. `alfmu.kinematics` makes it.

    Values are given by the names of joints, coordinates, watched points, bodies and outputs, such as `{"A": 0.3}` or
    `{"tool": (0.2, 0.1)}`; values of all actuated joints may also be a sequence in their order. A body in the plane is
    x, y [m] of its centre of mass and its angle [rad], one in space x, y, z and its Euler parameters e0 to e3.
    """

    def __init__(
        self, where: Situation, declared: Mechanism, actuated: Sequence[str], watch: Sequence[str], home: Vector
    ):
        self._where, self._declared = where, declared
        self.name: str = where.name
        self._of = where.equations.kept.latest(_Quantities, lambda: _Quantities(where.equations))
        self._loops = _Steered(where, self._of)
        self.size: float = self._loops.arm
        """Length of the mechanism [m]: the longest arm from a centre of mass to a joint."""
        self.freedom: int = self._loops.freedom
        """Degrees of freedom without the motions of the actuated joints."""
        self.actuated: tuple[str, ...] = tuple(actuated)
        """Names of the actuated joints."""
        self._rows = [self._single(name) for name in actuated]
        self.units: dict[str, str] = dict(zip(self._of.names, self._of.units, strict=True))
        self.units |= {name: self._of.units[i] for name, i in zip(actuated, self._rows, strict=True)}
        """Units of all values by name, and of the actuated joints."""
        self._home = home / self._loops.scale
        self._beside, self._ranks = self._regular(), dict[tuple[int, ...], int]()
        self._check_count()
        self.redundant: int = len(actuated) - self.freedom
        """Actuated joints beyond the degrees of freedom."""
        self.watched: dict[str, list[str]] = {name: [self._of.names[i] for i in self._named(name)] for name in watch}
        """Watched points, bodies, joints and outputs, each with the names of its values."""
        self.start: Position = self._position(self._home)
        """The position at the start."""

    def __repr__(self) -> str:
        return f"Kinematics({self.name!r}, actuated = {', '.join(self.actuated)})"

    @property
    def notes(self) -> list[str]:
        """Notes on the efforts: how redundant actuators share the load, and which friction is left out."""
        notes, rubs = [], ", ".join(x.name for x in self._where.equations.frictions)
        if self.redundant:
            more = counted(self.redundant, "actuator") + " more than degrees of freedom"
            notes += [f"{more}: efforts are those of least norm, with forces weighted by {self.size:.4g} m"]
        return notes + [f"efforts leave out dry friction: {rubs}"] * bool(rubs)

    # Positions --------------------------------------------------------------------------------------------------

    def forward(self, values: Values = None, near: Position | None = None) -> Position:
        """Return the position with these displacements of the actuated joints; the others keep theirs.

        It is reached from `near`, or the start, on a straight line in the displacements. Raises InputError where
        that line ends, with the least singular value measured there.
        """
        rows, goal = self._given(values, self._loops.look(self._begin(near))[0][self._rows])
        return self._position(self._moved(rows, goal, near))

    def inverse(self, values: Values, near: Position | None = None) -> Position:
        """Return the position with these values of watched points, or of any joints, coordinates and outputs.

        It is reached from `near`, or the start, on a straight line in the values. If that fails or ends beyond a limit
        stop, it is the nearest one found from several starting positions within the limits. Raises InputError if there
        is none.
        """
        rows, goal = self._targets(values, near)
        try:
            found = self._position(self._moved(rows, goal, near))
        except InputError as error:
            reason = error
        else:
            if not found.beyond:
                return found
            stop, by = next(iter(found.beyond.items()))
            text = f"{self.name}: the position found is {by:.3g} beyond the limit {stop}, and no other was found"
            reason = InputError(f"{text}; give other values, or another position as near=")
        others = [each for each in self._all(rows, goal, STARTS, near) if not each.beyond]
        if not others:
            raise reason
        return others[0]

    def solutions(self, values: Values, near: Position | None = None, starts: int = STARTS) -> list[Position]:
        """Return all positions with these values that are found from several starts, the nearest to `near` first.

        Values of all actuated joints give the assemblies of the loops, watched values the inverse solutions; positions
        beyond limit stops are included. Raises InputError if the values leave a degree of freedom.
        """
        self._whole("starts", starts, 0)
        rows, goal = self._targets(values, near)
        if left := self.freedom - self._spans(rows):
            text = (
                f"{self.name}: these values leave {counted(left, 'degree')} of freedom, so solutions are not isolated"
            )
            raise InputError(f"{text}; give more values, such as those of actuated joints")
        return self._all(rows, goal, starts, near)

    def _all(self, rows: Sequence[int], goal: Vector, starts: int, near: Position | None) -> list[Position]:
        loops, begin = self._loops.steered(rows, goal, self._spans(rows)), self._begin(near)
        found: list[Vector] = []
        angles = [i for i in rows if self._of.units[i] == "rad" and not self._of.wrapped[i]]
        for place in (begin, *loops.scattered(starts)):
            y = loops.assembled(place)
            if y is not None and not any(self._loops.same(y.copy(), other, SAME) for other in found):
                kept = np.abs(loops.look(y)[1][angles]).max(axis=0, initial=0.0) > 0  # given angles keep their turns
                kept = np.pad(kept, (0, len(y) - len(kept))) & (loops.units == "rad")
                found.append(np.where(kept, y, self._loops.nearer(y.copy(), begin)))
        return [self._position(y) for y in sorted(found, key=lambda y: float(np.abs(y - begin).max(initial=0.0)))]

    def _moved(self, rows: Sequence[int], goal: Vector, near: Position | None) -> Vector:
        """Return the closed position with these values, on a straight line in the values from another position."""
        y = self._begin(near)
        loops = self._loops.steered(rows, goal, self._spans(rows))
        weights, apart = loops.weights[loops.rows], loops.missed(y)
        here, done, step = goal + apart / weights, 0.0, 1.0
        most = min(1.0, STEP / max(float(np.abs(apart).max(initial=0.0)), 1e-300))
        while done < 1.0:
            part = min(step, most, 1.0 - done)
            loops.goal = self._between(rows, here, goal, done + part)
            ahead = loops.ahead(y, np.append(np.zeros(int(loops.situation.held.sum())), -loops.missed(y)))
            short = np.abs(ahead).max(initial=0.0) <= 4 * STEP
            found = loops.closed(y + np.pad(ahead, (0, len(y) - len(ahead))), y) if short else None
            y, done, step = (y, done, part / 2) if found is None else (found, done + part, 2 * part)
            if step < most / 2**HALVED and done < 1.0:
                least = float(np.linalg.svd(loops.matrix(y)[:, : loops.moving], compute_uv=False)[loops.rank - 1])
                wanted, last = (self._said(rows, x) for x in (goal, self._between(rows, here, goal, done)))
                text = f"{self.name}: {wanted} is out of reach; on the straight path to it the loops stay closed up to"
                text += f" {last}, where the least singular value is {least:.2g} (0 at a singular position)"
                raise InputError(f"{text}; give values within reach, or another position as near=")
        return y

    def _said(self, rows: Sequence[int], values: Vector) -> str:
        named = dict(zip(self._rows, self.actuated, strict=True))
        pairs = ((i, plain(x, self._of.units[i])) for i, x in zip(rows, values, strict=True))
        return ", ".join(f"{named.get(i, self._of.names[i])} = {text}" for i, text in pairs)

    def _between(self, rows: Sequence[int], here: Vector, goal: Vector, part: float) -> Vector:
        """Return values between two positions, with normalised Euler parameters."""
        found, names = here + part * (goal - here), [self._of.names[i] for i in rows]
        for body in {name[:-1] for name in names if name.endswith(".e0")}:
            which = [k for k, name in enumerate(names) if name[:-1] == body]
            found[which] /= np.linalg.norm(found[which]) if len(which) == 4 else 1.0
        return found

    def _begin(self, near: Position | None) -> Vector:
        if near is None:
            return self._home.copy()
        if not isinstance(near, Position) or (near.mechanism, len(near.q)) != (self.name, len(self._home)):
            text = f"{self.name}: {shown(near)} is not a position of it"
            raise InputError(f"{text}; give one that forward() or inverse() returned")
        return near.q / self._loops.scale

    def _position(self, y: Vector) -> Position:
        e, where, w, q = self._where.equations, self._where, self._loops.look(y)[0], y * self._loops.scale
        depths = where.value("stops", where.at_rest(q)) if e.limited else np.zeros(0)
        beyond = {
            x.name: float(d) for x, d in zip(e.limited, depths, strict=True) if d > 10 * CLOSED * self._loops.size
        }
        actuated = dict(zip(self.actuated, w[self._rows].tolist(), strict=True))
        gap = float(np.abs(self._loops.gaps(y)).max(initial=0.0))
        return Position(self.name, actuated, dict(zip(self._of.names, w.tolist(), strict=True)), gap, beyond, q)

    # Names and numbers ------------------------------------------------------------------------------------------

    def _named(self, name: str) -> list[int]:
        if not (rows := self._of.parts(name)):
            names = sorted({*self._of.names, *(k.removesuffix(".x") for k in self._of.names if k.endswith(".x"))})
            text = f"{self.name} has no place {name!r} that follows from its position"
            raise InputError(f"{text}; {there_is(name, names)}")
        return rows

    def _single(self, name: str) -> int:
        joints: list[Any] = [*self._declared.joints, *self._declared.spatial_joints]
        if any(x.name == name and x.kind in _UNMOVED for x in joints):
            has = f"{self.name}: {name} has no motion of its own that could be actuated"
            raise InputError(f"{has}; for a cylinder declare two bodies that a prismatic joint connects, and name it")
        rows = self._named(name)
        if len(rows) > 1 and any(x.name == name for x in joints):
            rows = self._of.ends(name, "angle", "displacement")
        if len(rows) > 1:
            has = f"{self.name}: {name} has {counted(len(rows), 'value')} and cannot be actuated as a whole"
            raise InputError(f"{has}; name a joint with one free motion, or a coordinate")
        return rows[0]

    def _index(self, name: str) -> int:
        if name not in self.actuated:
            raise InputError(f"{self.name}: {name!r} is not actuated; {there_is(name, self.actuated)}")
        return self.actuated.index(name)

    def _whole(self, what: str, given: Any, least: int) -> None:
        if isinstance(given, bool) or not isinstance(given, int | np.integer) or given < least:
            raise InputError(f"{self.name}: {what} is {shown(given)}; it must be a whole number of {least} or more")

    def _numbers(self, what: str, given: Any, count: int | None = None) -> Vector:
        try:
            found = np.atleast_1d(np.array(given, float))
        except (TypeError, ValueError):
            found = np.array([np.nan])
        if isinstance(given, bool) or found.ndim > 1 or not np.isfinite(found).all():
            raise InputError(f"{self.name}: {what} is {shown(given)}; give finite numbers")
        if len(found) != (len(found) or 1 if count is None else count):
            text = f"{self.name}: {what} is given {counted(len(found), 'value')}"
            raise InputError(f"{text}; give {counted(count, 'number') if count else 'some'}")
        return found

    def _targets(self, values: Values, near: Position | None) -> tuple[list[int], Vector]:
        """Return rows and values given by names, with normalised Euler parameters."""
        here = self._loops.look(self._begin(near))[0]
        if not isinstance(values, Mapping):
            return self._given(values, here[self._rows])
        rows, goal = list[int](), list[float]()
        for name, given in values.items():
            parts = [self._rows[self.actuated.index(name)]] if name in self.actuated else self._named(name)
            numbers = self._numbers(name, given)
            if len(numbers) != len(parts):
                has = ", ".join(self._of.names[i] for i in parts)
                raise InputError(f"{self.name}: {name} is given {counted(len(numbers), 'value')}, and it has {has}")
            turns = [k for k, i in enumerate(parts) if self._of.names[i][:-1].endswith(".e")]
            if len(turns) == 4:
                if not numbers[turns].any():
                    raise InputError(f"{self.name}: Euler parameters of {name} are zero; they are at unit length")
                numbers[turns] /= np.linalg.norm(numbers[turns])
                numbers[turns] *= np.sign(here[[parts[k] for k in turns]] @ numbers[turns]) or 1.0
            rows, goal = [*rows, *parts], [*goal, *numbers.tolist()]
        if not rows:
            raise InputError(
                f"{self.name}: no values are given; give values of joints, coordinates, points or outputs by name"
            )
        return rows, np.array(goal)

    def _given(self, values: Values, others: Vector) -> tuple[list[int], Vector]:
        """Return rows and values of the given actuated joints if they determine the motion, else of all."""
        values = {} if values is None else values
        if not isinstance(values, Mapping):
            numbers = self._numbers("the list of values", values)
            if len(numbers) != len(self.actuated):
                text = f"{self.name}: {counted(len(numbers), 'value')} for {counted(len(self.actuated), 'joint')}"
                raise InputError(f"{text}; give one for each of {', '.join(self.actuated)}, or name them")
            return self._rows, numbers
        named = sorted(self._index(name) for name in values)
        if self._spans([self._rows[k] for k in named]) < self.freedom:
            named = list(range(len(self.actuated)))
        goal = [self._numbers(self.actuated[k], values.get(self.actuated[k], others[k]), 1)[0] for k in named]
        return [self._rows[k] for k in named], np.array(goal, float)

    def _regular(self) -> list[Vector]:
        """Return the start and positions near it along several motions, most of which are regular."""
        loops, found = self._loops, [self._home]
        N = loops.motions(self._home, self._where.start.freedom_here)
        for k, part in enumerate((STEP, -STEP, 2 * STEP, STEP)):
            way = N @ np.cos((k // 2 + 1) * (1.0 + np.arange(N.shape[1])))
            y = loops.closed(self._home + part * way / max(float(np.abs(way).max(initial=0.0)), 1e-300))
            found += [] if y is None else [y]
        return found

    def _spans(self, rows: Sequence[int]) -> int:
        """Return the rank of the rates of quantities at regular positions."""
        key = tuple(rows)
        if key not in self._ranks:
            sizes = [np.linalg.svd(self._loops.rates(y, rows), compute_uv=False) for y in self._beside if len(rows)]
            self._ranks[key] = max((int((s > SINGULAR).sum()) for s in sizes), default=0)
        return self._ranks[key]

    def _check_count(self) -> None:
        """Raise InputError if the actuated joints do not determine the motion."""
        e, count = self._where.equations, counted(self.freedom, "degree")
        if e.slips:
            text = f"{self.name}: {e.rows[e.slips[0]].name} constrains a velocity, so that positions depend on the path"
            raise InputError(f"{text} and not on the actuated joints alone; simulate it with m.motion()")
        if not self.freedom:
            raise InputError(f"{self.name}: it has no degree of freedom that a joint could actuate")
        y = self._beside[-1]
        if len(np.unique(self._loops.look(y)[1][self._rows].round(12), axis=0)) < len(self._rows):
            raise InputError(f"{self.name}: the actuated joints {', '.join(self.actuated)} name one motion twice")
        if (spans := self._spans(self._rows)) == self.freedom:
            return
        found = self._loops.rates(y, self._rows)
        sizes = np.abs(self._loops.lasting(y) @ np.linalg.svd(found)[2][spans:].T).max(axis=1)
        most = [self._where.coordinates[i].name for i in np.argsort(-sizes)[:4] if sizes[i] > 0.1 * sizes.max()]
        idle = [k for k, row in zip(self.actuated, found, strict=True) if np.abs(row).max() <= SINGULAR]
        why = f" ({', '.join(idle)} cannot move)" * bool(idle)
        text = f"{self.name} has {count} of freedom, and {', '.join(self.actuated)} determines {spans} of them{why}"
        text += (
            f"; the undetermined motion is mostly in {', '.join(most)}: name more actuated joints, or fix a "
            "floating base by"
        )
        raise InputError(f"{text} a joint to the ground")

    # Jacobian and efforts ---------------------------------------------------------------------------------------

    def transmission(self, position: Position | None = None) -> Transmission:
        """Return the Jacobian from actuated rates to rates of the watched values, and the singularity of a position.

        The rates of a point are its velocity [m/s], those of a body in space the velocity of its centre of mass and its
        angular velocity [rad/s], all in ground axes.
        """
        loops, y = self._loops, self._begin(position)
        by_y, spins = loops.look(y)[1:3]
        names, table = list[str](), list[Vector]()
        for name, own in self.watched.items():
            turned = [k for k, each in enumerate(self._of.spins) if each.startswith(f"{name}.angular_velocity.")]
            own = [k for k in own if not (turned and k[:-1] == f"{name}.e")]
            names += [*own, *(self._of.spins[k] for k in turned)]
            table += [*by_y[[self._of.place[k] for k in own]], *spins[turned]]
        of_m = np.array([self.units.get(name) == "m" for name in names], bool)
        lengths, columns = np.where(of_m, 1 / self.size, 1.0), loops.weights[self._rows]
        frame, sizes = np.array(table).reshape(len(names), loops.moving), loops.sizes(y)
        N, x = loops.lasting(y), loops.rates(y, self._rows)
        rank = self._spans([self._of.place[k] for own in self.watched.values() for k in own])
        seen = np.linalg.svd(lengths[:, None] * (frame @ N), compute_uv=False)
        constraint = float(sizes[-1] / sizes[0]) if loops.closing else 1.0
        parallel = float(np.linalg.svd(x, compute_uv=False)[self.freedom - 1])
        matrix = np.full((len(names), len(x)), np.nan)
        s = np.full(min(matrix.shape), np.nan)
        if min(constraint, parallel) > SINGULAR and len(names):
            matrix = (frame @ N) @ np.linalg.pinv(x) * columns
            left = lengths if 0 < of_m.sum() < len(of_m) else np.ones(len(names))
            right = columns if len({self._of.units[i] for i in self._rows}) > 1 else np.ones(len(x))
            s = np.linalg.svd(left[:, None] * matrix / right, compute_uv=False)
        serial = float(seen[rank - 1]) if rank else math.nan
        product = float(np.prod(s[:rank])) if rank else math.nan
        return Transmission(tuple(names), self.actuated, matrix, s, product, constraint, parallel, serial, self.size)

    def efforts(
        self, position: Position | None = None, rates: Values = None, accelerations: Values = None
    ) -> dict[str, float]:
        """Return the efforts of the actuators [N.m or N] at a position for rates and accelerations of their joints.

        Rates and accelerations are zero by default, so that efforts compensate gravity and springs. Loads, springs,
        dampers and inputs act as declared, and end stops that the position violates (`position.beyond`). Dry friction,
        and drives and motions of the actuated joints, are left out.
        Redundant actuators share the load with the least norm of moments and forces times `size`. Raises InputError at
        a singular position.
        """
        where, loops = self._where, self._loops
        y, found = self._begin(position), self.transmission(position)
        if kinds := [kind for kind in found.singular if kind != "serial"]:
            value = f"{kinds[0]} {getattr(found, kinds[0]):.2g}, singular at or below {SINGULAR:g}"
            text = f"{self.name}: the position is a {kinds[0]} singularity ({value})"
            text += ", where efforts and rates do not follow from the actuated joints;"
            raise InputError(f"{text} take a position beside it")
        s, a = self._motion(y, rates, accelerations)
        left = where.value("M", s) @ a + where.value("d", s) - where.value("f", s)
        load = loops.lasting(y).T @ (loops.scale * left)[: loops.moving]
        tau = np.linalg.lstsq(loops.rates(y, self._rows).T, load, rcond=None)[0] * loops.weights[self._rows]
        return dict(zip(self.actuated, tau.tolist(), strict=True))

    def _motion(self, y: Vector, rates: Values, accelerations: Values) -> tuple[State, Vector]:
        """Return the state and accelerations (n,) for rates and accelerations of the actuated joints."""
        where, loops, n, held = self._where, self._loops, self._loops.moving, self._where.held
        s = where.at_rest(y * loops.scale)
        v, a = s.v.copy(), np.zeros(len(s.v))
        moved = where.value("Phi_dot", s)[held] if where.equations.timed else np.zeros(int(held.sum()))

        def solved(what: str, given: Values, of_loops: Vector, free: Vector) -> Vector:
            rows, goal = self._given(given, np.zeros(len(self._rows)))
            steered = loops.steered(rows, goal, self.freedom)
            right = np.append(of_loops / where.units[held], (goal - free[rows]) * loops.weights[rows])
            found = steered.ahead(y, right)
            missed = np.abs(steered.matrix(y)[:, :n] @ found - right).max(initial=0.0)
            if missed > AGREES * max(1.0, np.abs(right).max(initial=0.0)):
                text = f"{self.name}: the {what} of {', '.join(self.actuated)} contradict each other by {missed:.2g}"
                raise InputError(f"{text}; give those of {counted(self.freedom, 'joint')} alone")
            return found * loops.scale[:n]

        v[:n] = solved("rates", rates, -moved, loops.look(y)[3])
        s = replace(s, v=v)
        a[:n] = solved("accelerations", accelerations, where.value("xi", s)[held], loops.look(y, v)[4])
        return s, a

    def along(self, motion: Mapping[str, Signal], times: Sequence[float] | Vector | None = None) -> Result:
        """Return efforts along a motion of the actuated joints, as a result with columns by name.

        `motion` gives joints as tables (times, values) [s; rad or m] of six points or more, interpolated by a spline of
        fifth degree; the other joints rest. Rows are at `times` [s], by default those of the first table. Columns
        are displacements, `der(NAME)`, `der(NAME,2)`, efforts `NAME.torque` or `NAME.force`, and all values.
        """
        from scipy.interpolate import make_interp_spline

        laws: dict[str, Any] = {}
        for name, signal in by_name(self.name, "motion", motion).items():
            self._index(name)
            pair = signal if isinstance(signal, tuple | list) and len(signal) == 2 else ((), ())
            t, x = (self._numbers(f"the motion of {name}", each) for each in pair)
            if len(t) != len(x) or len(t) < 6 or np.any(np.diff(t) <= 0):
                text = f"{self.name}: the motion of {name} has {len(t)} times and {len(x)} values"
                raise InputError(f"{text}; give a table (times, values) of 6 points or more, at rising times")
            laws[name], times = make_interp_spline(t, x, k=5), t if times is None else times
        if not laws:
            raise InputError(f"{self.name}: no joint moves; give tables (times, values) of actuated joints by name")
        instants, position, rows = self._numbers("times", times), self.start, []
        for name, law in laws.items():
            if instants.min() < law.t[0] or instants.max() > law.t[-1]:
                text = f"{self.name}: the motion of {name} is given from {law.t[0]:g} to {law.t[-1]:g} s, and times"
                raise InputError(f"{text} go from {instants.min():g} to {instants.max():g} s; give it for all of them")
        positions = list[Position]()
        for t in instants:
            given, v, a = ({name: float(law(t, k)) for name, law in laws.items()} for k in range(3))
            position = self.forward(given, position)
            tau = self.efforts(position, v, a)
            rows.append([f.get(k, 0.0) for f in (position.actuated, v, a, tau) for k in self.actuated])
            positions.append(position)
        names = [form.format(k) for form in ("{}", "der({})", "der({},2)") for k in self.actuated]
        own = [self.units[k] for k in self.actuated]
        names += [f"{k}.{'torque' if unit == 'rad' else 'force'}" for k, unit in zip(self.actuated, own, strict=True)]
        units = [*own, *map(rate_of, own), *(rate_of(rate_of(u)) for u in own), *(EFFORTS.get(u, "1") for u in own)]
        columns = dict(zip(names, zip(units, np.array(rows).T, strict=True), strict=True))
        return self._result(instants, columns, positions, {})

    def _result(
        self, time: Vector, columns: Columns, positions: Sequence[Position], facts: Mapping[str, Any]
    ) -> Result:
        """Return a result of columns (unit, values) and of all other values of positions, with turns counted."""
        table, wrapped = np.array([list(each.values.values()) for each in positions]), self._of.wrapped
        table[:, wrapped] = np.unwrap(table[:, wrapped], axis=0)
        values = zip(self._of.names, self._of.units, table.T, strict=True)
        every = {**columns, **{name: (unit, x) for name, unit, x in values if name not in columns}}
        every["monitor.position_error"] = "1", [each.gap for each in positions]
        known = {"mechanism": self.name, "parameters": self._where.parameters, **facts}
        units, data = {k: unit for k, (unit, _) in every.items()}, np.array([x for _, x in every.values()], float).T
        return Result(self.name, time, tuple(every), units, data, facts=known, declared=self._declared)

    def said(
        self, places: Sequence[Position], table: Result | None, *motion: Values
    ) -> tuple[dict[str, Any], list[str]]:
        """Return positions with Jacobians and efforts, and a table of `cycle` or `along`, as data and as text."""
        units, data, watched = self.units, [], [k for own in self.watched.values() for k in own]
        lines = [f"{self.name}: {counted(self.freedom, 'degree')} of freedom, actuated: {', '.join(self.actuated)}"]
        lines += [f"{counted(len(places), 'solution')} found"] * (len(places) != 1)
        for position in places:
            seen = self.transmission(position)
            held = seen.singular in ((), ("serial",))
            tau = self.efforts(position, *motion) if held else {}
            data.append(_plain(position) | {"efforts": tau, "singular": seen.singular, "transmission": _plain(seen)})
            lines += [", ".join(f"{k} = {plain(x, units[k])}" for k, x in position.actuated.items())]
            pushed = ", which pushes against the efforts" * held
            lines += [f"beyond {name} by {x:.4g}{pushed}" for name, x in position.beyond.items()]
            lines += [f"  {k} = {position.values[k] + 0.0:.6g} {units[k]}" for k in watched]
            texts = (f"{k} {x + 0.0:.6g} {EFFORTS.get(units[k], '1')}" for k, x in tau.items())
            lines += [*seen.lines(), *["efforts: " + ", ".join(texts)] * held]
        more: dict[str, Any] = {"mechanism": self.name, "freedom": self.freedom, "positions": data, "notes": self.notes}
        if table is not None:
            more |= {"table": dict(zip(table.names, _plain(table.values.T), strict=True))}
            more |= {k: table.facts[k] for k in ("dead", "toggles") if k in table.facts}
            lines += [f"table of {len(table.time)} rows:"]
            for k in (k for k in table.names if k not in self._of.place or k in watched):
                if len(x := table[k][np.isfinite(table[k])]):
                    lines += [f"  {k:<28} {x.min():12.6g} to {x.max():12.6g} {table.units[k]}"]
            first, turns = table.names[0], table.facts.get("toggles", {})
            turns = {k: x for k, x in {first: table.facts.get("dead"), **turns}.items() if x}
            lines += [f"{k} turns back at {first} = {', '.join(f'{x:.9g}' for x in xs)}" for k, xs in turns.items()]
        return more, [*lines, *self.notes]

    # Cycles -----------------------------------------------------------------------------------------------------

    def cycle(
        self,
        joint: str | None = None,
        *,
        near: Position | None = None,
        span: tuple[float, float] | None = None,
        rows: int = 181,
        transmission: str | None = None,
    ) -> Result:
        """Return a motion of one actuated joint, by default the first, at unit rate [rad/s or m/s]; the others rest.

        The joint makes as many turns as bring the loops back, moves between its dead positions, or over `span` [rad or
        m]. Columns: the joint, all values, rates of watched values (`tool.x/A`, per unit of the joint),
        `tool.advantage` (mechanical advantage: the force along the path of the watched point over the effort of the
        joint), `transmission_angle` [rad] at the hinge `transmission` (by default the one between a coupler and a
        driven link on the ground), `manipulability`, and the numbers of `Transmission`. `facts` has `dead`,
        displacements at which the joint turns back, and `toggles`, by name the displacements at which a watched point
        or value turns back; plots mark them.
        """
        at = 0 if joint is None else self._index(joint)
        joint, begin = self.actuated[at], self.start if near is None else near
        self._whole("rows", rows, 2)
        angle_of = self._hinge_angle(transmission)
        ends: dict[float, Position] = {}
        if span is None:
            low, high, ends = self._range(at, begin)
        else:
            low, high = self._numbers("span", span, 2)
            if low >= high:
                raise InputError(f"{self.name}: span is {shown(span)}; give two values of {joint}, the lower one first")
        grid, unit = np.linspace(low, high, rows), self.units[joint]
        fixed = {self.actuated[k]: begin.actuated[self.actuated[k]] for k in self._others(at)}

        found = dict(ends)
        middle = int(np.argmin(np.abs(grid - begin.actuated[joint])))
        for way in (range(middle, rows), range(middle - 1, -1, -1)):
            near = begin  # not a dead position, from which straight lines lead nowhere
            for x in (grid[k] for k in way if grid[k] not in ends):
                try:
                    found[x] = near = self.forward({**fixed, joint: x}, near)
                except InputError as error:
                    if span is not None:
                        raise
                    reached = f"between {joint} = {plain(begin.actuated[joint], unit)} and {plain(x, unit)}"
                    why = f"for a cycle, assemblies meet {reached} {unit}; give a span on one side (span=, --span)"
                    raise InputError(f"{error}; {why}") from error
        positions = [found[x] for x in grid]
        seen = [self.transmission(each) for each in positions]
        columns: Columns = {joint: (unit, grid)}
        toggles: dict[str, list[float]] = {}
        for name, own in self.watched.items():
            speeds = np.array([self._speeds(own, at, each) for each in positions])
            columns |= {f"{k}/{joint}": (quotient(self.units[k], unit), x) for k, x in zip(own, speeds.T, strict=True)}
            path = [i for i, k in enumerate(own) if self.units[k] == "m"] or [0]
            with np.errstate(divide="ignore"):
                advantage = 1 / np.linalg.norm(speeds[:, path], axis=1)
            columns[f"{name}.advantage"] = quotient(unit, self.units[own[path[0]]]), advantage
            if turns := self._toggles(at, grid, positions, [own[i] for i in path], speeds[:, path]):
                toggles[name] = turns
        if angle_of is not None:
            columns["transmission_angle"] = "rad", [angle_of(each) for each in positions]
        for kind in ("manipulability", "constraint", "parallel", "serial"):
            columns[kind] = "1", [getattr(each, kind) for each in seen]
        axis = f"{joint} from {plain(low, unit)} [{unit}]"
        marks = [float(x - low) for x in (*ends, *(x for each in toggles.values() for x in each))]
        facts = {"dead": sorted(ends), "toggles": toggles, "axis": axis, "marks": marks}
        return self._result(grid - low, columns, positions, facts)

    def _speeds(self, names: Sequence[str], at: int, position: Position) -> Vector:
        """Return rates of values per rate of one actuated joint; NaN if the actuated joints do not determine them."""
        loops, y, rows = self._loops, self._begin(position), [self._of.place[name] for name in names]
        x = loops.rates(y, self._rows)
        if np.linalg.svd(x, compute_uv=False)[self.freedom - 1] <= SINGULAR:
            return np.full(len(rows), np.nan)
        ratio = loops.weights[self._rows[at]] / loops.weights[rows]
        return np.asarray(loops.rates(y, rows) @ np.linalg.pinv(x)[:, at] * ratio)

    def _others(self, at: int) -> list[int]:
        """Return actuated joints, as few as possible, that determine the motion together with one of them."""
        found = [at]
        for k in range(len(self._rows)):
            if self._spans([self._rows[i] for i in (*found, k)]) > len(found):
                found.append(k)
        return found[1:]

    def _toggles(
        self, at: int, grid: Vector, positions: Sequence[Position], names: Sequence[str], speeds: Matrix
    ) -> list[float]:
        """Return displacements of a joint at which a point or a value turns back, between rows with opposite rates."""
        from scipy.optimize import brentq

        found, fixed = [], {self.actuated[k]: positions[0].actuated[self.actuated[k]] for k in self._others(at)}
        for k in np.flatnonzero((speeds[:-1] * speeds[1:]).sum(axis=1) < 0).tolist():

            def speed(x: float, near: Position = positions[k]) -> Vector:
                return self._speeds(names, at, self.forward({**fixed, self.actuated[at]: x}, near))

            way = speeds[k] - speeds[k + 1]
            x = float(brentq(lambda x, s=speed, w=way: s(x) @ w, grid[k], grid[k + 1], xtol=1e-14, rtol=1e-14))
            if np.linalg.norm(speed(x)) <= SINGULAR * np.nanmax(np.abs(speeds)):
                found.append(x)
        return found

    def _range(self, at: int, begin: Position) -> tuple[float, float, dict[float, Position]]:
        """Return the range of a joint (turns that bring the loops back, or the way between dead positions) and its dead
        positions."""
        from scipy.optimize import brentq

        if "constraint" in self.transmission(begin).singular:
            text = f"{self.name}: the cycle begins at a constraint singularity, where several motions begin"
            raise InputError(f"{text}; give a position beside it as near=")
        row, others, start = self._rows[at], [self._rows[k] for k in self._others(at)], begin[self.actuated[at]]
        y0, unit = self._begin(begin), self._of.units[row]
        loops = self._loops.steered(others, self._loops.look(y0)[0][others], self.freedom - 1)
        turn = 2 * math.pi if unit == "rad" else math.inf
        ends: dict[float, Position] = {}

        def speed(y: Vector, way: Vector) -> float:
            """Return the rate of the joint for the motion in this direction."""
            t = loops.motions(y, 1)[:, 0]
            return float(loops.look(y)[1][row] @ t[: loops.moving]) * (float(np.sign(t @ way)) or 1.0)

        def step(a: Vector, b: Vector) -> float:
            x = float(loops.look(b)[0][row] - loops.look(a)[0][row])
            return math.remainder(x, 2 * math.pi) if unit == "rad" else x

        def middle(part: float, a: Vector, b: Vector) -> Vector:
            y = loops.closed(a + part * (b - a), a)
            return a if y is None else y

        def is_back(y: Vector) -> bool:
            """Return whether loops are as at the beginning; a screw, a rack or a gear may have moved them on."""
            here, there = (np.abs(loops.matrix(each)) for each in (y, y0))  # Euler parameters may change their signs.
            return bool(np.abs(here - there).max(initial=0.0) <= ALIKE * there.max(initial=0.0))

        first = loops.motions(y0, 1)[:, 0]
        first *= np.sign(speed(y0, first)) or 1.0
        for sign in (1, -1):
            a, moved = y0, 0.0
            for b in loops.walk(y0, sign * first, PACE, MOST):
                if sign * speed(b, b - a) < 0:
                    part = brentq(lambda t, a=a, b=b: speed(middle(t, a, b), b - a), 0.0, 1.0, xtol=1e-15, rtol=1e-15)
                    y = middle(float(part), a, b)
                    ends[start + moved + step(a, y)] = self._position(y)
                    break
                before, moved = moved, moved + step(a, b)
                turns = abs(moved) // turn
                if not ends and turns > abs(before) // turn:
                    left = sign * turns * turn - before
                    part = brentq(lambda t, a=a, b=b, x=left: step(a, middle(t, a, b)) - x, 0.0, 1.0, xtol=1e-15)
                    if is_back(middle(float(part), a, b)):
                        return start, start + turns * turn, {}
                a = b
            else:
                text = f"{self.name}: {self.actuated[at]} has no dead position up to {plain(moved, unit)} from here"
                raise InputError(f"{text}; give the range as span=")
        return min(ends), max(ends), ends

    def _hinge_angle(self, named: str | None) -> Callable[[Position], float] | None:
        """Return the angle [rad] between the links at a hinge, or between a link and the normal of a guide."""
        m, ground = self._declared, (self._declared.ground, self._declared.spatial_ground)
        joints: list[Any] = [*m.joints, *m.spatial_joints]

        def beside(joint: Any) -> list[Any]:
            """Return the other joints of its two bodies, if each has one."""
            bodies = joint.first.body, joint.second.body
            found = [[x for x in joints if x is not joint and b in (x.first.body, x.second.body)] for b in bodies]
            return [x[0] for x in found] if [len(x) for x in found] == [1, 1] else []

        def leads(joint: Any) -> bool:
            """Return whether this joint connects a coupler with a link on the ground that is not actuated."""
            fixed = [x for x in beside(joint) if x.first.body in ground or x.second.body in ground]
            driven = any(_belongs(x, name) for x in fixed for name in self.actuated)
            return len(fixed) == 1 and not driven and joint.first.body not in ground

        found = [j for j in joints if (leads(j) if named is None else j.name == named)]
        if named is None and len(found) != 1:
            return None
        if not found:
            raise InputError(f"{self.name} has no joint {named!r}; {there_is(named, [j.name for j in joints])}")
        (hinge,), places = found, m._kinematics()
        if not (links := beside(hinge)):
            text = f"{self.name}: {hinge.name} has no transmission angle: it does not join two links of two joints"
            raise InputError(f"{text} each; name another hinge")

        def place(at: Any) -> ca.SX:
            return ca.vertcat(*places.place(at), 0) if isinstance(at, Marker) else at.place

        ways = list[ca.SX]()
        for body, other in zip((hinge.first.body, hinge.second.body), links, strict=True):
            if other.kind == "prismatic":
                ways += [ca.vertcat(*places.axes(other)[:2], 0) if isinstance(other, Joint) else other.triad()[2]]
            else:
                ways += [place(hinge.first) - place(other.first if other.first.body is body else other.second)]
        across, along = ca.norm_2(ca.cross(ways[0], ways[1])), ca.fabs(ca.dot(ways[0], ways[1]))
        angle = ca.atan2(along, across) if any(x.kind == "prismatic" for x in links) else ca.atan2(across, along)
        q = ca.vertcat(*(c.q for c in m.coordinates), *([m.time] if self._where.equations.timed else []))
        p, count = stack([x.symbol for x in m.parameters]), len(m.parameters)
        run = ca.Function("angle", [q, p], [angle], {"allow_free": True})
        return None if run.has_free() else lambda position: float(run(position.q, self._where.p[:count]))


def _plain(x: Any) -> Any:
    """Return an object or numbers as data for JSON, with None for NaN and infinity."""
    if isinstance(x, Position | Transmission):
        return {name: _plain(each) for name, each in vars(x).items()}
    return np.where(np.isfinite(x), x, np.array(None)).tolist() if isinstance(x, float | np.ndarray) else x


def _belongs(joint: Any, name: str) -> bool:
    """Return whether a name of an actuated joint is that of this joint or of its coordinate."""
    whole = getattr(joint, "joint", joint)
    own = [getattr(joint, "coordinate", None), *(getattr(whole, "coordinates", None) or ())]
    if whole is not joint and len(own) > 1:
        own = [own[1 + list(whole.freedoms).index(joint.which)]]
    named = [str(x) for x in own if isinstance(x, ca.SX) and x.is_symbolic()]
    return name in (joint.name, f"{joint.name}.angle", f"{joint.name}.displacement", *named)


def kinematics(
    mechanism: str | Path | Mechanism | Any,
    actuated: Sequence[str] | None = None,
    watch: Sequence[str] | None = None,
    *,
    parameters: Mapping[str, float | str] | None = None,
    inputs: Mapping[str, Signal] | None = None,
    time: float = 0.0,
) -> Kinematics:
    """Return the kinematics and inverse dynamics of a mechanism by its actuated joints, with loops of any kind.

    `mechanism` is a mechanism or recipe as for `simulate`, but no FMU and no equations. `actuated` names joints with
    one free motion, single motions of other joints (`joint.angle1`), or coordinates; by default joints with a drive,
    such as a motor, or a motion. Their drives, motions and generalised forces are left out. `watch` names points,
    bodies, joints or outputs whose Jacobian is wanted, by default the watched points. `parameters` sets parameters,
    start values and inputs by name; `inputs` and laws of time are taken at `time` [s].

    Raises InputError if the actuated joints do not determine the motion, with the degrees of freedom measured, and
    AlfmuError if a name or a value is invalid, or the loops cannot be closed.
    """
    whole = source(mechanism, parameters or {})
    declared = whole.drawn()
    own = [*(x.joint.name for x in declared.drives), *(x.name for x in declared.closures if isinstance(x, Motion))]
    names = list(dict.fromkeys(own)) if actuated is None else names_in(whole.name, "actuated joints", actuated)
    if not names:
        every: list[Any] = [*declared.joints, *declared.spatial_joints, *declared.coordinates]
        some = ", ".join([each.name for each in every if getattr(each, "kind", "") not in _UNMOVED][:4])
        raise InputError(f"{whole.name}: no joint is actuated by a drive or a motion; name those: actuated={some}")
    m, moved = _undriven(declared, names)
    where = begun(source(m, whole.given), {}, inputs or {}, time)
    home = begun(whole, {}, inputs or {}, time).state.q if moved else where.state.q
    points = [x.name for x in declared.watched] if watch is None else names_in(whole.name, "watched places", watch)
    return Kinematics(where, m, names, points, home)


def _undriven(declared: Mechanism, names: Sequence[str]) -> tuple[Mechanism, bool]:
    """Return a mechanism with all joints measured, without drives and motions of the actuated ones, and whether motions
    were removed."""
    m = copy(declared)

    def drives(of: Any, name: str = "") -> bool:
        return name in names or any(_belongs(of, each) for each in names if not isinstance(of, ca.SX))

    gone = [x for x in m.closures if isinstance(x, Motion) and drives(x.of, x.name)]
    laws, named = {f"the motion of {x.name}" for x in gone}, {key_of(c.q) for c in m.coordinates if c.name in names}
    m._parts = {name: [*each] for name, each in declared._parts.items()}
    ends = [end for each in FREE.values() for end in each]
    every: list[Any] = [*m.joints, *m.spatial_joints]
    hidden = {f"{j.name}.{end}" for j in every if drives(j) for end in ends} & {x.name for x in m.outputs}
    m._names = {name: what for name, what in m._names.items() if name not in hidden}
    m._parts["outputs"] = [x for x in m.outputs if x.name not in hidden]
    m.measures_all = True
    m._parts["measured"], m.measures_all = [*m.measured, *m.measured_joints()], declared.measures_all
    m._parts["closures"] = [x for x in m.closures if not any(x is each for each in gone)]
    m._parts["laws"] = [x for x in m.laws if x.what not in laws]
    m._parts["drives"] = [x for x in m.drives if not drives(x.joint)]
    m._parts["generalized"] = [x for x in m.generalized if key_of(x[0]) not in named]
    return m, bool(gone)
