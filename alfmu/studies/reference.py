"""Reference motion of a mechanism by an unrelated method at the accuracy of double precision, to judge studies.

The equations of motion (4) under the constraints (1) are reduced to independent coordinates y, in which they are
ordinary differential equations, and solved by SciPy with tolerances near round-off. Nothing of the augmented-Lagrangian
method, of its penalties or of its projections is used. There are two reductions:

NullSpace  y are components along the null space of C at some position, q(y) closes the constraints by Newton's method
           to round-off at every evaluation (coordinate partitioning by singular values). If the basis becomes oblique
           it is replaced. The motion ends before a singular position, where the null space is ambiguous.
Placement  q(y) is the guess that the declaration computes from its start values, if it satisfies the constraints
           everywhere: then it is the branch of the motion in closed form, and passes singular positions.
"""

import time
from bisect import bisect_left
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, Protocol

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from scipy.integrate import DOP853, Radau

from ..equations import Equations
from ..equations.arrays import ArrayFunction, ArrayFunctions
from ..equations.evaluation import shared, symbols, with_functions
from ..runtime import Instance

SINGULAR = 0.02
"""Smallest singular value of the independent constraints, over the largest, below which a null space is ambiguous."""

READABLE = 0.03
"""Ratio as SINGULAR, below which reactions are not judged: they lose digits with its inverse, and may have a pole."""

NOTHING = 1e-12
"""Ratio as SINGULAR, below which a singular value counts as zero."""

OBLIQUE = 1.5
"""Factor by which the basis stretches a unit displacement, along or across the motion, above which it is replaced."""

NEWTON = 12
"""Largest number of Newton corrections that close the constraints at an evaluation."""

CLOSED = 1e-11
"""Largest constraint residual [m, rad] of a placement."""

LITTLE = 1e-4
"""Displacement of lengths [m] to a position near the start, where C has its typical magnitude."""

BESIDE = 1e-9
"""Distance [m, rad; per s] of a start from its placement due to round-off and assembly."""

POINTS, CONSERVED = 30, 1e-9
"""Number of positions at which the energy is checked, and the relative change up to which it is conserved."""

TURN = 2 * np.pi


METHODS = {DOP853: 1.0, Radau: 1e3}
"""Integrators of SciPy in the order of use, and factors on their tolerances."""


@dataclass(frozen=True)
class Effort:
    """Accuracy of a reference, and its time limit."""

    fine: float = 1e-13
    """Relative and absolute tolerance of the reference."""
    coarse: float | None = 1e-12
    """Tolerance of the run for comparison; None for none."""
    parts: int = 200
    """Least number of steps, so that interpolation is as accurate as the steps."""
    seconds: float = 15.0
    """Wall time limit of one integration."""


class _Stopped(Exception):
    """An integration cannot continue, for the given reason."""


class _Far(_Stopped):
    """A trial step is too long to close the constraints, and must be shortened."""


class _Model:
    """The equations of a started instance, with its parameters and inputs, as arrays in q, v and t."""

    def __init__(self, instance: Instance):
        e = instance.equations
        backend = ArrayFunctions(_with_placement(e))
        signatures, self.outputs = backend.equations.signatures, len(e.outputs)
        self._dynamics, self._constraints, self._readings, self._energy, self._placement = (
            ArrayFunction(backend, name, signatures[name])
            for name in ("dynamics", "constraints", "readings", "energy", "placement")
        )
        self._shares: Any = None if e.compliances else e.functions["shares"]
        self.p, self.u = instance.memory["p"].copy(), instance.inputs.copy()
        self.held = np.flatnonzero(instance.penalty)
        self.freedom = instance.mobility().freedom
        self.q, self.v = instance.q.copy(), instance.v.copy()
        self.starts = np.array([instance.get(v.name) for v in e.starts])
        self.rates = np.array([instance.get(v.name) for v in e.start_rates])
        self.tied = list(e.tied)
        self.turns = np.array([c.unit == "rad" for c in e.coordinates])
        beside = np.random.default_rng(0).standard_normal(e.n) * np.where(self.turns, 1.0, LITTLE)
        self.largest = max(_size(self.constraints(place)[0].copy()) for place in (self.q, self.q + beside))

    @property
    def rank(self) -> int:
        """Number of independent constraints at regular positions."""
        return len(self.q) - self.freedom

    def constraints(self, q: NDArray) -> tuple[NDArray, NDArray]:
        """Return C and Phi of the constraints in force."""
        _, C, Phi, _ = self._constraints(q, np.zeros_like(q), self.p)
        return _dense(C)[self.held], Phi[self.held]

    def dynamics(self, q: NDArray, v: NDArray, t: float) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return M, C, F, xi of (3) and (4)."""
        M, C, F, xi = self._dynamics(q, v, self.u, self.p, t)
        return _dense(M), _dense(C)[self.held], F, xi[self.held]

    def placement(self, x: NDArray, rate: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """Return q for independent start values x, its derivative J, and the part of its acceleration due to rates."""
        starts, rates = self.starts.copy(), np.zeros_like(self.starts)
        starts[self.tied], rates[self.tied] = x, rate
        J, q, bend = self._placement(self.p, starts, rates)
        return q.copy(), J.reshape((len(q), -1), order="F")[:, self.tied], bend.copy()

    def narrowness(self, q: NDArray) -> float:
        """Return the smallest singular value of the independent constraints over the largest near the start; 1 without
        any."""
        if not self.rank:
            return 1.0
        return float(np.linalg.svd(self.constraints(q)[0], compute_uv=False)[self.rank - 1] / self.largest)

    def readings(self, q: NDArray, v: NDArray, a: NDArray, t: float) -> NDArray:
        """Return all outputs at a state of the motion.

        Multipliers satisfy C' lam = F - M a with least loads of joints, or have least norm if compliances share loads.
        """
        M, C, F, _ = self.dynamics(q, v, t)
        lam = np.zeros(self._readings.x[3].size)
        if len(self.held):
            basis, sizes, rows = np.linalg.svd(C.T)
            r = min(self.rank, int((sizes > NOTHING * sizes[0]).sum()))
            lam[self.held] = rows[:r].T @ (basis[:, :r].T @ (F - M @ a) / sizes[:r])
            if self._shares and r < len(rows):

                def slope(lam: NDArray) -> NDArray:
                    return np.array(self._shares(q, v, a, lam, self.u, self.p, t)).ravel()

                free, here = np.zeros((len(lam), len(rows) - r)), slope(lam)
                free[self.held] = rows[r:].T
                by_free = np.column_stack([slope(lam + each) - here for each in free.T])
                lam -= free @ np.linalg.lstsq(free.T @ by_free, free.T @ here, rcond=None)[0]
        return self._readings(q, v, a, lam, self.u, self.p, t)[0].copy()

    def energy(self, q: NDArray, v: NDArray) -> float:
        """Return kinetic and potential energy [J]."""
        return float(self._energy(q, v, self.p)[0][0])


class _Reduction(Protocol):
    """A mechanism in independent coordinates; y contains them and their rates."""

    def reduced(self, t: float, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Return q, v, a, and the accelerations of the independent coordinates."""

    def spent(self, y: NDArray) -> bool:
        """Return whether another reduction must replace this one."""


class _NullSpace:
    """Reduction to components along the null space of C at a position."""

    name = "null space of C"

    def __init__(self, model: _Model, q: NDArray):
        self.model, self.r = model, model.rank
        C, _ = model.constraints(q)
        left, sizes, right = np.linalg.svd(C) if C.size else (np.eye(0), np.ones(1), np.eye(len(q)))
        if self.r and sizes[self.r - 1] < SINGULAR * model.largest:
            raise _Stopped("a singular position")
        self.rows, self.along, self.center = left[:, : self.r].T, right[self.r :], q
        self.usual = 1 / sizes[self.r - 1] if self.r else np.inf
        self.side = np.linalg.slogdet(self._matrix(C))[0]

    @classmethod
    def begun(cls, model: _Model, q: NDArray, v: NDArray) -> tuple[_Reduction, NDArray]:
        """Return the reduction at a state, and its y."""
        chart = cls(model, q)
        return chart, np.concatenate([np.zeros(len(chart.along)), chart.along @ v])

    def reduced(self, t: float, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        place, rate = np.split(y, 2)
        q, inverse = self._closed(place)
        inward, tangent = inverse[:, : self.r], inverse[:, self.r :]
        v = tangent @ rate
        M, _, F, xi = self.model.dynamics(q, v, t)
        bend = inward @ (self.rows @ xi)
        second = np.linalg.solve(tangent.T @ M @ tangent, tangent.T @ (F - M @ bend))
        return q, v, bend + tangent @ second, second

    def spent(self, y: NDArray) -> bool:
        q, inverse = self._closed(np.split(y, 2)[0])
        inward, tangent = (_size(x) for x in (inverse[:, : self.r], inverse[:, self.r :]))
        return tangent > OBLIQUE or inward > OBLIQUE * self.usual or self.model.narrowness(q) < SINGULAR

    def _matrix(self, C: NDArray) -> NDArray:
        """Return the matrix of Newton's method; its determinant changes sign at singular positions, even if a step
        jumps over one."""
        return np.vstack([self.rows @ C, self.along])

    def _closed(self, place: NDArray) -> tuple[NDArray, NDArray]:
        """Return the q with these components that satisfies the constraints, by Newton's method, and the inverse of the
        method's matrix."""
        q = self.center + place @ self.along
        for _ in range(NEWTON):
            C, Phi = self.model.constraints(q)
            inverse = np.linalg.inv(self._matrix(C))
            dq = inverse @ np.concatenate([self.rows @ Phi, self.along @ (q - self.center) - place])
            q = q - dq
            if np.abs(dq).max() <= 1e-13 * (1 + np.abs(q).max()):
                if np.linalg.slogdet(inverse)[0] != self.side:
                    raise _Stopped("a singular position")
                return q, inverse
        raise _Far("a position where Newton's method does not close the constraints")


class _Placement:
    """The coordinates in closed form of the start values, as given by the declaration."""

    name = "placement of the declaration"

    def __init__(self, model: _Model):
        self.model = model
        if not model.freedom or len(model.tied) != model.freedom:
            raise _Stopped("start values that are not the independent coordinates")

    @classmethod
    def begun(cls, model: _Model, q: NDArray, v: NDArray) -> tuple[_Reduction, NDArray]:
        """Return the reduction at the start, and its y."""
        placed = cls(model)
        x, rate = model.starts[model.tied], model.rates[model.tied]
        there, J, _ = model.placement(x, rate)
        gap = there - q
        gap = np.where(model.turns, gap - TURN * np.round(gap / TURN), gap)
        if not max(np.abs(gap).max(), np.abs(J @ rate - v).max()) < BESIDE * (1 + np.abs(rate).max()):
            raise _Stopped("a start elsewhere than the declaration places it")
        return placed, np.concatenate([x, rate])

    def reduced(self, t: float, y: NDArray) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        place, rate = np.split(y, 2)
        q, J, bend = self.model.placement(place, rate)
        if not np.abs(self.model.constraints(q)[1]).max(initial=0.0) < CLOSED:
            raise _Stopped("a placement that does not close the constraints")
        v = J @ rate
        M, _, F, _ = self.model.dynamics(q, v, t)
        second = np.linalg.solve(J.T @ M @ J, J.T @ (F - M @ bend))
        return q, v, bend + J @ second, second

    def spent(self, y: NDArray) -> bool:
        return False


@dataclass
class _Motion:
    """A motion over time, in pieces of one reduction each."""

    model: _Model
    way: type[_NullSpace] | type[_Placement]
    method: str
    tolerance: float
    ends: list[float]
    pieces: list[tuple[Callable[[float], NDArray], _Reduction]]
    why: str = ""
    """Reason for an early end."""

    @property
    def until(self) -> float:
        return self.ends[-1] if self.ends else 0.0

    @property
    def stiff(self) -> bool:
        """Whether an explicit method took too long."""
        return self.method == Radau.__name__

    def knows(self, t: float) -> bool:
        """Return whether a time is in the motion, up to round-off."""
        return bool(self.ends) and t <= self.until * (1 + 1e-12)

    def at(self, t: float) -> tuple[NDArray, NDArray, NDArray]:
        """Return q, v, a at a time in the motion."""
        interpolated, reduction = self.pieces[min(bisect_left(self.ends, t), len(self.ends) - 1)]
        return reduction.reduced(t, interpolated(t))[:3]


@dataclass
class Reference:
    """A motion and its outputs, with the errors of both: the largest difference to other computations."""

    motion: _Motion
    others: list[_Motion]
    stop: float

    @property
    def until(self) -> float:
        """Time up to which the motion is known [s]."""
        return self.motion.until

    def outputs(self, times: NDArray) -> NDArray:
        """Return all outputs (k, outputs) at times; NaN after `until`."""
        return _outputs(self.motion, times)

    def readable(self, times: NDArray) -> NDArray:
        """Return whether reactions can be judged at each time (k,): they cannot near singular positions."""
        known = [t for t in times if self.motion.knows(t)]
        near = [self.motion.model.narrowness(self.motion.at(t)[0]) < READABLE for t in known]
        return np.array([not x for x in near] + [False] * (len(times) - len(known)))

    def checks(self, times: NDArray) -> Iterator[tuple[str, NDArray]]:
        """Yield names and outputs (k, outputs) of the other computations."""
        for other in self.others:
            yield f"{other.way.name}, {other.method} {other.tolerance:.0e}", _outputs(other, times)

    def energies(self, times: NDArray) -> NDArray:
        """Return kinetic and potential energy [J] at times up to `until`."""
        return np.array([self.motion.model.energy(*self.motion.at(t)[:2]) for t in times if self.motion.knows(t)])

    def kinetic(self, times: NDArray) -> float:
        """Return the largest kinetic energy [J] at times up to `until`."""
        states = [(t, *self.motion.at(t)[:2]) for t in times if self.motion.knows(t)]
        return max(float(v @ self.motion.model.dynamics(q, v, t)[0] @ v) / 2 for t, q, v in states)

    def conserves(self) -> bool:
        """Return whether no work is done on the mechanism in this run."""
        energies = self.energies(np.linspace(0.0, self.until, POINTS))
        return bool(np.ptp(energies) <= CONSERVED * (1 + np.abs(energies).max()))


def reference(instance: Instance, stop: float, effort: Effort = Effort()) -> Reference | str:
    """Return the motion of an initialised instance from its state to `stop` [s] with constant inputs, or why there is
    none.

    The reduction that reaches further is used, or the placement if both reach the end; the other one, and a run with a
    larger tolerance, estimate its error.
    """
    e = instance.equations
    if e.states:
        return "it follows the motion of coordinates alone, and this mechanism has states"
    if e.frictions:
        return f"its equations have no dry friction, which {e.frictions[0].name} has"
    if e.slips:
        return f"it closes constraints of positions, and {e.rows[e.slips[0]].name} holds velocities alone"
    if e.timed:
        return "constraints or places depend on time, which reductions by start values do not have"
    model = _Model(instance)
    placed = _followed(model, _Placement, stop, effort.fine, effort)
    motions = [placed, _followed(model, _NullSpace, stop, effort.fine, effort, placed.stiff)]
    best = max(motions, key=lambda m: m.until)
    if not best.ends:
        return "; ".join(m.why for m in motions)
    others = [m for m in motions if m is not best]
    if effort.coarse is not None:
        others.append(_followed(model, best.way, stop, effort.coarse, effort, best.stiff))
    return Reference(best, [m for m in others if m.ends], stop)


def _followed(
    model: _Model,
    way: type[_NullSpace] | type[_Placement],
    stop: float,
    tolerance: float,
    effort: Effort,
    stiff: bool = False,
) -> _Motion:
    """Return the motion by DOP853, or by Radau with larger tolerances if that takes too long, as in stiff systems."""
    for method, looser in list(METHODS.items())[stiff:]:
        motion = _Motion(model, way, method.__name__, tolerance * looser, [], [])
        try:
            _integrate(motion, method, stop, effort)
        except (_Stopped, np.linalg.LinAlgError, ValueError) as stopped:
            motion.why = f"the {way.name} ends at {stopped}"
        except TimeoutError:
            motion.why = f"{method.__name__} takes too long on the {way.name}"
            continue
        break
    return motion


@np.errstate(all="ignore")
def _integrate(motion: _Motion, method: type, stop: float, effort: Effort) -> None:
    """Integrate with `method` from the start of the model, and renew the reduction when necessary."""
    t, q, v = 0.0, motion.model.q, motion.model.v
    longest, patience, first = stop / effort.parts, time.perf_counter() + effort.seconds, None
    while t < stop:
        reduction, y = motion.way.begun(motion.model, q, v)

        def rate(t: float, y: NDArray, reduction: _Reduction = reduction) -> NDArray:
            if time.perf_counter() > patience:
                raise TimeoutError
            try:
                return np.concatenate([y[len(y) // 2 :], reduction.reduced(t, y)[3]])
            except _Far:
                return np.full_like(y, np.nan)

        options = {"rtol": motion.tolerance, "atol": motion.tolerance, "max_step": longest, "first_step": first}
        solver = method(rate, t, y, stop, **options)
        while solver.status == "running":
            if message := solver.step():
                raise _Stopped(message)
            motion.ends.append(solver.t)
            motion.pieces.append((solver.dense_output(), reduction))
            if reduction.spent(solver.y):
                break
        t, (q, v, *_) = solver.t, reduction.reduced(solver.t, solver.y)
        first = min(solver.step_size, stop - t) or None


def _outputs(motion: _Motion, times: NDArray) -> NDArray:
    """Return all outputs of a motion at times, NaN after its end."""
    table = np.full((len(times), motion.model.outputs), np.nan)
    for row, t in zip(table, times, strict=True):
        if motion.knows(t):
            row[:] = motion.model.readings(*motion.at(t), t)
    return table


def _with_placement(equations: Equations) -> Equations:
    """Return the equations with q as a function of the start values, and its derivatives."""
    e, x = equations, symbols(equations)
    p, s, sdot = (x[k] for k in ("p", "s", "sdot"))
    q = e.guess(p, s)
    J = ca.jacobian(q, s)
    values = J, q, ca.jtimes(J @ sdot, s, sdot)
    return with_functions(e, {"placement": shared("placement", [p, s, sdot], [ca.densify(x) for x in values])})


def _size(matrix: NDArray) -> float:
    """Return the largest singular value; 0 for an empty matrix."""
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def _dense(matrix: NDArray) -> NDArray:
    return matrix if isinstance(matrix, np.ndarray) else matrix.toarray()
