"""Steps of the methods beside RK4 on NumPy arrays, with error control or without, from the oracle's accelerations.

The rules are those of `alfmu.method`; their loops stop on convergence here, and linear systems are NumPy's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, MutableSequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from alfmu.equations.arrays import ArrayFunction, ArrayFunctions
from alfmu.equations.evaluation import with_tangents
from alfmu.kernel.thresholds import FIRST_STEP
from alfmu.method import formulations as method
from alfmu.method import implicit
from alfmu.method import singular as branch
from alfmu.method.inputs import Past
from alfmu.method.stepping import (
    EXPLICIT5_SHORT,
    LEAST_BEFORE,
    LOOSER,
    SHORTEST,
    STEADY,
    Collocation,
    Explicit,
    State,
    combined,
    continued,
    explicit,
    explicit_rule,
    judged,
    landing,
    rule_beside,
    share,
)
from alfmu.model.errors import StepError
from alfmu.model.settings import FIXED
from alfmu.simulation.oracle import Instance

__all__ = ["Adaptive", "Control", "by_method", "collocation", "collocation_error"]

NEWTON = 8
"""Most iterations of Newton's method in a step."""

CONVERGED = 0.01
"""Last change of Newton's method, over the tolerance of the step: what is left after it is about its square."""

RETURNS = 4
"""Passes of the derivative of the return to the branch."""


def collocation(
    method: Collocation,
    linearise: Callable[[Any, State], tuple[State, Any]],
    correct: Callable[[list, list[State]], list[State]],
    t: Any,
    y: State,
    dt: Any,
    k: list[State],
    most: int,
    done: Callable[[list[State], list[State]], bool],
) -> tuple[State, list[State], int, bool]:
    """Return one step from y at t to t + dt by Newton's method, from a guess k of the rates at the nodes.

    `linearise` returns the rate at a time and state, and the data of its tangent J for `correct(tangents, residues)`,
    which solves x_i - dt J_i sum_j matrix_ij x_j = residue_i. Each node has its own tangent, because the direction of a
    stiff force can rotate within the step. Returns the new state, k, the iterations used, and whether
    `done(changes, k)` held within `most`.
    """
    for i in range(1, most + 1):
        places = [y + dt * combined(weights, k) for weights in method.matrix]
        found = [linearise(t + node * dt, place) for node, place in zip(method.nodes, places, strict=True)]
        changes = correct([tangent for _, tangent in found], [f - x for (f, _), x in zip(found, k, strict=True)])
        k = [x + change for x, change in zip(k, changes, strict=True)]
        if done(changes, k):
            return y + dt * combined(method.matrix[-1], k), k, i, True
    return y + dt * combined(method.matrix[-1], k), k, most, False


def collocation_error(
    method: Collocation, solve: Callable[[Any, State], State], first: State, k: list[State], dt: Any
) -> State:
    """Return an error estimate of a step from its rates, the one at the start first, damped in stiff directions.

    `solve(s, r)` returns (I - s J)^-1 r with J the tangent at the start of the step. It is applied twice: a single
    application bounds stiff components, but counts an offset of stiff springs, divided by s, as an error of velocities,
    which the step damps.
    """
    s = method.gamma * dt
    return solve(s, solve(s, dt * (method.gamma * first + combined(method.errors, k))))  # (IV.8.20), (IV.8.21)


class Control:
    """Step sizes of one run, from one step to the next.

    `numbers` hold the whole state and can be saved: the proposed step [s], the error of the last accepted step over the
    tolerance, and whether the last attempt was rejected.
    """

    def __init__(self, order: int, dt: float, numbers: MutableSequence[float] | None = None):
        self.order = order
        """Order of the error estimate in the step: `estimate` + 1 of the method."""
        self.numbers = [0.0] * 3 if numbers is None else numbers
        self.numbers[:] = dt, LEAST_BEFORE, 0.0

    @property
    def dt(self) -> float:
        """The proposed step [s]."""
        return float(self.numbers[0])

    def propose(self, left: float) -> float:
        """Return the next step, given the time `left` up to the point where a step must end."""
        return landing(self.dt, left)

    def judge(self, dt: float, error: float) -> bool:
        """Record a step dt with its error over the tolerance; return whether it is accepted."""
        *numbers, accepted = judged(self.order, [float(x) for x in self.numbers], dt, error)
        self.numbers[:] = numbers
        return accepted


Rule = Explicit | Collocation | implicit.Newmark


def tolerance(method: Explicit | Collocation, run: float) -> float:
    """The tolerance of a step that keeps a run within a tolerance, as `step_tolerance` of the runtime does."""
    factor, exponent = share(method)
    long = isinstance(method, Explicit) and method is not EXPLICIT5_SHORT
    return factor * run**exponent * (min(1.0, STEADY / run) ** LOOSER if long else 1.0)


def by_method(instance: Instance, method: str, order: int = 0) -> Adaptive:
    """What makes the steps of a method from where an initialised instance stands; inputs extrapolated with an order."""
    settings = instance.settings
    run = settings.relative_tolerance
    rule: Rule = explicit_rule(method, run) or implicit.RULES[method]
    relative, absolute = run, settings.absolute_tolerance or run
    if not isinstance(rule, implicit.Newmark):
        relative, absolute = tolerance(rule, run), tolerance(rule, absolute)
    past = Past(len(instance.inputs))

    def inputs(t: float) -> NDArray:
        return past.at(t, order) if order else instance.inputs

    found = Adaptive(instance, rule, inputs, relative, absolute)
    found.past, found.of_one_length = past, method in FIXED
    return found


class Adaptive:
    """The steps of one run, from one communication point to the next.

    `relative` and `absolute` [m, rad; per s] are the tolerances of a step. A step in which a stage comes near a
    singular position is made again with every stage on the branch, whatever its length: one smooth field for all. A
    refused step changes nothing but the length of the next. What is remembered between communication points is
    `control` alone, as inputs may jump there.
    """

    def __init__(
        self,
        oracle: Instance,
        rule: Rule,
        inputs: Callable[[float], NDArray],
        relative: float,
        absolute: float,
    ):
        self.oracle, self.rule, self.inputs = oracle, rule, inputs
        self.relative, self.absolute = relative, absolute
        self.fixed: float | None = None
        """Length of all steps [s]; None adapts them."""
        self.control = Control(3 if isinstance(rule, implicit.Newmark) else rule.estimate + 1, FIRST_STEP)
        self.counts = dict.fromkeys(("steps", "refused", "beside", "newton"), 0)
        """Steps, refused ones, tries made on the branch, iterations of Newton's method."""
        self._error, self._why = math.inf, ""
        if not isinstance(rule, Explicit):
            vm = ArrayFunctions(with_tangents(oracle.equations))
            self._tangents = ArrayFunction(vm, "tangents", vm.equations.signatures["tangents"])
        self.place(oracle.time, oracle.q, oracle.v, oracle.work, oracle.states)
        self._nominal = np.array([v.nominal for v in oracle.equations.states])
        units = [c.unit for c in oracle.equations.coordinates]
        self._bounded = np.array([unit in ("rad", "m") for unit in units] + [False] * len(units))

    def cover(self, h: float) -> None:
        """A communication step [s], in steps of solver.step_size where they have a given length."""
        if self.of_one_length:
            self.fixed = h / max(1, math.ceil(h / self.oracle.settings.step_size * (1 - 1e-12)))
        self.past.reach(self.t, self.oracle.inputs)
        self.place(self.t, self.q, self.v, self.work, self.x)
        self.advance(self.t + h)

    def place(self, t: float, q: NDArray, v: NDArray, work: float, x: NDArray | None = None) -> None:
        """Begin at t with q, v (n,), the work done so far [J] and states x; inputs may have jumped."""
        self.t, self.q, self.v, self.work = t, q.copy(), v.copy(), work
        self.x = self.oracle.states.copy() if x is None else x.copy()
        self._first: NDArray | None = None
        self._k: Any = None

    @np.errstate(all="ignore")
    def advance(self, end: float, taken: Callable[[], None] = lambda: None, tries: float = math.inf) -> None:
        """Go on up to `end` and land on it, or until so many steps were tried; `taken` is called after each step."""
        while self.t < end and tries > 0:
            self._try(end, taken)
            tries -= 1

    def _try(self, end: float, taken: Callable[[], None]) -> None:
        left = end - self.t
        dt = min(self.fixed, left) if self.fixed else self.control.propose(left)
        landed = dt >= left * (1 - 1e-9)
        if dt < SHORTEST:
            name = self.oracle.equations.name
            raise StepError(
                f"{name}, t = {self.t:.6g} s: no step however short meets the tolerance (last error "
                f"{self._error:.1e} of it{self._why}); raise solver.relative_tolerance"
            )
        found = self.step(dt)
        if self.fixed and found is None:
            name = self.oracle.equations.name
            raise StepError(f"{name}, t = {self.t:.6g} s: the step failed{self._why}; reduce solver.step_size")
        self._error = found[-1] if found else np.inf
        if self.fixed or self.control.judge(dt, self._error):
            self.q, self.v, self.x, self.work, self._first, self._k, _ = found
            self.t = end if landed else self.t + dt
            self.counts["steps"] += 1
            taken()
        else:
            self.counts["refused"] += 1

    def step(self, dt: float) -> tuple | None:
        """q, v, x, work, what the next step can use again, the error over the tolerance; None where none is found."""
        self._why = ""
        self.oracle.hold(self.q)
        make = {Explicit: self._explicit, Collocation: self._collocation, implicit.Newmark: self._newmark}
        try:
            try:
                return make[type(self.rule)](dt, False)
            except _Near:
                self.counts["beside"] += 1
                return make[type(self.rule)](dt, True)
        except (StepError, np.linalg.LinAlgError) as error:
            self._why = f": {str(error).split(': ', 1)[-1].split(';')[0]}"
            return None

    # Rates and tangents ----------------------------------------------------------------------------------------

    def _rate(self, t: float, y: NDArray, beside: bool, dt: float) -> NDArray:
        """Rate of q, v, x and work."""
        q, v, x = self._parts(y)
        a, rates = self._acceleration(t, q, v, x, beside, dt), self._state_rates(t, q, v, x)
        return np.concatenate([v, a, rates, [self._power(t, q, v, x)]])

    def _driven(self, t: float, x: NDArray) -> NDArray:
        """Inputs at t, and behind them the states."""
        return np.concatenate([self.inputs(t), x])

    def _state_rates(self, t: float, q: NDArray, v: NDArray, x: NDArray) -> NDArray:
        return self.oracle.state_rates(q, v, self._driven(t, x), t)

    def _acceleration(self, t: float, q: NDArray, v: NDArray, x: NDArray, beside: bool, dt: float) -> NDArray:
        oracle, u = self.oracle, self._driven(t, x)
        if not beside:
            self._check_near(q)
            return oracle.accelerations(q, v, u, t)[0]
        places = self._places(q, v, branch.LONG_SPACING * dt, t)
        found = {k: oracle.accelerations(*place, u, t)[0] for k, place in places.items()}
        return found[0] if 0 in found else branch.mean(found)

    def _power(self, t: float, q: NDArray, v: NDArray, x: NDArray) -> float:
        return self.oracle.power(q, v, self._driven(t, x), t)

    def _check_near(self, q: NDArray) -> None:
        o = self.oracle
        if o.continues and o.margin(q)[1] < branch.BRANCH_MARGIN:
            raise _Near

    def _places(self, q: NDArray, v: NDArray, spacing: float, t: float) -> dict[int, tuple[NDArray, NDArray]]:
        """The place on the branch (0), or those that a limit is taken from."""
        o = self.oracle
        here, rate, spacing = o.approach(q, v, spacing)
        if not (rate > 0 and here < branch.LIMIT_ZONE * o.least_distance):
            return {0: o.reached(q, v, t)}
        spacing *= o.least_distance / rate
        return {k: o.reached(q + k * spacing * v, v, t) for k in branch.READ_MEAN}

    def _linearised(self, t: float, y: NDArray, beside: bool, dt: float) -> tuple[NDArray, tuple[NDArray, NDArray]]:
        """The rate of q, v and x, and the derivatives of a and of the rates of x by displacements and by v with x.

        States are those of displacements that nothing asks for: theirs are zero.
        """
        q, v, x = self._parts(y)
        if not beside:
            self._check_near(q)
            a, aq, av, ax, _, _ = self.tangent(q, v, x, t)
        else:
            found = {}
            for k, (there, w) in self._places(q, v, branch.LONG_SPACING * dt, t).items():
                a, aq, av, ax, _, (C, solve, Xv) = self.tangent(there, w, x, t)
                T, S = implicit.return_map(C, self.oracle.alpha, solve, Xv, np.eye(len(q)), RETURNS)
                found[k] = a, *implicit.on_branch(aq, av, T, S), ax
            limit = found[0] if 0 in found else (branch.mean({k: x[i] for k, x in found.items()}) for i in range(4))
            a, aq, av, ax = limit
        *_, Gq, Gv, Gx = self._tangents_at(q, v, a, np.zeros(self.oracle.equations.l), self._driven(t, x), t)
        nothing = np.zeros((len(q), len(x))), np.zeros((len(x), len(x)))
        by_places = np.block([[aq, nothing[0]], [Gq, nothing[1]]])
        by_rates = np.block([[av, ax], [Gv, Gx]])
        return np.concatenate([v, a, self._state_rates(t, q, v, x)]), (by_places, by_rates)

    def _tangents_at(self, q: NDArray, v: NDArray, a: NDArray, lam: NDArray, u: NDArray, t: float) -> list[NDArray]:
        """Rq, Rv, Xq, Xv, Rt, and Rx, Gq, Gv, Gx, empty ones where there are no states."""
        found, n, count = self._tangents(q, v, a, lam, u, self.oracle.memory["p"], t), len(q), len(self.x)
        shapes, others = ((n, count), (count, n), (count, n), (count, count)), found[5:] or [np.zeros(0)] * 4
        others = [x.reshape(shape, order="F") for x, shape in zip(others, shapes, strict=True)]
        return [x.copy() for x in (*found[:5], *others)]

    def tangent(self, q: NDArray, v: NDArray, x: NDArray, t: float) -> tuple:
        """a, its derivatives by q, v, x and t, and C, what solves with H, and the derivative of xi by v."""
        o, n, u = self.oracle, len(q), self._driven(t, x)
        a, lam, _, _ = o.accelerations(q, v, u, t)
        Rq, Rv, Xq, Xv, Rt, Rx, *_ = self._tangents_at(q, v, a, lam, u, t)
        M, C, _, _ = (x.copy() for x in o.dynamics(q, v, u, t))
        solve = o.inverse(method.augmented_mass(M, C, o.alpha))
        limit = o.settings.tolerance * 100

        def done(change: NDArray, value: NDArray) -> bool:
            return np.abs(change).max() <= limit * np.abs(value).max()

        l = len(C)
        zeros = np.zeros((n, 2 * n + 1 + len(x))), np.zeros((l, 2 * n + 1 + len(x)))
        R, X = np.column_stack([Rq, Rv, Rt, Rx]), np.column_stack([Xq, Xv, np.zeros(l), np.zeros((l, len(x)))])
        both = implicit.tangent(M, C, o.alpha, solve, R, X, zeros, o.settings.max_iterations, done)
        return a, both[:, :n], both[:, n : 2 * n], both[:, 2 * n + 1 :], both[:, 2 * n], (C, solve, Xv)

    # Methods ---------------------------------------------------------------------------------------------------

    def _settled(self, y: NDArray, t: float) -> NDArray:
        """The state after a step, projected where the formulation does so."""
        if not np.isfinite(y).all():
            raise StepError("the state is not finite")
        q, v, _ = self._parts(y)
        if self.oracle.settings.projects:
            q, v, _, _ = self.oracle.project(q, v, t)
        return np.concatenate([q, v, y[2 * len(q) :]])

    def _explicit(self, dt: float, beside: bool) -> tuple:
        def rate(t: float, y: NDArray) -> NDArray:
            return self._rate(t, y, beside, dt)

        y = np.concatenate([self.q, self.v, self.x, [self.work]])
        first = None if beside else self._first
        rule = rule_beside(self.rule) if beside and not self.fixed else self.rule
        after, errors, last = explicit(rule, rate, self.t, y, dt, first, lambda y: self._settled(y, self.t + dt))
        size = max(self._size(y, after, error) for error in errors)
        return *self._parts(after), float(after[-1]), None if beside else last, None, size

    def _collocation(self, dt: float, beside: bool) -> tuple:
        rule, n, count = self.rule, len(self.q), len(self.x)
        y = np.concatenate([self.q, self.v, self.x])
        scale = self._scale(y, y)

        def correct(tangents: list, residues: list[NDArray]) -> list[NDArray]:
            self.counts["newton"] += 1
            rq, rv = (
                np.array(x) for x in zip(*((np.append(r[:n], np.zeros(count)), r[n:]) for r in residues), strict=True)
            )
            h, eye = dt * np.array(rule.matrix), np.eye(n + count)
            blocks = [
                [(i == j) * eye - h[i, j] * av - (h @ h)[i, j] * aq for j in range(len(h))]
                for i, (aq, av) in enumerate(tangents)
            ]
            right = [rv[i] + aq @ (h @ rq)[i] for i, (aq, _) in enumerate(tangents)]
            dv = np.linalg.solve(np.block(blocks), np.concatenate(right)).reshape(rv.shape)
            return list(np.hstack([(rq + h @ dv)[:, :n], dv]))

        changed: list[float] = []

        def done(changes: list[NDArray], _: list[NDArray]) -> bool:
            changed.append(max(np.abs(dt * x / scale).max() for x in changes))
            if not changed[-1] < 1e12 or (len(changed) > 2 and changed[-1] > 2 * changed[-2]):
                raise StepError("Newton's method diverges")
            return changed[-1] <= CONVERGED

        def linearise(t: float, y: NDArray) -> tuple[NDArray, tuple[NDArray, NDArray]]:
            return self._linearised(t, y, beside, dt)

        first, tangents = linearise(self.t, y)
        k = continued(rule, self._k[0], dt / self._k[1]) if self._k else [first] * len(rule.nodes)
        after, k, _, converged = collocation(rule, linearise, correct, self.t, y, dt, k, NEWTON, done)
        if not converged:
            raise StepError("Newton's method has not converged")
        work = self.work
        if self.oracle.equations.works:
            places = [y + dt * combined(weights, k) for weights in rule.matrix]
            powers = [
                self._power(self.t + node * dt, *self._parts(place))
                for node, place in zip(rule.nodes, places, strict=True)
            ]
            work += dt * combined(rule.matrix[-1], powers)
        error = collocation_error(rule, self._solver(tangents), first, k, dt)
        after = self._settled(after, self.t + dt)
        return *self._parts(after), work, None, (k, dt), self._size(y, after, error)

    def _extended(self, M: NDArray, C: NDArray, R: NDArray, rates: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        """M, C and R with rows and columns for states, which count as velocities of masses of 1."""
        count = len(self.x)
        mass = np.block([[M, np.zeros((len(M), count))], [np.zeros((count, len(M))), np.eye(count)]])
        return mass, np.hstack([C, np.zeros((len(C), count))]), np.concatenate([R, rates])

    def _newmark(self, dt: float, beside: bool) -> tuple:
        """The index-3 form: Newton's method on positions and multipliers, then projections of velocities and of a.

        Projections are orthogonal in the metric of the tangent of the step, so that stiff forces are not stirred
        (Cuadrado, Cardenal and Bayo 1997).
        """
        o, rule, t = self.oracle, self.rule, self.t + dt
        if self._k is None:
            a, lam, _, _ = o.accelerations(self.q, self.v, self._driven(self.t, self.x), self.t)
            a = np.concatenate([a, self._state_rates(self.t, self.q, self.v, self.x)])
            self._k = a, a, lam
        a0, w0, lam = self._k
        n, count = len(self.q), len(self.x)
        by_v, by_a = implicit.changes(rule, dt)
        change = np.zeros_like(a0)
        scale = np.concatenate([np.maximum(np.abs(self.q), 1.0), dt * np.maximum(np.abs(self.x), self._nominal)])
        begin = np.concatenate([self.q, np.zeros(count)]), np.concatenate([self.v, self.x])
        for i in range(2 * NEWTON):
            self.counts["newton"] += 1
            q, v, _ = implicit.moved(rule, dt, *begin, w0, a0, change)
            (q, v, x), (a, rates) = (q[:n], v[:n], v[n:]), np.split(a0 + change, [n])
            u = self._driven(t, x)
            M, C, F, _ = (each.copy() for each in o.dynamics(q, v, u, t))
            Phi = o.constraints(q, v)[2].copy()
            Rq, Rv, _, _, _, Rx, Gq, Gv, Gx = self._tangents_at(q, v, a, lam, u, t)
            Rq = np.block([[Rq, np.zeros((n, count))], [Gq, np.zeros((count, count))]])
            Rv = np.block([[Rv, Rx], [Gv, Gx]])
            R = F - M @ a - C.T @ lam
            M, C, R = self._extended(M, C, R, self._state_rates(t, q, v, x) - rates)
            dq, dlam = implicit.position_step(M, C, Phi, R, Rq, Rv, o.alpha, rule, dt, np.linalg.solve)
            change, lam = change + by_a * dq, lam + dlam
            size = float(np.abs(dq / scale).max())
            if size <= implicit.CONVERGED:
                break
            if i + 1 == 2 * NEWTON or not size < 1e12:
                raise StepError(f"Newton's method leaves a change of {size:.1e}")
        q, v, w = implicit.moved(rule, dt, *begin, w0, a0, change)
        q, v, x = q[:n], v[:n], v[n:]
        inertia = M - (by_v / by_a) * Rv - Rq / by_a
        solve = o.inverse(inertia + C.T @ o.alpha @ C)
        for _ in range(RETURNS):
            q = q + method.project(C, o.alpha, solve, o.constraints(q, v)[2])[:n]
            v = v + method.project(C, o.alpha, solve, o.constraints(q, v)[3])[:n]
        M, C, _, xi = (each.copy() for each in o.dynamics(q, v, self._driven(t, x), t))
        a = np.concatenate([self._nearest(M, C, (a0 + change)[:n], xi), self._state_rates(t, q, v, x)])
        power = self._power(self.t, self.q, self.v, self.x) + self._power(t, q, v, x)
        return q, v, x, self.work + dt / 2 * power, None, (a, w, lam), 0.0

    def _nearest(self, M: NDArray, C: NDArray, a: NDArray, xi: NDArray) -> NDArray:
        """Accelerations (n,) that keep the constraints, the nearest to a in the metric of M."""
        o = self.oracle
        solve = o.inverse(method.augmented_mass(M, C, o.alpha))
        return o.iterated(method.residual, M, M @ a, C, xi, solve)[0]

    def _solver(self, tangents: tuple[NDArray, NDArray]) -> Callable[[float, NDArray], NDArray]:
        n, count = len(self.q), len(self.x)

        def solve(s: float, r: NDArray) -> NDArray:
            (aq, av), rq = tangents, np.append(r[:n], np.zeros(count))
            dv = np.linalg.solve(np.eye(n + count) - s * av - s * s * aq, r[n:] + s * (aq @ rq))
            return np.append((rq + s * dv)[:n], dv)

        return solve

    def _parts(self, y: NDArray) -> tuple[NDArray, NDArray, NDArray]:
        n = len(self.q)
        return y[:n], y[n : 2 * n], y[2 * n : 2 * n + len(self.x)]

    def _scale(self, y: NDArray, after: NDArray) -> NDArray:
        """Tolerance of each entry of q, v and x; whole turns make an angle no less exact, nor offsets a length."""
        sizes, count = np.maximum(np.abs(y), np.abs(after)), len(self._bounded)
        larger = np.where(self._bounded, np.minimum(sizes[:count], 1.0), sizes[:count])
        states = sizes[count : count + len(self.x)]
        return np.concatenate(
            [self.absolute + self.relative * larger, self.absolute * self._nominal + self.relative * states]
        )

    def _size(self, y: NDArray, after: NDArray, error: NDArray) -> float:
        """Error of the constrained state and of x over the tolerance."""
        if self.fixed:
            return 0.0
        o, (q, v, _) = self.oracle, self._parts(after)
        M, C, _, _ = o.constraints(q, v)
        solve = o.inverse(method.augmented_mass(M, C, o.alpha))
        *parts, change = self._parts(error)
        parts = [*(branch.tangential(C, o.alpha, solve, x) for x in parts), change]
        return float(np.abs(np.concatenate(parts) / self._scale(y, after)).max())


class _Near(Exception):
    """A stage is near a singular position."""
